"""`MotionLimits`: how fast, how abruptly a robot may move, and where a trajectory does not keep it.

Shape letters: N trajectories, T time points, D dimensions.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from benchmark_envs.arguments import as_numbers
from benchmark_envs.exceptions import InvalidTrajectoryError, TaskError
from benchmark_envs.rollouts import FloatArray

#: by name: how many times the positions are differentiated, and the unit of time
ORDERS = {"velocity": (1, "/s"), "acceleration": (2, "/s²"), "jerk": (3, "/s³")}


@dataclass(frozen=True)
class Violation:
    """Where a trajectory breaks a limit most, in one dimension.

    :param quantity: ``"velocity"``, ``"acceleration"`` or ``"jerk"``
    :param name: of the dimension
    :param unit: of the value
    :param value: the largest absolute one
    :param limit: that it exceeds
    :param time: at which it does, in s from the first set-point on
    :param trajectory: its number, where there are several
    """

    quantity: str
    name: str
    unit: str
    value: float
    limit: float
    time: float
    trajectory: int

    @property
    def slower(self) -> float:
        """By how much longer the motion must take to keep this limit."""
        return (self.value / self.limit) ** (1 / ORDERS[self.quantity][0])

    def __str__(self) -> str:
        """Tell it in a sentence's part."""
        return (
            f"{self.name}: {self.quantity} {self.value:.3g} {self.unit} at {self.time:.3g} s of "
            f"trajectory {self.trajectory}, the limit is {self.limit:.3g}"
        )


@dataclass(frozen=True)
class MotionLimits:
    """The largest absolute velocity, acceleration and jerk of set-points.

    They are differences of neighbouring set-points, divided by the time between them. The robot
    is taken to be at rest before the first set-point and after the last one, so a motion that
    begins abruptly breaks a limit, too.

    >>> limits = MotionLimits(velocity=1.0, acceleration=[20.0, 5.0])
    >>> rush = np.array([[0.0, 0.0], [0.0, 0.0], [0.2, 0.08], [0.2, 0.08]])
    >>> for violation in limits.violations(rush, dt=0.1, names=["elbow [rad]", "lift [m]"]):
    ...     print(violation)
    elbow: velocity 2 rad/s at 0.15 s of trajectory 0, the limit is 1
    lift: acceleration 8 m/s² at 0.1 s of trajectory 0, the limit is 5
    >>> limits.violations(0.5 * rush, dt=0.1)
    []

    :param velocity: in units of the trajectory per s: a number for all dimensions, or one each;
        None: no limit
    :param acceleration: the same, per s²
    :param jerk: the same, per s³
    :raises TaskError: a limit that is not positive
    """

    velocity: ArrayLike | None = None
    acceleration: ArrayLike | None = None
    jerk: ArrayLike | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        for quantity in ORDERS:
            limit, rule = getattr(self, quantity), "positive, a number for all dimensions or one"
            rule += " for each, or None for no limit"
            name = f"the limit of {quantity}"
            if limit is not None and not (as_numbers(name, limit, rule) > 0).all():
                raise TaskError(f"{name} is {limit}; it must be {rule}.")

    def violations(
        self,
        trajectories: Any,  # noqa: ANN401
        dt: float,
        names: Sequence[str] | None = None,
    ) -> list[Violation]:
        """Return where a limit is exceeded: for each quantity and dimension, the worst place.

        :param trajectories: shape (N, T, D) or (T, D), or anything that has such ``trajectories``,
            as `sb3_nmp.Demonstrations` has
        :param dt: between time points, in s
        :param names: of the dimensions, with their units as in `Task.trajectory_names`; ``q1`` and
            so on by default
        :raises InvalidTrajectoryError: another shape, or a value that is not finite
        :raises TaskError: a number of limits or names that is not D, or a time that is not positive
        """
        paths = _checked(getattr(trajectories, "trajectories", trajectories))
        if not isinstance(dt, Real) or not dt > 0:
            raise TaskError(f"dt is {dt!r}; the time between set-points must be positive, in s.")
        named = [f"q{i + 1}" for i in range(paths.shape[2])] if names is None else list(names)
        if len(named) != paths.shape[2]:
            raise TaskError(f"{len(named)} names were given for {paths.shape[2]} dimensions.")
        found: list[Violation] = []
        for quantity, (order, per) in ORDERS.items():
            limit = getattr(self, quantity)
            if limit is not None:
                values, allowed = derivative(paths, dt, order), self._each(quantity, paths)
                found += _worst(values, allowed, quantity, per, named, dt)
        return found

    def check(
        self,
        trajectories: Any,  # noqa: ANN401
        dt: float,
        names: Sequence[str] | None = None,
    ) -> None:
        """Raise where a limit is exceeded, and tell how much slower the motion would have to be.

        :param trajectories: as in `violations`
        :param dt: between time points, in s
        :param names: of the dimensions
        :raises TaskError: a limit is exceeded; the message names each
        """
        found = self.violations(trajectories, dt, names)
        if found:
            slower = max(violation.slower for violation in found)
            raise TaskError(
                f"limits are exceeded. {'; '.join(map(str, found))}. The motion keeps them if it "
                f"takes {slower:.3g} times as long."
            )

    def _each(self, quantity: str, paths: FloatArray) -> FloatArray:
        limit = np.asarray(getattr(self, quantity), np.float64)
        if limit.shape not in ((), (1,), paths.shape[2:]):
            raise TaskError(
                f"the limit of {quantity} has shape {limit.shape}; give one number, or one for "
                f"each of the {paths.shape[2]} dimensions."
            )
        return np.broadcast_to(limit, paths.shape[2:])


def derivative(paths: FloatArray, dt: float, order: int) -> FloatArray:
    """Return differences of set-points over time, at rest before and after, (N, T + order, D).

    Entry t is about the time ``(t - order / 2) * dt`` after the first set-point.

    :param paths: shape (N, T, D)
    :param dt: between time points, in s
    :param order: how many times they are differentiated
    """
    padded = np.pad(paths, ((0, 0), (order, order), (0, 0)), mode="edge")
    return np.diff(padded, n=order, axis=1) / dt**order


def _worst(
    values: FloatArray, allowed: FloatArray, quantity: str, per: str, names: list[str], dt: float
) -> list[Violation]:
    """Return the worst place of each dimension in which there is one."""
    found, sizes = [], np.abs(values)
    for d, name in enumerate(names):
        n, t = np.unravel_index(int(sizes[..., d].argmax()), sizes.shape[:2])
        value = float(sizes[n, t, d])
        if value > allowed[d] * (1 + 1e-9):  # rounding of the differences
            label, _, unit = name.partition(" [")
            time = max(0.0, (int(t) - ORDERS[quantity][0] / 2) * dt)
            found.append(
                Violation(
                    quantity, label, f"{unit.rstrip(']')}{per}", value, float(allowed[d]), time,
                    int(n),
                )
            )  # fmt: skip
    return found


def _checked(trajectories: ArrayLike) -> FloatArray:
    rule = "numbers, of shape (N, T, D) or (T, D)"
    paths = as_numbers("the trajectory", trajectories, rule, InvalidTrajectoryError)
    paths = paths[None] if paths.ndim == 2 else paths
    if paths.ndim != 3 or 0 in paths.shape:
        raise InvalidTrajectoryError(
            f"trajectories have shape {np.shape(trajectories)}; (N, T, D) or (T, D) is needed."
        )
    if not np.isfinite(paths).all():
        n, t, d = (int(i) for i in np.argwhere(~np.isfinite(paths))[0])
        raise InvalidTrajectoryError(
            f"trajectory {n} holds {paths[n, t, d]} at time point {t}, dimension {d}; every "
            "set-point must be a finite number."
        )
    return paths
