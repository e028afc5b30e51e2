"""Trajectories that pass via-points: what a network leaves is closed by Gaussian conditioning.

The deviation ``e(t)`` of a trajectory from the network's answer has a Gaussian prior over time,

    cov(e_d(t), e_d'(t')) = sum_r F_rd(t) F_rd'(t') + [d = d'] s_d^2 sum_l a_l k(|t - t'| / l),

with ``F`` the demonstrations' principal deviations from their mean, so that the first part is their
own covariance, ``s`` their standard deviations over all times, and ``k`` Matern's kernel 3/2 at
some lengths ``l`` with small shares ``a_l``. Given points ``y`` at times that ``H`` interpolates,

    x + K H' (H K H' + n^2 I)^-1 (y - H x)

passes them. Where the demonstrations can pass them the deviation is one of theirs; the smooth part
does what they cannot. This is the conditioning of a ProMP (Paraschos et al. 2013, Eq. 5 and 6)
around the network's answer, without bases, and with a part that reaches every point.

Shape letters: T time points, D dimensions, O points, R principal deviations, N trajectories.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch as th
from numpy.typing import ArrayLike, NDArray

from sb3_nmp.common.exceptions import InvalidDataError

FloatArray = NDArray[np.float64]

#: R: so many principal deviations are kept
N_SHAPES = 32
#: lengths of the smooth part, in units of the duration, and the shares of their variances; short
#: ones keep two points close in time from throwing the rest far off
SMOOTH = ((0.2, 1e-2), (0.05, 2.5e-3), (0.0125, 6e-4))
#: of the values' standard deviation: a dimension in which demonstrations agree varies by so much
LEAST_SPREAD = 0.01
#: accuracy at the points, in units of s
ACCURACY = 1e-4
#: of a dimension's demonstrated range: points are met to this
TOLERANCE = 0.01


@dataclass(frozen=True)
class Points:
    """Via-points that have been checked.

    :param times: in [0, 1], shape (O,)
    :param values: in the trajectory's unit, shape (O, D)
    """

    times: th.Tensor
    values: th.Tensor

    def at(self, n_time_points: int) -> th.Tensor:
        """Return H, by which a trajectory is interpolated at the points' times, shape (O, T).

        :param n_time_points: T
        """
        place = self.times.double() * (n_time_points - 1)
        before = place.long().clamp(max=n_time_points - 2)
        after = (place - before)[:, None]
        rows = th.eye(n_time_points, dtype=th.float64, device=place.device)
        return (1 - after) * rows[before] + after * rows[before + 1]


def checked(
    points: tuple[ArrayLike, ArrayLike], n_time_points: int, value_range: th.Tensor
) -> Points:
    """Return via-points as tensors.

    :param points: times in [0, 1], shape (O,), and values, shape (O, D)
    :param n_time_points: T
    :param value_range: of the demonstrations in each dimension, shape (D,)
    :raises InvalidDataError: a wrong shape, a time outside [0, 1], a non-finite value, or two
        points within one time step whose values contradict each other
    """
    try:
        times, values = (np.asarray(part, np.float32) for part in points)
    except (TypeError, ValueError) as error:
        raise InvalidDataError(
            f"via_points is {points!r}; it must be a pair of arrays of numbers: times (O,) and "
            "values (O, D)."
        ) from error
    expected = (*times.shape, len(value_range))
    if times.ndim != 1 or len(times) == 0 or values.shape != expected:
        raise InvalidDataError(
            f"via-points have times of shape {times.shape} and values of shape {values.shape}; "
            f"they need (O,) and (O, D) with O >= 1 and D = {expected[-1]}."
        )
    if not (np.isfinite(values).all() and (times >= 0).all() and (times <= 1).all()):
        raise InvalidDataError(
            f"via-points at times {times.tolist()}: times must lie in [0, 1], scaled by the "
            "trajectory's duration, and values must be finite."
        )
    _check_agreement(times, values, n_time_points, TOLERANCE * value_range.cpu().numpy())
    device = value_range.device
    return Points(th.as_tensor(times, device=device), th.as_tensor(values, device=device))


def _check_agreement(
    times: NDArray[np.float32],
    values: NDArray[np.float32],
    n_time_points: int,
    tolerance: FloatArray,
) -> None:
    step = 1.0 / (n_time_points - 1)
    order = np.argsort(times, kind="stable")
    for i, j in pairwise(order):
        near = times[j] - times[i] < 0.999 * step
        if near and (np.abs(values[j] - values[i]) > tolerance).any():
            raise InvalidDataError(
                f"via-points {i} and {j}, at times {times[i]:.4g} and {times[j]:.4g}, have values "
                f"{values[i].tolist()} and {values[j].tolist()}: points less than one time step "
                f"({step:.4g}) apart must agree; leave one out, or move one in time."
            )


def check_inside(points: Points, low: NDArray[Any], high: NDArray[Any]) -> None:
    """Refuse points that the action space does not allow at any neighbouring time step.

    :param points: to check
    :param low: of the action space, shape (T, D)
    :param high: of the action space, shape (T, D)
    :raises InvalidDataError: a point outside
    """
    place = points.times.cpu().numpy() * (len(low) - 1)
    before, after = np.floor(place).astype(int), np.ceil(place).astype(int)
    least, most = np.minimum(low[before], low[after]), np.maximum(high[before], high[after])
    values = points.values.cpu().numpy()
    for point, dimension in np.argwhere((values < least) | (values > most)):
        raise InvalidDataError(
            f"via-point {point} at time {points.times[point]:.4g} has the value "
            f"{values[point, dimension]:.4g} in dimension {dimension}; the action space allows "
            f"{least[point, dimension]:.4g} to {most[point, dimension]:.4g} there: give a value "
            "inside, or widen the action space."
        )


def principal_deviations(trajectories: FloatArray) -> FloatArray:
    """Return F, of which the sum of squares over R is the covariance, shape (R, T, D).

    There are `N_SHAPES` rows; those beyond the number of trajectories are zero.

    :param trajectories: demonstrated, shape (N, T, D)
    """
    n, *shape = trajectories.shape
    deviations = (trajectories - trajectories.mean(axis=0)).reshape(n, -1)
    _, lengths, axes = np.linalg.svd(deviations, full_matrices=False)
    kept = min(len(lengths), N_SHAPES)
    found = np.zeros((N_SHAPES, deviations.shape[1]))
    found[:kept] = lengths[:kept, None] * axes[:kept] / n**0.5
    return found.reshape(N_SHAPES, *shape)


@dataclass(frozen=True)
class Prior:
    """The Gaussian prior of deviations from the network's answer; see the module.

    :param shapes: F, shape (R, T, D)
    :param scale: s, shape (D,)
    """

    shapes: th.Tensor
    scale: th.Tensor

    @classmethod
    def like(cls, shapes: th.Tensor, value_std: th.Tensor) -> "Prior":
        """Return the prior of deviations like the demonstrations'.

        :param shapes: F, shape (R, T, D)
        :param value_std: of the demonstrations' values over all times, shape (D,)
        """
        typical = shapes.square().sum(dim=0).mean(dim=0).sqrt()
        return cls(shapes, th.maximum(typical, LEAST_SPREAD * value_std))

    def covariance(self, left: th.Tensor, right: th.Tensor) -> th.Tensor:
        """Return that of the deviations interpolated by two matrices, shape (L * D, M * D).

        :param left: shape (L, T)
        :param right: shape (M, T)
        """
        shapes, variances = self.shapes.double(), self.scale.double() ** 2
        one, other = ((rows @ shapes).flatten(1) for rows in (left, right))
        n_time_points = shapes.shape[1]
        times = th.linspace(0, 1, n_time_points, dtype=th.float64, device=shapes.device)
        smooth = left @ _matern(times[:, None] - times) @ right.T
        return one.T @ other + th.kron(smooth, variances.diag())

    def given(self, points: Points) -> "Conditioning":
        """Return what is known of the deviations where the points are passed.

        :param points: to be passed
        """
        at = points.at(self.shapes.shape[1])
        everywhere = th.eye(at.shape[1], dtype=at.dtype, device=at.device)
        cross = self.covariance(everywhere, at)
        noise = (ACCURACY * self.scale.double()).square().repeat(len(at))
        inner = self.covariance(at, at) + noise.diag()
        gain = th.linalg.solve(inner, cross.T).T
        variance = self.covariance(everywhere, everywhere).diagonal()
        left = 1 - (gain * cross).sum(dim=1) / variance
        shape = self.shapes.shape[1:]
        return Conditioning(points, at, gain, left.clamp(min=0.0).sqrt().view(shape))


@dataclass(frozen=True)
class Conditioning:
    """How trajectories are moved to pass points.

    :param points: O of them
    :param at: H, shape (O, T)
    :param gain: ``K H' (H K H' + n^2 I)^-1``, shape (T * D, O * D)
    :param remaining: share of a standard deviation that is left, 0 at the points, shape (T, D)
    """

    points: Points
    at: th.Tensor
    gain: th.Tensor
    remaining: th.Tensor

    def misses(self, trajectories: th.Tensor) -> th.Tensor:
        """Return how much is lacking at the points, shape (*, O, D).

        :param trajectories: shape (*, T, D)
        """
        return self.points.values.double() - self.at @ trajectories.double()

    def moved(self, trajectories: th.Tensor) -> th.Tensor:
        """Return trajectories that pass the points, shape (*, T, D).

        :param trajectories: shape (*, T, D)
        """
        change = self.misses(trajectories).flatten(-2) @ self.gain.T
        return (trajectories.double() + change.view(trajectories.shape)).to(trajectories.dtype)


def _matern(differences: th.Tensor) -> th.Tensor:
    total = th.zeros_like(differences)
    for length, share in SMOOTH:
        scaled = 3**0.5 * differences.abs() / length
        total += share * (1 + scaled) * (-scaled).exp()
    return total
