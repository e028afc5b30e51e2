"""The runs of the skill transfer: which skills are shown, the twin, what is remembered."""

import gymnasium as gym
import numpy as np
import pytest

from results.exceptions import BenchmarkError
from results.transfer.package_arms import (
    UNIT,
    PackageRun,
    fetch,
    package_file,
    pusher,
    refined,
    tasks_of,
    way_of,
)
from results.transfer.runs import Remembering, TransferRun, first_trajectory, nearest_skill
from results.transfer.skills import BUTTON, PROXIES, SOURCE, TARGET, button, proxy_contexts, shown


def test_both_arms_are_shown_the_same_skills_and_seeds_differ() -> None:
    contexts = proxy_contexts(0)
    source, target = shown(SOURCE, contexts), shown(TARGET, contexts)
    assert contexts[:, 0].tolist() == np.repeat(range(3), 4).tolist()
    assert np.array_equal(source.contexts, target.contexts)
    assert (source.trajectory_shape, target.trajectory_shape) == ((300, 3), (300, 4))
    assert np.array_equal(contexts, proxy_contexts(0))
    assert not np.allclose(contexts, proxy_contexts(1))
    ends = np.array([end for each in PROXIES.values() for end in each])
    bearing = np.degrees(np.arctan2(contexts[:, 2], contexts[:, 1]))
    assert np.abs(bearing - ends[:, 0]).max() <= 3
    assert np.abs(np.linalg.norm(contexts[:, 1:], axis=1) - ends[:, 1]).max() <= 0.0101


def test_the_twin_looks_through_another_timing() -> None:
    pytest.importorskip("dtaidistance", reason="the extra 'contrib' is not installed")
    t = np.linspace(0, 1, 300)
    early, late = (np.clip((t - shift) / 0.5, 0, 1)[:, None] for shift in (0.1, 0.3))
    proxies = np.stack([0.7 * late, early, -late])  # the first is nearer point by point
    proxies.setflags(write=False)  # as those of Demonstrations are
    assert np.mean((proxies[0] - late) ** 2) < np.mean((proxies[1] - late) ** 2)
    assert nearest_skill(late, proxies) == 1


def test_rollouts_are_remembered_and_scratch_begins_with_the_start_pose() -> None:
    _, context, expert = button(TARGET)
    start, measured = first_trajectory("scratch", 0)
    assert np.ptp(start, axis=0).max() == 0
    assert measured == {}
    assert (TransferRun("nearest", 0).budget, TransferRun("nearest", 0).population_size) == (60, 2)
    env = Remembering(gym.make(BUTTON, context=context, arm=TARGET))
    for trajectory in (start, expert):
        env.reset()
        env.step(trajectory.astype(np.float32))
    assert [(touched, solved) for _, touched, solved in env.rollouts] == [
        (False, False),
        (True, True),
    ]
    assert env.rollouts[0][0] == pytest.approx(-0.05009, abs=1e-4)


# -- arms of packages ------------------------------------------------------------------------------


def test_skills_lie_ahead_of_and_beside_either_arm() -> None:
    middle, ahead = np.array([1.0, 2.0, 0.5]), np.array([0.0, 1.0, 0.0])
    way = way_of("press", np.array([0.5, 1.0]), middle, ahead)
    down, up = (np.asarray(each.position, np.float64) for each in way[1:])
    np.testing.assert_allclose(down, middle + UNIT * np.array([-0.5, 1.0, -0.5]))
    np.testing.assert_allclose(up, middle + UNIT * np.array([-0.5, 1.0, 0.3]))
    sweep = way_of("sweep", np.zeros(2), middle, ahead)
    swept = np.array([each.position for each in sweep], np.float64)
    np.testing.assert_allclose(swept, [middle, middle + UNIT * np.array([-0.8, 0.0, 0.0])])


def test_the_pusher_does_every_skill_and_fetch_moves_eight_joints() -> None:
    pytest.importorskip("mink", reason="the extra 'robots' is not installed")
    tasks, place = tasks_of(pusher(), np.array([1.0, 0.0, 0.0])), np.array([0.4, -0.3])
    assert len(tasks) == 4
    for kind, task in tasks.items():
        assert task.simulate(place, task.demonstrate(place)).successes[0], kind
    pytest.importorskip("gymnasium_robotics", reason="the extra 'robotics' is not installed")
    arm = fetch()
    assert (arm.n_joints, arm.units[:2], arm.kinematic.nq) == (8, ("m", "rad"), 8)


def test_a_package_that_is_not_installed_is_named() -> None:
    with pytest.raises(BenchmarkError, match="no_such_arms is not installed; install it with"):
        package_file("no_such_arms", "arm.xml")


def test_a_refinement_tells_after_how_many_rollouts_each_test_is_solved() -> None:
    pytest.importorskip("mink", reason="the extra 'robots' is not installed")
    task = tasks_of(pusher(), np.array([1.0, 0.0, 0.0]))["reach"]
    places = [np.array([0.2, 0.1]), np.array([-0.4, 0.3])]
    right = np.stack([task.demonstrate(place) for place in places])
    answers = np.stack([right[0], right[0]])  # the second is shown the first one's way
    assert task.simulate(np.stack(places), answers).successes.tolist() == [True, False]
    found = refined(PackageRun(0, budget=4), task, places, answers)
    assert found == [1, None]
    assert refined(PackageRun(0, budget=4), task, places[1:], right[1:]) == [1]
