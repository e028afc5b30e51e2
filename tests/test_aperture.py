"""The aperture task: contexts, clearance, reward, the solid wall and the expert."""

import mujoco
import numpy as np
import pytest

from benchmark_envs import InvalidContextError, make_task, resample
from benchmark_envs.tasks.aperture import START, ApertureTask, T, clearances, round_corners

CONTEXT = np.array([5.0, 5.0, 9.0, 5.0])  # opening and goal straight ahead
OPENING = CONTEXT[None, :2]


@pytest.fixture(scope="module")
def task() -> ApertureTask:
    made = make_task("nmp/Aperture-v0")
    assert isinstance(made, ApertureTask)
    return made


def polyline(*points: tuple[float, float]) -> np.ndarray:
    return resample(np.array([START, *points]), T)


def draw_contexts(task: ApertureTask, n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([task.sample_context(rng) for _ in range(n)])


def test_drawn_contexts_fill_the_thesis_ranges(task: ApertureTask) -> None:
    xc, yc, xg, yg = draw_contexts(task, 2000).T
    for values, low, high in ((xc, 2, 8), (yc, 1, 9), (yg, 0, 10)):
        assert low <= values.min() < low + 0.1 and high - 0.1 < values.max() <= high
    assert (xg >= xc + 1.5).all() and xg.max() <= 10


def test_a_goal_too_near_behind_the_wall_is_refused_with_the_rule(task: ApertureTask) -> None:
    task.check_context([8.0, 5.0, 9.5, 5.0])
    with pytest.raises(InvalidContextError, match=r"opening's x \+ 1.5 = 9.5.* x <= 7.9"):
        task.check_context([8.0, 5.0, 9.4, 5.0])


@pytest.mark.parametrize(
    ("points", "clearance"),
    [
        ([(5, 5), (9, 5)], 1.0),  # through the middle
        ([(3.5, 5.4), (6.5, 5.4), (9, 5)], 0.6),
        ([(3.5, 7.5), (6.5, 7.5), (9, 5)], -1.5),  # 1.5 m deep in the wall
        ([(3.5, 9.0)], 1.0),  # never enters
    ],
)
def test_clearance_by_hand(points: list[tuple[float, float]], clearance: float) -> None:
    path = np.array([START, *points])[None]
    assert clearances(path, OPENING).min() == pytest.approx(clearance)


def test_clearance_is_exact_between_points_and_on_the_way_from_the_start() -> None:
    jump = np.array([[[0.0, 9.0], [10.0, 9.0]]])  # no point lies in the wall
    np.testing.assert_allclose(clearances(jump, OPENING), [[1.0, -3.0]])
    far_start = np.array([[[10.0, 9.0], [10.0, 9.0]]])  # from (0, 5): y = 7.4 at x = 6
    np.testing.assert_allclose(clearances(far_start, OPENING), [[-1.4, 1.0]])
    upright = np.array([[[5.0, 5.0], [5.0, 7.0], [5.0, 5.5]]])
    np.testing.assert_allclose(clearances(upright, OPENING), [[1.0, -1.0, -1.0]])


def test_clearance_agrees_with_dense_sampling() -> None:
    paths = np.random.default_rng(0).uniform(-1, 11, (50, 20, 2))
    openings = np.random.default_rng(1).uniform([2, 1], [8, 9], (50, 2))
    exact = clearances(paths, openings).min(axis=1)
    for path, opening, value in zip(paths, openings, exact, strict=True):
        dense = resample(np.vstack([START, path]), 50_000) - opening
        inside = np.abs(dense[:, 0]) <= 1
        assert 1 - np.abs(dense[inside, 1]).max() == pytest.approx(value, abs=0.01)


def test_reward_is_the_sum_of_three_errors_each_at_its_time(task: ApertureTask) -> None:
    path = polyline((3.5, 5.5), (6.5, 5.5), (9.0, 5.0))  # clearance 0.5
    path[0] += (0.0, 0.1)
    path[-30:] = (9.0, 5.2)  # rests 0.2 m beside the goal
    rollouts = task.simulate(CONTEXT, path)
    assert rollouts.terms["start"][0] == pytest.approx(-0.1)
    assert rollouts.terms["wall"][0] == pytest.approx(-0.13)
    assert rollouts.terms["goal"][0] == pytest.approx(-0.2, abs=1e-3)
    assert rollouts.step_rewards is not None
    steps = rollouts.step_rewards[0]
    assert steps.sum() == pytest.approx(rollouts.rewards[0])
    when = np.flatnonzero(steps)
    assert len(when) == 3 and when[0] == 0 and when[-1] == T - 1
    assert abs(path[when[1], 0] - 5) <= 1.1 and steps[when[1]] == rollouts.terms["wall"][0]


@pytest.mark.parametrize(
    ("start", "side", "goal", "solved"),
    [
        (0.0, 0.0, 0.0, True),
        (0.14, 0.54, 0.14, True),
        (0.16, 0.0, 0.0, False),
        (0.0, 0.57, 0.0, False),  # clearance 0.43: no contact, but too near
        (0.0, 0.0, 0.16, False),
    ],
)
def test_success_needs_start_clearance_and_goal(
    task: ApertureTask, start: float, side: float, goal: float, solved: bool
) -> None:
    path = polyline((3.0, 5 + side), (7.0, 5 + side), (9.0, 5.0))
    path[0, 1] += start
    path[-20:] = (9.0 + goal, 5.0)
    assert task.simulate(CONTEXT, path).successes[0] == solved


def test_the_robot_starts_at_rest_at_the_start_whatever_is_commanded(task: ApertureTask) -> None:
    path = polyline((9.0, 5.0))
    path[0] = (0.0, 8.0)
    rollouts = task.simulate(CONTEXT, path)
    np.testing.assert_allclose(rollouts.executed[0, 0], START, atol=0.05)
    assert rollouts.terms["start"][0] == pytest.approx(-3.0)


def test_the_wall_stops_the_robot(task: ApertureTask) -> None:
    rollouts = task.simulate(CONTEXT, polyline((0.0, 9.0), (10.0, 9.0)))
    assert rollouts.executed[0, -1, 0] == pytest.approx(4 - 0.15, abs=0.05)  # at its face
    assert rollouts.terms["wall"][0] == pytest.approx(-3.63)  # by the set-points
    assert rollouts.terms["goal"][0] < -5
    assert not rollouts.successes[0]


#: of the robot's centre in the wall, in m; the oldest MuJoCo that is allowed yields a little more
DEEPEST = 0.5 if mujoco.mj_versionString() == "3.3.6" else 0.4


def test_no_set_points_drive_the_robot_through_the_wall(task: ApertureTask) -> None:
    contexts = draw_contexts(task, 200)
    rng = np.random.default_rng(1)
    noise = rng.uniform(-1, 11, (200, T, 2))
    ram = np.empty((200, T, 2))
    ram[..., 1] = np.where(contexts[:, 1] > 5, 0.0, 10.0)[:, None]
    ram[:, :50, 0], ram[:, 50:, 0] = -1.0, 11.0
    for trajectories in (noise, ram):
        executed = task.simulate(contexts, trajectories).executed
        x, y = np.moveaxis(executed - contexts[:, None, :2], 2, 0)
        depth = np.minimum(1 - np.abs(x), np.abs(y) - 1)  # of the centre
        assert depth.max() < DEEPEST
        crosses = (x[:, 1:] > 0) != (x[:, :-1] > 0)
        assert (np.abs(y[:, 1:][crosses]) < 1.4).all(), "only ever through the opening"


def test_touching_the_wall_is_no_success(task: ApertureTask) -> None:
    graze = polyline((3.5, 5.9), (6.5, 5.9), (9.0, 5.0))
    rollouts = task.simulate(CONTEXT, graze)
    assert rollouts.terms["goal"][0] > -0.01  # it slides through and arrives
    assert not rollouts.successes[0]


def test_the_servo_follows_within_five_centimetres_around_sharp_corners(task: ApertureTask) -> None:
    contexts = np.array([[4.0, 5.0, 8.0, 6.0], [6.0, 5.0, 10.0, 6.0]])
    ends = [polyline((c[0] - 1.45, 5.0), (c[0] + 1.45, 5.0), (c[2], c[3])) for c in contexts]
    rollouts = task.simulate(contexts, np.stack(ends))
    error = np.linalg.norm(rollouts.executed - rollouts.trajectories, axis=2)
    assert error.max() < 0.05
    assert rollouts.successes.all()


def test_the_expert_solves_every_context_with_clearance_to_spare(task: ApertureTask) -> None:
    contexts = draw_contexts(task, 300, seed=7)
    corners = [[2, 1, 3.5, 0], [2, 9, 3.5, 10], [8, 1, 9.5, 10], [8, 9, 10, 0], [2, 5, 3.5, 5]]
    contexts = np.concatenate([contexts, np.array(corners)])
    expert = np.stack([task.demonstrate(context) for context in contexts])
    rollouts = task.simulate(contexts, expert)
    assert rollouts.successes.all()
    assert clearances(expert, contexts[:, :2]).min() > 0.99
    assert rollouts.rewards.min() > -1e-3
    speed = np.linalg.norm(np.diff(expert, axis=1), axis=2)
    assert (speed.std(axis=1) < 0.1 * speed.mean(axis=1)).all(), "uniform speed"


def test_demonstrations_pass_the_opening_at_different_times(task: ApertureTask) -> None:
    contexts = draw_contexts(task, 50)
    expert = np.stack([task.demonstrate(context) for context in contexts])
    when = np.argmax(expert[:, :, 0] >= contexts[:, :1], axis=1)
    assert np.ptp(when) > 60


def test_rounded_corners_keep_the_ends_and_stay_near_the_polyline() -> None:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    path = round_corners(corners, 0.45)
    np.testing.assert_array_equal(path[[0, -1]], corners[[0, -1]])
    straight = (path[:, 1] == 0) | (path[:, 0] == 1)
    assert straight[[0, 1, -2, -1]].all()
    deviation = np.minimum(np.abs(path[:, 1]), np.abs(1 - path[:, 0]))
    assert deviation.max() == pytest.approx(0.45 / 4, abs=0.005)


def test_one_and_two_threads_give_the_same_bits_in_collisions_too() -> None:
    one = make_task("nmp/Aperture-v0", n_threads=1)
    two = make_task("nmp/Aperture-v0", n_threads=2)
    assert isinstance(one, ApertureTask)
    contexts = draw_contexts(one, 80)
    straight = np.stack([one.initial_trajectory(context) for context in contexts])
    a, b = one.simulate(contexts, straight), two.simulate(contexts, straight)
    np.testing.assert_array_equal(a.executed, b.executed)
    np.testing.assert_array_equal(a.rewards, b.rewards)
