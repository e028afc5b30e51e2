"""Set-points over time: interpolation, speed limits, smooth moves, uniform speed."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def interpolate(start: FloatArray, trajectories: FloatArray, substeps: int) -> FloatArray:
    """Interpolate set-points linearly to simulation steps; a zero-order hold kicks contacts.

    >>> interpolate(np.zeros(1), np.array([[[1.0], [3.0]]]), 2).tolist()
    [[[0.5], [1.0], [2.0], [3.0]]]

    :param start: where the robot is before the first set-point, shape (N, D) or (D,)
    :param trajectories: shape (N, T, D)
    :param substeps: simulation steps per time point
    :return: shape (N, T * substeps, D); step ``(t + 1) * substeps - 1`` holds set-point t
    """
    n, _, d = trajectories.shape
    first = np.broadcast_to(start, (n, d))[:, None]
    before = np.concatenate([first, trajectories[:, :-1]], axis=1)[:, :, None]
    blend = (np.arange(1, substeps + 1) / substeps)[:, None]
    return (before + blend * (trajectories[:, :, None] - before)).reshape(n, -1, d)


def limit_speed(
    start: FloatArray, trajectories: FloatArray, largest: FloatArray | float
) -> FloatArray:
    """Return what robots command that follow set-points as fast as they may, shape (N, T, D).

    Set-points that can be followed are returned as they are, bit for bit.

    >>> limit_speed(np.zeros(1), np.ones((1, 3, 1)), 0.4).tolist()
    [[[0.4], [0.8], [1.0]]]

    :param start: where the robots are before the first set-point, shape (D,)
    :param trajectories: shape (N, T, D)
    :param largest: step from one time point to the next, shape (D,) or a number
    """
    first = np.broadcast_to(start, (len(trajectories), 1, trajectories.shape[2]))
    steps = np.diff(np.concatenate([first, trajectories], axis=1), axis=1)
    fast = np.flatnonzero((np.abs(steps) > largest).any(axis=(1, 2)))
    followed, at = trajectories.copy(), first[fast, 0]
    for t in range(trajectories.shape[1] if len(fast) else 0):  # each depends on the one before
        at = np.clip(trajectories[fast, t], at - largest, at + largest)
        followed[fast, t] = at
    return followed


def minimum_jerk(share: FloatArray) -> FloatArray:
    """Return the part of a way done by a minimum-jerk move (Flash & Hogan 1985), from 0 to 1.

    >>> minimum_jerk(np.array([0.0, 0.5, 1.0])).tolist()
    [0.0, 0.5, 1.0]

    :param share: of its duration, any shape; clipped to [0, 1]
    """
    s = np.clip(share, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def resample(path: FloatArray, n: int) -> FloatArray:
    """Return n points at uniform speed along a path, shape (n, D).

    >>> resample(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]]), 4)
    array([[0., 0.],
           [1., 0.],
           [1., 1.],
           [1., 2.]])

    :param path: shape (K, D)
    :param n: how many points
    """
    steps = [float(np.linalg.norm(b - a)) for a, b in pairwise(path)]
    length = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, length[-1], n)
    return np.stack([np.interp(at, length, path[:, i]) for i in range(path.shape[1])], axis=1)
