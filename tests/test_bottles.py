"""The bottles task: Eq. 6.4, the crossing, the optimum and the physics."""

import numpy as np
import pytest

from benchmark_envs import make_task, resample
from benchmark_envs.tasks.bottles import (
    BOTTLES,
    GOAL,
    START,
    SUM_OF_RADII,
    BottlesTask,
    T,
    crosses_between,
    path_length,
    taut_path,
)

CENTRES = BOTTLES.reshape(2, 2)


@pytest.fixture(scope="module")
def task() -> BottlesTask:
    made = make_task("nmp/Bottles-v0")
    assert isinstance(made, BottlesTask)
    return made


def polyline(*points: tuple[float, float]) -> np.ndarray:
    return resample(np.array([START, *points, GOAL]), T)


def test_the_straight_line_touches_both_bottles_and_does_not_cross(task: BottlesTask) -> None:
    rollouts = task.simulate(BOTTLES, task.initial_trajectory(BOTTLES))
    assert rollouts.rewards[0] == pytest.approx(-4.12 - 4, abs=1e-3)  # the thesis's value


def test_the_shortest_solution_is_0_860_m_long_on_either_side() -> None:
    for side in (-1.0, 1.0):
        length = path_length(taut_path(CENTRES, SUM_OF_RADII, side)[None])[0]
        assert -0.15 * length == pytest.approx(-0.129, abs=1e-4)


@pytest.mark.parametrize("mode", ["s", "reverse_s"])
@pytest.mark.parametrize(("margin", "touched"), [(0.0006, False), (-0.0006, True)])
def test_touching_begins_at_the_sum_of_radii(
    task: BottlesTask, mode: str, margin: float, touched: bool
) -> None:
    path = taut_path(CENTRES, SUM_OF_RADII + margin, 1.0 if mode == "s" else -1.0)
    rollouts = task.simulate(BOTTLES, resample(path, T))
    assert (rollouts.terms["bottles_down"][0] < 0) == touched
    assert rollouts.successes[0] != touched


def test_each_bottle_costs_two(task: BottlesTask) -> None:
    # grazes bottle 0, then between the bottles, around bottle 1
    one = polyline((0.55, -0.2), (0.5, -0.1), (0.4, 0.0), (0.4, 0.05))
    # around both bottles on one side: none touched, not crossed
    around = polyline((0.4, -0.3), (0.4, 0.1))
    rollouts = task.simulate(BOTTLES, np.stack([one, around]))
    np.testing.assert_array_equal(rollouts.terms["bottles_down"], [-2.0, 0.0])
    assert rollouts.terms["not_crossed"][1] == -4.0
    assert not rollouts.successes.any()


def test_a_path_that_ends_short_of_the_goal_is_no_success(task: BottlesTask) -> None:
    expert = task.demonstrate(BOTTLES)
    for ends, solved in ((-0.015, True), (-0.03, False)):
        path = expert.copy()
        path[-20:, 1] = np.minimum(path[-20:, 1], GOAL[1] + ends)
        rollouts = task.simulate(BOTTLES, path)
        assert rollouts.rewards[0] > -0.2
        assert rollouts.successes[0] == solved


def test_crossing_counts_odd_changes_of_side_between_the_bottles_only() -> None:
    paths = {
        "s": polyline((0.6, -0.2), (0.4, 0.0)),
        "line": polyline((0.5, 0.0)),
        "there and back": polyline((0.6, -0.2), (0.4, -0.12), (0.6, -0.06), (0.6, 0.0)),
        "before the bottles": polyline((0.6, -0.3), (0.4, -0.25), (0.4, 0.1)),
        "behind the bottles": polyline((0.6, -0.2), (0.6, 0.1), (0.4, 0.2)),
        "three times": polyline((0.6, -0.2), (0.4, -0.15), (0.6, -0.1), (0.4, -0.05), (0.4, 0.0)),
    }
    bottles = np.broadcast_to(CENTRES, (len(paths), 2, 2))
    crossed = crosses_between(np.stack(list(paths.values())), bottles)
    assert dict(zip(paths, crossed.tolist(), strict=True)) == {
        "s": True,
        "line": False,
        "there and back": False,
        "before the bottles": False,
        "behind the bottles": False,
        "three times": True,
    }


def test_crossing_does_not_depend_on_where_the_bottles_stand() -> None:
    """Turning and moving bottles and path together changes nothing."""
    rng = np.random.default_rng(0)
    paths = np.cumsum(rng.normal(0, 0.02, (50, T, 2)), axis=1) + np.array([0.5, -0.1])
    plain = crosses_between(paths, np.broadcast_to(CENTRES, (50, 2, 2)))
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned = crosses_between(paths @ turn.T + 1, np.broadcast_to(CENTRES @ turn.T + 1, (50, 2, 2)))
    assert plain.any() and not plain.all()
    np.testing.assert_array_equal(plain, turned)


def test_a_touched_bottle_moves_and_an_untouched_one_stands_still(task: BottlesTask) -> None:
    through = polyline((0.48, -0.2), (0.6, -0.1), (0.6, 0.1))
    rollouts = task.simulate(BOTTLES, np.stack([through, task.demonstrate(BOTTLES)]))
    start, end = rollouts.paths["bottle_0"][:, 0, :2], rollouts.paths["bottle_0"][:, -1, :2]
    moved = np.linalg.norm(end - start, axis=1)
    assert moved[0] > 0.02
    assert moved[1] < 1e-4


def test_the_servo_follows_smooth_paths_within_five_millimetres(task: BottlesTask) -> None:
    rollouts = task.simulate(BOTTLES, task.demonstrate(BOTTLES))
    error = np.linalg.norm(rollouts.executed - rollouts.trajectories, axis=2)
    assert error.max() < 0.005


def test_random_bottles_are_drawn_and_solvable() -> None:
    task = make_task("nmp/Bottles-v0", random_bottles=True)
    rng = np.random.default_rng(0)
    contexts = np.stack([task.sample_context(rng) for _ in range(50)])
    assert (contexts.std(axis=0) > 0.01).all()
    for mode in task.modes:
        expert = np.stack([task.demonstrate(context, mode) for context in contexts])
        assert task.simulate(contexts, expert).successes.all()
