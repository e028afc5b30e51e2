"""`ViaPose`: where the tip of an arm is to be, and when; and the smooth way through several."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from benchmark_envs.arguments import as_numbers
from benchmark_envs.exceptions import TaskError
from benchmark_envs.motion import minimum_jerk
from benchmark_envs.rollouts import FloatArray


@dataclass(frozen=True)
class ViaPose:
    """A pose that the tip is to pass, at rest.

    >>> ViaPose([0.4, 0.1, 0.2], at=0.5).counts
    True

    :param position: shape (3,) in m, in the world's frame
    :param at: when, as a part of the duration, in (0, 1]
    :param axis: where the tip's own axis (`Arm.axis`) is to point then, shape (3,); None: anywhere
    :param counts: whether the reward holds the tip against it
    :param tolerance: how far off the tip may be in a success, in m; None: the task's
    """

    position: ArrayLike
    at: float = 1.0
    axis: ArrayLike | None = None
    counts: bool = True
    tolerance: float | None = None


def check_way(way: Sequence[ViaPose]) -> Sequence[ViaPose]:
    """Return via-poses, or raise if there is no way through them.

    :param way: in the order of their times
    :raises TaskError: none, another type, times that do not rise within (0, 1], a wrong shape, or
        an axis for some alone
    """
    listed = isinstance(way, list | tuple) and way
    if not listed or not all(isinstance(each, ViaPose) for each in way):
        raise TaskError(f"the way is {way!r}; it must be a list of ViaPose, at least one.")
    for each in way:
        _check_numbers(each)
    times = [0.0, *(each.at for each in way)]
    if not all(one < other for one, other in pairwise(times)) or times[-1] > 1:
        raise TaskError(
            f"the via-poses are due at {times[1:]} of the duration; the times must rise, and lie "
            "in (0, 1]."
        )
    if len({each.axis is None for each in way}) > 1:
        raise TaskError("some via-poses have an axis and some have none; give it to all or none.")
    if not any(each.counts for each in way):
        raise TaskError("no via-pose counts; the reward needs at least one with counts=True.")
    return way


def _check_numbers(pose: ViaPose) -> None:
    """Raise unless position and axis are 3 finite numbers, and time and tolerance are numbers."""
    for name, given in (("position", pose.position), ("axis", pose.axis)):
        rule = "3 finite numbers"
        value = as_numbers(f"a via-pose's {name}", np.ones(3) if given is None else given, rule)
        if value.shape != (3,) or not np.isfinite(value).all():
            raise TaskError(f"a via-pose's {name} is {given}; it needs 3 finite numbers.")
        if name == "axis" and not value.any():
            raise TaskError(f"a via-pose's axis is {given}; give a direction, such as (0, 0, 1).")
    for name, number in (("at", pose.at), ("tolerance", pose.tolerance)):
        if not isinstance(number, Real | None) or (number is not None and not number > 0):
            raise TaskError(
                f"a via-pose's {name} is {number!r}; it must be a number > 0"
                f"{'' if name == 'at' else ', or None for the task' + chr(39) + 's'}."
            )


def smooth_way(
    start: FloatArray, way: Sequence[ViaPose], times: FloatArray
) -> tuple[FloatArray, FloatArray | None]:
    """Return where the tip is at each time, and where its axis points: minimum-jerk moves.

    :param start: position and axis at the beginning, shape (2, 3)
    :param way: via-poses, checked
    :param times: as parts of the duration, shape (T,)
    :return: positions (T, 3) in m, and unit axes (T, 3) or None
    """
    at = np.array([0.0, *(each.at for each in way)])
    share = np.clip((times[:, None] - at[:-1]) / np.diff(at), 0.0, 1.0)  # (T, moves)
    done = minimum_jerk(share)
    positions = _along(np.array([start[0], *(each.position for each in way)]), done)
    if way[0].axis is None:
        return positions, None
    axes = np.array([start[1], *(_unit(each.axis) for each in way)])
    return positions, np.array([_unit(axis) for axis in _along(axes, done)])


def _along(points: FloatArray, done: FloatArray) -> FloatArray:
    """Return points reached after parts of the moves between them, shape (T, 3)."""
    return points[0] + done @ np.diff(points, axis=0)


def _unit(axis: ArrayLike | None) -> FloatArray:
    given = np.asarray(axis, np.float64)
    length = float(np.linalg.norm(given))
    if length < 1e-9:
        raise TaskError(
            f"an axis is {given.tolist()}, or two axes that follow each other are opposite; give "
            "directions that a turn joins."
        )
    return given / length
