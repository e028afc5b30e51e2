"""Interpolation, speed limits, smooth moves, and the cache by context."""

import numpy as np

from benchmark_envs.cache import ContextCache
from benchmark_envs.motion import interpolate, limit_speed, minimum_jerk


def test_interpolation_reaches_every_set_point_on_straight_lines() -> None:
    trajectories = np.random.default_rng(0).normal(size=(3, 5, 2))
    steps = interpolate(np.zeros(2), trajectories, 4)
    assert steps.shape == (3, 20, 2)
    np.testing.assert_allclose(steps[:, 3::4], trajectories, atol=1e-12)
    np.testing.assert_allclose(steps[:, 1], trajectories[:, 0] / 2)


def test_only_fast_trajectories_are_held_back_and_each_alone() -> None:
    rng = np.random.default_rng(0)
    largest, start = np.array([0.1, 0.2]), np.array([1.0, -1.0])
    slow = start + 0.05 * np.sin(np.linspace(0, 3, 50))[:, None]
    fast = start + rng.uniform(-3, 3, (50, 2))
    followed = limit_speed(start, np.stack([slow, fast]), largest)
    np.testing.assert_array_equal(followed[0], slow)
    assert (np.abs(np.diff(followed[1], axis=0, prepend=start[None])) <= largest + 1e-12).all()
    np.testing.assert_array_equal(followed[1], limit_speed(start, fast[None], largest)[0])


def test_a_held_back_robot_catches_up_with_a_set_point_that_waits() -> None:
    jump = np.ones((1, 20, 1))
    followed = limit_speed(np.zeros(1), jump, 0.15)[0, :, 0]
    np.testing.assert_allclose(followed, np.minimum(0.15 * np.arange(1, 21), 1.0))


def test_a_minimum_jerk_move_goes_from_0_to_1_with_smooth_ends() -> None:
    np.testing.assert_allclose(minimum_jerk(np.array([-1, 0, 0.5, 1, 2])), [0, 0, 0.5, 1, 1])
    done = minimum_jerk(np.linspace(0, 1, 1001))
    assert (np.diff(done) >= 0).all() and np.abs(np.diff(done)[[0, -1]]).max() < 1e-7


def test_the_cache_makes_each_value_once_and_forgets_the_oldest() -> None:
    asked: list[float] = []

    def double(context: np.ndarray) -> float:
        asked.append(float(context[0]))
        return 2 * float(context[0])

    cache = ContextCache(double, 2)
    assert [cache[np.array([x])] for x in (1.0, 2.0, 1.0, 3.0)] == [2.0, 4.0, 2.0, 6.0]
    assert asked == [1.0, 2.0, 3.0] and len(cache) == 2
    assert cache[np.array([1.0])] == 2.0 and asked[-1] == 1.0
