"""`ProMP`: probabilistic movement primitives (Paraschos et al. 2013)."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from baselines.primitives.primitive import FloatArray, Primitive, Response
from baselines.primitives.weight_distribution import WeightDistribution
from sb3_nmp.common.exceptions import InvalidDataError
from sb3_nmp.common.settings import settings_name


@settings_name("promp")
@dataclass(frozen=True)
class ProMP(Primitive):
    """A trajectory as a weighted mean of the weights, by normalised Gaussian bases over time.

    ``y(t) = Phi(t) w`` with ``sum_k Phi_k(t) = 1``; start and goal are part of the weights.

    Paraschos, Daniel, Peters and Neumann, "Probabilistic movement primitives", 2013.

    >>> promp = ProMP(n_bases=8, n_time_points=100)
    >>> line = np.linspace([0.0, 0.0], [1.0, 2.0], 100)
    >>> weights = promp.fit(line)
    >>> bool(np.abs(promp.trajectories(weights[None], line[0], line[-1])[0] - line).max() < 0.01)
    True

    :param n_bases: K, evenly spaced over [0, 1]
    :param n_time_points: T, evenly spaced over [0, 1]
    :param width: standard deviation of a basis, in units of the bases' spacing
    :raises ConfigurationError: a value outside its range
    """

    n_bases: int = 10
    n_time_points: int = 200
    width: float = 1.0

    def __post_init__(self) -> None:
        """Check the values."""
        self.check()
        self.check_number("width", 0.0, np.inf)

    def response(self) -> Response:
        """Return the bases; start and goal have no effect of their own."""
        return _response(self)

    def bases(self, times: ArrayLike) -> FloatArray:
        """Return the normalised bases at some times, shape (O, K).

        :param times: in [0, 1], shape (O,)
        """
        centres = np.linspace(0.0, 1.0, self.n_bases)
        distance = np.asarray(times, np.float64)[:, None] - centres
        exponent = -0.5 * (distance * (self.n_bases - 1) / self.width) ** 2
        values = np.exp(exponent - exponent.max(axis=1, keepdims=True))
        return values / values.sum(axis=1, keepdims=True)

    def distribution(self, trajectories: ArrayLike, ridge: float = 1e-6) -> WeightDistribution:
        """Return the Gaussian over weights that demonstrations suggest.

        :param trajectories: shape (N, T, D); of a single one the covariance is 0
        :param ridge: penalty on the squared weights, relative to the bases' mean square
        """
        fits = np.stack([self.fit(trajectory, ridge) for trajectory in np.asarray(trajectories)])
        flat = fits.reshape(len(fits), -1)
        deviations = flat - flat.mean(axis=0)
        covariance = deviations.T @ deviations / max(len(fits) - 1, 1)
        return WeightDistribution(fits.mean(axis=0), covariance)

    def condition(
        self,
        distribution: WeightDistribution,
        times: ArrayLike,
        values: ArrayLike,
        std: float = 1e-3,
    ) -> WeightDistribution:
        """Return the distribution given via-points (Paraschos et al. 2013, Eq. 5 and 6).

        :param distribution: of the weights
        :param times: of the via-points, in [0, 1], shape (O,)
        :param values: shape (O, D)
        :param std: accuracy with which the points are to be met, in the trajectory's unit
        :raises InvalidDataError: values do not fit the times or the weights
        """
        points = np.asarray(values, np.float64)
        expected = (len(np.asarray(times)), distribution.mean.shape[1])
        if points.shape != expected:
            raise InvalidDataError(f"values have shape {points.shape}; (O, D) is {expected} here.")
        n_dimensions = distribution.mean.shape[1]
        phi = np.kron(self.bases(times), np.eye(n_dimensions))  # (O D, K D)
        cross = distribution.covariance @ phi.T
        gain = np.linalg.solve(phi @ cross + std**2 * np.eye(len(phi)), cross.T).T
        mean = distribution.mean.ravel() + gain @ (points.ravel() - phi @ distribution.mean.ravel())
        covariance = distribution.covariance - gain @ cross.T
        return WeightDistribution(mean.reshape(-1, n_dimensions), (covariance + covariance.T) / 2)


@lru_cache(maxsize=16)
def _response(promp: ProMP) -> Response:
    bases = promp.bases(np.linspace(0.0, 1.0, promp.n_time_points))
    nothing = np.zeros((promp.n_time_points, 1))
    return Response(bases, nothing, nothing)
