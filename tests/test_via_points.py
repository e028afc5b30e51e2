"""The via-points task: its reward on known curves, what counts as a point, contexts, the expert."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from benchmark_envs import RenderingUnavailableError, Task, TaskError, make_task
from benchmark_envs.tasks.via_points import MOST_POINTS, TOLERANCE, T, ViaPointsTask, repeated

X = np.linspace(0.0, 1.0, T)


@pytest.fixture(scope="module")
def task() -> Task:
    return make_task("nmp/ViaPoints-v0")


def context(*points: tuple[float, float]) -> np.ndarray:
    """The context of some points, the last of which is repeated."""
    return np.ravel([*points, *[points[-1]] * (MOST_POINTS - len(points))])


def drawn(n_points: int | None, n: int = 40, seed: int = 0) -> np.ndarray:
    """Contexts of one generator, as points, shape (n, 6, 2)."""
    rng, task = np.random.default_rng(seed), make_task("nmp/ViaPoints-v0", n_points=n_points)
    return np.stack([task.sample_context(rng) for _ in range(n)]).reshape(n, MOST_POINTS, 2)


def numbers_of(points: np.ndarray) -> list[int]:
    return (~repeated(points)).sum(axis=1).tolist()


@pytest.mark.parametrize(
    ("points", "curve", "reward"),
    [
        ([(0.3, 0.5)], np.full(T, 0.5), 0.0),
        ([(0.3, 0.7)], np.full(T, 0.5), -0.2),
        ([(0.2, 0.5), (0.4, 0.9), (0.6, 0.3)], np.full(T, 0.5), -(0.0 + 0.4 + 0.2) / 3),
        ([(0.0, 0.1), (1.0, 0.8)], X, -(0.1 + 0.2) / 2),
        ([(0.123456, 0.5), (0.987654, 0.5)], X, -(0.376544 + 0.487654) / 2),
    ],
)
def test_the_reward_is_minus_the_mean_distance_along_y(
    task: Task, points: list[tuple[float, float]], curve: np.ndarray, reward: float
) -> None:
    rollouts = task.simulate(context(*points), curve[:, None])
    assert rollouts.rewards[0] == pytest.approx(reward, abs=1e-6)
    np.testing.assert_array_equal(rollouts.executed[0], rollouts.trajectories[0])


def test_the_curve_is_linear_between_time_points(task: Task) -> None:
    curve = np.zeros((T, 1))
    curve[100] = 1.0
    for share in (0.0, 0.25, 1.0):
        point = (float(X[99] + share * (X[100] - X[99])), 0.0)
        rollouts = task.simulate(context(point), curve)
        assert rollouts.rewards[0] == pytest.approx(-share, abs=1e-4)


def test_each_point_is_a_term_and_a_summand_at_its_time(task: Task) -> None:
    points = [(0.0, 0.2), (0.501, 0.9), (1.0, 0.4)]
    rollouts = task.simulate(context(*points), np.full((T, 1), 0.5))
    terms = [rollouts.terms[f"point_{i}"][0] for i in range(MOST_POINTS)]
    np.testing.assert_allclose(terms, [-0.1, -0.4 / 3, -0.1 / 3, 0, 0, 0], atol=1e-7)
    assert rollouts.step_rewards is not None
    np.testing.assert_allclose(rollouts.step_rewards[0, [0, 100, 199]], terms[:3], atol=1e-7)
    assert np.count_nonzero(rollouts.step_rewards[0]) == 3


def test_a_repeated_point_counts_once_wherever_it_stands(task: Task) -> None:
    points = [(0.2, 0.5), (0.4, 0.9)]
    flat = np.full((T, 1), 0.5)
    twice = np.ravel([points[0], points[1], points[0], points[1], points[1], points[0]])
    for given in (context(*points), context(*points[::-1]), twice):
        assert task.simulate(given, flat).rewards[0] == pytest.approx(-0.2)


def test_points_at_one_place_along_x_both_count(task: Task) -> None:
    points = context((0.5, 0.4), (0.5, 0.8))
    for height in (0.4, 0.6, 0.8):
        rollouts = task.simulate(points, np.full((T, 1), height))
        assert rollouts.rewards[0] == pytest.approx(-0.2)
        assert not rollouts.successes[0]
    expert = task.demonstrate(points)
    assert expert[99:101] == pytest.approx(0.6, abs=1e-3), "between the two"


def test_success_asks_for_every_point(task: Task) -> None:
    points = context((0.2, 0.5), (0.4, 0.5), (0.6, 0.5))
    curves = np.full((3, T, 1), 0.5)
    curves[:, X > 0.5] += np.array([0.9, 1.1, -1.1])[:, None, None] * TOLERANCE
    assert task.simulate(points, curves).successes.tolist() == [True, False, False]


def test_a_number_of_points_is_kept_and_by_default_drawn() -> None:
    for n in range(1, MOST_POINTS + 1):
        assert numbers_of(drawn(n)) == [n] * 40
    counts = np.bincount(numbers_of(drawn(None, 1200)), minlength=7)[1:]
    assert (np.abs(counts - 200) < 4 * np.sqrt(200 * 5 / 6)).all(), counts


@pytest.mark.parametrize("n_points", [None, 1, 4])
def test_drawn_points_are_uniform_and_sorted_with_the_last_one_repeated(
    n_points: int | None,
) -> None:
    points = drawn(n_points, 1000)
    assert (np.diff(points[:, :, 0], axis=1) >= 0).all()
    for each, n in zip(points, numbers_of(points), strict=True):
        assert (each[n - 1 :] == each[-1]).all()
    different = points[~repeated(points)]
    assert different.mean(axis=0) == pytest.approx(0.5, abs=0.04)
    assert different.var(axis=0) == pytest.approx(1 / 12, abs=0.01)


def test_equally_seeded_contexts_of_different_numbers_have_no_point_in_common() -> None:
    points = np.concatenate([np.unique(drawn(n, 1)[0], axis=0) for n in range(1, 7)])
    assert len(np.unique(points.ravel())) == points.size == 2 * (1 + 2 + 3 + 4 + 5 + 6)


def test_a_context_can_be_kept_from_one_number_of_points_to_another() -> None:
    points = context((0.2, 0.5), (0.4, 0.9))
    curve = np.full((T, 1), 0.5)
    rewards = [ViaPointsTask(n).simulate(points, curve).rewards[0] for n in (None, 1, 2, 6)]
    assert rewards == [pytest.approx(-0.2)] * 4
    env = gym.make("nmp/ViaPoints-v0", n_points=5)
    observed, _ = env.reset(options={"context": points})
    np.testing.assert_array_equal(observed, points.astype(np.float32))
    assert env.step(curve.astype(np.float32))[1] == pytest.approx(-0.2)


@pytest.mark.parametrize("bad", [0, 7, -1, 2.5, "six"])
def test_other_numbers_of_points_are_refused(bad: Any) -> None:
    with pytest.raises(TaskError, match=f"n_points is {bad}, but a context has 1 to 6 points"):
        make_task("nmp/ViaPoints-v0", n_points=bad)


def test_the_expert_meets_the_points_unless_they_lie_too_near() -> None:
    for n in range(1, MOST_POINTS + 1):
        task, points = ViaPointsTask(n), drawn(n, 100)
        contexts = points.reshape(100, -1)
        experts = np.stack([task.demonstrate(each) for each in contexts])
        rollouts = task.simulate(contexts, experts)
        assert not rollouts.clipped.any()
        x = np.where(repeated(points), np.inf, points[:, :, 0])
        gaps = np.diff(np.sort(x, axis=1)[:, :n], axis=1).min(axis=1, initial=1.0)
        assert rollouts.successes[gaps > 2 / T].all()
        assert (rollouts.rewards[gaps > 2 / T] > -1e-4).all()


def test_the_scene_holds_each_point_once_and_nothing_is_rendered(task: Task) -> None:
    scene = task.scene(context((0.25, 0.5), (0.5, 0.75)))
    assert scene is not None and scene["targets"] == [[0.25, 0.5], [0.5, 0.75]]
    with pytest.raises(RenderingUnavailableError, match="ViaPointsTask draws no pictures"):
        task.frames(context((0.25, 0.5)), np.zeros((T, 1)))
