"""The obstacles task: its constants, ellipses against brute force, reward, success, the expert."""

import numpy as np
import pytest

from benchmark_envs import InvalidContextError, Task, TaskError, extrapolation, make_task
from benchmark_envs.tasks.obstacles import (
    ELLIPSES,
    HEIGHTS,
    TOLERANCE,
    VIA_X,
    T,
    touched_ellipses,
    two_humps,
)

X = np.linspace(-0.5, 0.5, T)
ALL = np.array(ELLIPSES)


@pytest.fixture(scope="module")
def task() -> Task:
    return make_task("nmp/Obstacles-v0")


def distance_by_brute_force(y: np.ndarray, ellipse: np.ndarray) -> float:
    """Least scaled distance of densely sampled points of a curve from an ellipse's centre."""
    x = np.linspace(-0.5, 0.5, 40 * (T - 1) + 1)
    dense = np.interp(x, X, y)
    return float(np.hypot((x - ellipse[0]) / ellipse[2], (dense - ellipse[1]) / ellipse[3]).min())


def test_touching_agrees_with_densely_sampled_curves_on_ellipses_of_all_sizes() -> None:
    rng, n_touched, n_checked = np.random.default_rng(0), 0, 0
    for _ in range(40):
        knots = rng.uniform(-0.6, 0.6, rng.integers(3, 30))
        y = np.interp(X, np.linspace(-0.5, 0.5, len(knots)), knots)
        ellipses = np.column_stack([
            rng.uniform(-0.6, 0.6, 8), rng.uniform(-0.6, 0.6, 8),
            10 ** rng.uniform(-3, -0.7, 8), 10 ** rng.uniform(-3, -0.7, 8),
        ])  # fmt: skip
        found = touched_ellipses(y[None], ellipses)[0]
        for ellipse, touched in zip(ellipses, found, strict=True):
            distance = distance_by_brute_force(y, ellipse)
            if not 0.999 < distance < 1.05:  # sampling may pass a touching point by
                assert touched == (distance <= 1.0)
                n_touched, n_checked = n_touched + int(touched), n_checked + 1
    assert 20 < n_touched < n_checked - 20


def test_an_ellipse_between_two_time_points_is_touched() -> None:
    """It is thinner than the step along x: only the segment meets it, no time point does."""
    steep = np.where(np.arange(T) <= 100, -1.0, 1.0)
    between = float(X[100] + X[101]) / 2
    thin = np.array([[between, 0.0, 1e-3, 1e-3], [between, 0.0, 1e-3, 5.0], [0.4, 0.0, 0.05, 0.9]])
    assert touched_ellipses(steep[None], thin)[0].tolist() == [True, True, False]
    points = np.hypot((X - thin[0, 0]) / thin[0, 2], (steep - thin[0, 1]) / thin[0, 3])
    assert points.min() > 1


def test_a_curve_that_grazes_an_ellipse_touches_it() -> None:
    ellipse = np.array([[0.0, 0.2, 0.1, 0.05]])
    heights = np.array([0.1499, 0.1501, 0.2499, 0.2501])
    found = touched_ellipses(np.repeat(heights[:, None], T, axis=1), ellipse)
    assert found[:, 0].tolist() == [False, True, True, False]


def test_the_six_demonstrations_are_those_of_the_published_code_and_clear_the_ellipses(
    task: Task,
) -> None:
    shown, _ = extrapolation("nmp/Obstacles-v0", 0)
    curves = np.stack([task.demonstrate(context) for context in shown])
    left, right = (np.exp(-((X - c) ** 2) / (2 * 0.15**2)) for c in (-0.25, 0.25))
    expected = np.array([-0.6, -0.4, -0.2, 0.2, 0.4, 0.6])[:, None] * (left + right - 0.25)
    np.testing.assert_allclose(curves[..., 0], expected, atol=1e-6)
    rollouts = task.simulate(shown, curves)
    assert rollouts.successes.all() and not rollouts.outcomes["touched"].any()
    assert rollouts.outcomes["ends"].max() < 0.001
    nearest = min(distance_by_brute_force(curve[:, 0], e) for curve in curves for e in ALL)
    assert 1.05 < nearest < 1.5, "cleared, and not by much"


def test_no_way_leads_between_the_ellipses_of_a_hump(task: Task) -> None:
    for height in np.linspace(-0.12, 0.12, 25):
        assert touched_ellipses(np.full((1, T), height), ALL).sum() >= 2


@pytest.mark.parametrize("number", range(4))
def test_the_expert_solves_what_no_demonstration_does(task: Task, number: int) -> None:
    shown, asked = extrapolation("nmp/Obstacles-v0", number)
    assert asked[0] == VIA_X and asked[1] > shown[:, 1].max() + 2 * TOLERANCE
    rollouts = task.simulate(asked, np.stack([task.demonstrate(c) for c in [*shown, asked]]))
    assert rollouts.successes.tolist() == [False] * len(HEIGHTS) + [True]
    assert rollouts.rewards[-1] == pytest.approx(0.0, abs=0.002)
    assert not rollouts.clipped.any()


def test_the_reward_is_minus_the_distance_at_the_via_point_alone(task: Task) -> None:
    context, rng = np.array([-0.31, 0.5]), np.random.default_rng(0)
    curves = rng.uniform(-1, 1, (20, T, 1))
    rollouts = task.simulate(context, curves)
    met = np.array([np.interp(-0.31, X, curve[:, 0]) for curve in curves])
    np.testing.assert_allclose(rollouts.rewards, -np.abs(met - 0.5), atol=1e-6)
    assert rollouts.step_rewards is not None
    np.testing.assert_allclose(rollouts.step_rewards.sum(axis=1), rollouts.rewards)
    nearest = int(np.abs(X + 0.31).argmin())
    assert (np.flatnonzero(rollouts.step_rewards.any(axis=0)) == nearest).all()


def test_success_asks_for_the_via_point_and_for_every_ellipse(task: Task) -> None:
    context = np.array([VIA_X, 0.6])
    good = task.demonstrate(context)
    dips = [good.copy() for _ in range(2)]
    dips[0][150] = 0.06  # into the right hump's upper ellipse
    dips[1][150] = 0.3  # a dip that ends above it
    shifted = [good + 0.9 * TOLERANCE, good + 1.1 * TOLERANCE]
    rollouts = task.simulate(context, np.stack([good, *dips, *shifted]))
    assert rollouts.successes.tolist() == [True, False, True, True, False]
    assert rollouts.outcomes["touched"].tolist() == [0, 1, 0, 0, 0]
    assert rollouts.outcomes["ends"][-1] == pytest.approx(1.1 * TOLERANCE, abs=0.001)


def test_the_flat_line_touches_all_and_drawn_contexts_lie_among_the_demonstrations(
    task: Task,
) -> None:
    rng = np.random.default_rng(0)
    contexts = np.stack([task.sample_context(rng) for _ in range(300)])
    factors = contexts[:, 1] / two_humps(contexts[:, 0])
    assert ((np.abs(factors) > 0.199) & (np.abs(factors) < 0.601)).all()
    assert 100 < (factors > 0).sum() < 200
    flat = task.simulate(contexts, np.stack([task.initial_trajectory(c) for c in contexts]))
    assert (flat.outcomes["touched"] == 4).all()


def test_what_does_not_exist_is_told_in_a_sentence(task: Task) -> None:
    with pytest.raises(TaskError, match="no extrapolation context 4; they are numbered 0 to 3"):
        extrapolation("nmp/Obstacles-v0", 4)
    with pytest.raises(InvalidContextError, match=r"via-point x \[m\]\) is 0.26, but must lie in"):
        task.demonstrate([0.26, 0.6])


def test_the_scene_holds_the_ellipses_and_the_via_point(task: Task) -> None:
    scene = task.scene([-0.25, 0.5])
    assert scene is not None and scene["targets"] == [[-0.25, 0.5]]
    np.testing.assert_allclose(
        [[*each["center"], *each["radii"]] for each in scene["ellipses"]], ALL
    )


def test_no_curve_earns_less_than_the_worst(task: Task) -> None:
    """The limit as the action space has it, in float32, is a little beyond the one in metres."""
    worst, best = task.reward_range
    lowest = np.full((1, *task.trajectory_space.shape), task.trajectory_space.low.min())
    context = np.array([task.context_space.low[0], 1.0])
    rewards = task.simulate(context, np.concatenate([lowest, -lowest])).rewards
    assert worst == rewards.min() and rewards.max() <= best
