"""`Primitive`: a trajectory that is linear in its weights, its start and its goal.

Shape letters: N rollouts, T time points, D dimensions, K bases per dimension.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Response:
    """What a primitive makes of unit inputs: ``x = weights @ w + start * x0 + goal * g``.

    :param weights: to each weight of a dimension, shape (T, K)
    :param start: to the start, shape (T, 1)
    :param goal: to the goal, shape (T, 1)
    """

    weights: FloatArray
    start: FloatArray
    goal: FloatArray


class Primitive(ABC):
    """A movement primitive whose trajectories are linear in (weights, start, goal).

    All dimensions share the bases; a batch of rollouts is one matrix product.
    """

    n_bases: int
    n_time_points: int

    @abstractmethod
    def response(self) -> Response:
        """Return the linear map from weights, start and goal to a dimension's trajectory."""

    def check(self) -> None:
        """Check the two sizes.

        :raises ConfigurationError: no whole number, or fewer than 2 bases or time points
        """
        for name in ("n_bases", "n_time_points"):
            given = getattr(self, name)
            if not isinstance(given, Integral) or given < 2:
                raise ConfigurationError(
                    f"{name} is {given!r}; it must be a whole number, and at least 2 are needed."
                )

    def check_number(self, name: str, low: float, high: float) -> None:
        """Check another setting.

        :param name: of it
        :param low: below it
        :param high: above it
        :raises ConfigurationError: no number, or none between these
        """
        given = getattr(self, name)
        number = isinstance(given, int | float | np.number) and not isinstance(given, bool)
        if not number or not low < given < high:
            raise ConfigurationError(
                f"{name} is {given!r}; it must be a number and lie in ({low:g}, {high:g})."
            )

    def trajectories(self, weights: ArrayLike, start: ArrayLike, goal: ArrayLike) -> FloatArray:
        """Return the trajectories of a batch of weights, shape (N, T, D).

        :param weights: shape (N, K, D)
        :param start: where the movement starts, shape (D,) or (N, 1, D)
        :param goal: where it ends, shape (D,) or (N, 1, D)
        :raises InvalidDataError: the weights have the wrong shape
        """
        w = np.asarray(weights, np.float64)
        if w.ndim != 3 or w.shape[1] != self.n_bases:
            raise InvalidDataError(
                f"weights have shape {w.shape}; {type(self).__name__} with {self.n_bases} bases "
                f"needs (N, {self.n_bases}, D)."
            )
        response = self.response()
        constant = response.start * np.asarray(start) + response.goal * np.asarray(goal)
        return response.weights @ w + constant

    def fit(self, trajectory: ArrayLike, ridge: float = 1e-9) -> FloatArray:
        """Return the weights whose trajectory is nearest to a given one, shape (K, D).

        Ridge regression on the trajectory itself; its first and last point are start and goal.

        :param trajectory: shape (T, D)
        :param ridge: penalty on the squared weights, relative to the bases' mean square
        :raises InvalidDataError: the trajectory has the wrong shape
        """
        y = np.asarray(trajectory, np.float64)
        if y.ndim != 2 or len(y) != self.n_time_points:
            raise InvalidDataError(
                f"the trajectory has shape {y.shape}; this primitive's has "
                f"({self.n_time_points}, D): {self.n_time_points} time points."
            )
        response = self.response()
        bases = response.weights
        gram = bases.T @ bases
        gram += ridge * np.trace(gram) / self.n_bases * np.eye(self.n_bases)
        return np.linalg.solve(gram, bases.T @ (y - response.start * y[0] - response.goal * y[-1]))

    def weight_std(self, sigma: ArrayLike) -> FloatArray:
        """Return the standard deviation of independent weights that explores at a given scale.

        The trajectory's standard deviation, as root mean square over time, is then ``sigma``: the
        same scale for every primitive and for `sb3_nmp.common.noise.SmoothNoise`.

        :param sigma: in the trajectory's unit, shape () or (D,)
        :return: same shape
        """
        gain = np.sqrt(np.sum(self.response().weights ** 2) / self.n_time_points)
        return np.asarray(sigma, np.float64) / gain
