"""Trajectories of any length, recorded at any times, brought to one length by interpolation."""

from collections.abc import Sequence
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sb3_nmp.common.exceptions import InvalidDataError


def resample(
    trajectories: Sequence[ArrayLike],
    n_steps: int,
    times: Sequence[ArrayLike] | None = None,
) -> NDArray[np.float64]:
    """Return trajectories at equal distances in time, all of one length, shape (N, n_steps, D).

    Interpolation is linear, so that no value lies outside what was recorded; the first and the last
    point of each stay.

    >>> resample([[[0.0], [1.0]], [[0.0], [2.0], [8.0]]], 3)[..., 0].tolist()
    [[0.0, 0.5, 1.0], [0.0, 2.0, 8.0]]
    >>> resample([[[0.0], [2.0], [8.0]]], 3, times=[[0.0, 0.1, 0.4]])[..., 0].tolist()
    [[0.0, 4.0, 8.0]]

    :param trajectories: N of them, each of shape (T_i, D)
    :param n_steps: time points of the result, at least 2
    :param times: of the points of each trajectory, shape (T_i,), in any unit; None: at equal
        distances
    :raises InvalidDataError: fewer than 2 points, times that do not increase, or shapes that do not
        fit
    """
    if not isinstance(n_steps, Integral) or n_steps < 2:
        raise InvalidDataError(
            f"n_steps is {n_steps!r}; it must be a whole number of time points, at least 2."
        )
    rows = [_numbers(i, each) for i, each in enumerate(trajectories)]
    dimensions = {row.shape[1:] for row in rows}
    if len(dimensions) > 1:
        raise InvalidDataError(
            f"the trajectories have time points of the shapes {sorted(dimensions)}; all must have "
            "the same dimensions."
        )
    given = [np.arange(len(row)) for row in rows] if times is None else times
    if len(given) != len(rows):
        raise InvalidDataError(f"times of {len(given)} trajectories were given for {len(rows)}.")
    return np.stack(
        [_one(i, r, t, n_steps) for i, (r, t) in enumerate(zip(rows, given, strict=True))]
    )


def _numbers(index: int, trajectory: ArrayLike) -> NDArray[np.float64]:
    """Return a trajectory as an array."""
    try:
        return np.asarray(trajectory, np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidDataError(
            f"trajectory {index} is {trajectory!r}; it must be numbers of shape (T, D)."
        ) from error


def _one(
    index: int, row: NDArray[np.float64], times: ArrayLike, n_steps: int
) -> NDArray[np.float64]:
    at = np.asarray(times, np.float64)
    if row.ndim != 2 or len(row) < 2 or at.shape != (len(row),):
        raise InvalidDataError(
            f"trajectory {index} has shape {row.shape} and times of shape {at.shape}; (T, D) and "
            "(T,) are needed, T at least 2."
        )
    if not (np.diff(at) > 0).all():
        late = int(np.flatnonzero(~(np.diff(at) > 0))[0])
        raise InvalidDataError(
            f"the times of trajectory {index} do not increase: {at[late]} is followed by "
            f"{at[late + 1]} at point {late + 1}."
        )
    wanted = np.linspace(at[0], at[-1], n_steps)
    return np.stack([np.interp(wanted, at, column) for column in row.T], axis=1)


def of_one_length(
    trajectories: Sequence[NDArray[np.float64]],
    times: Sequence[NDArray[np.float64]] | None,
    n_steps: int | None,
    source: str,
) -> NDArray[np.float64]:
    """Return recorded trajectories as one array, shape (N, T, D).

    :param trajectories: each of shape (T_i, D)
    :param times: of their points; None: at equal distances
    :param n_steps: T; None takes them as they are
    :param source: where they are from, for the message
    :raises InvalidDataError: they differ in length, and ``n_steps`` is None
    """
    if n_steps is not None:
        return resample(trajectories, n_steps, times)
    lengths = sorted({len(each) for each in trajectories})
    if len(lengths) > 1:
        raise InvalidDataError(
            f"the demonstrations in {source} have {lengths[0]} to {lengths[-1]} time points; give "
            f"n_steps={lengths[-1]}, or another number, to bring them to one length."
        )
    return np.stack(trajectories)
