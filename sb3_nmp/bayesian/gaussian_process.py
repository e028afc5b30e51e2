"""A Gaussian process for a handful of points, whose kernel is chosen by evidence.

Shape letters: N known points, M queries, n coordinates, d what the kernel sees of them.
"""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from sb3_nmp.common.settings import saved_state

FloatArray = NDArray[np.float64]
#: of a kernel, as a share of the values' variance; where they are all the same, in their unit
LEAST_VARIANCE = 1e-9
#: view, length, noise, variance, Cholesky factor of the correlation, weights
Choice = tuple[FloatArray, float, float, float, FloatArray, FloatArray]


def squared_distances(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the squared distance of every pair of points, shape (N, M).

    :param one: shape (N, d)
    :param other: shape (M, d)
    """
    squares = np.sum(one**2, axis=1)[:, None] + np.sum(other**2, axis=1) - 2 * one @ other.T
    return np.maximum(squares, 0.0)


def kernel(squares: FloatArray, n_seen: int, length: float) -> FloatArray:
    """Return the squared-exponential correlation of pairs of points, of the same shape.

    :param squares: squared distances
    :param n_seen: d
    :param length: in units of sqrt(2 d), the typical distance of two draws from N(0, I)
    """
    return np.exp(squares * (-0.25 / n_seen / length**2))


@saved_state("hypotheses")
@dataclass(frozen=True)
class Hypotheses:
    """What the evidence decides between.

    :param views: what the kernel may see of a point, matrices of shape (n, d), such that the d
        values of a draw from the exploration's distribution have a variance of about 1
    :param lengths: length scales, see `kernel`
    :param noises: variances of the noise, as shares of the kernel's
    """

    views: tuple[FloatArray, ...]
    lengths: tuple[float, ...]
    noises: tuple[float, ...]


@dataclass(frozen=True)
class GaussianProcess:
    """A Gaussian process with a squared-exponential kernel; `fit` makes one.

    It sees the points through a *view*, a linear map: a cost that depends on where a trajectory is
    at one moment, such as an error at the goal, is learned from far fewer rollouts by a process
    that looks at that moment alone.

    Rasmussen and Williams, "Gaussian processes for machine learning", 2006, Alg. 2.1.

    >>> points = np.linspace(-2.0, 2.0, 9)[:, None]
    >>> hypotheses = Hypotheses((np.eye(1),), (0.6, 1.3), (1e-4,))
    >>> process = GaussianProcess.fit(points, np.sin(points[:, 0]), hypotheses)
    >>> mean, std = process.predict(np.array([[0.3]]))
    >>> bool(abs(mean[0] - np.sin(0.3)) < 0.01)
    True

    :param points: shape (N, n)
    :param view: what the kernel sees of a point: ``point @ view``, shape (n, d)
    :param length: of the kernel, see `kernel`
    :param noise: its variance, as a share of the kernel's
    :param variance: of the kernel
    :param mean: of the values
    :param whitening: inverse of the lower Cholesky factor of the correlation matrix, with noise,
        shape (N, N)
    :param weights: inverse of the correlation matrix times the values less their mean, shape (N,)
    """

    points: FloatArray
    view: FloatArray
    length: float
    noise: float
    variance: float
    mean: float
    whitening: FloatArray
    weights: FloatArray

    @classmethod
    def fit(
        cls, points: FloatArray, values: FloatArray, hypotheses: Hypotheses
    ) -> "GaussianProcess":
        """Choose the view, length scale and noise of largest marginal likelihood.

        :param points: shape (N, n)
        :param values: shape (N,)
        :param hypotheses: to choose from
        """
        mean, n, spread = float(values.mean()), len(values), float(values.var())
        is_flat = spread <= 1e-24 * mean**2  # but for rounding
        least = LEAST_VARIANCE * (1.0 if is_flat else spread)
        best, chosen = -np.inf, None
        for view in hypotheses.views:
            seen = points @ view
            squares = squared_distances(seen, seen)
            for length in hypotheses.lengths:
                correlation = kernel(squares, view.shape[1], length)
                for noise in hypotheses.noises:
                    noisy = correlation + noise * np.eye(n)
                    factor, _ = cho_factor(noisy, lower=True, check_finite=False)
                    weights = cho_solve((factor, True), values - mean, check_finite=False)
                    variance = max(float((values - mean) @ weights) / n, least)
                    evidence = -0.5 * n * np.log(variance) - np.log(np.diag(factor)).sum()
                    if chosen is None or evidence > best:
                        best = evidence
                        chosen = (view, length, noise, variance, factor, weights)
        view, length, noise, variance, factor, weights = cast(Choice, chosen)
        whitening = solve_triangular(factor, np.eye(n), lower=True)
        return cls(points, view, length, noise, variance, mean, whitening, weights)

    @property
    def chosen(self) -> Hypotheses:
        """The view, length scale and noise that were chosen, for a process of more points."""
        return Hypotheses((self.view,), (self.length,), (self.noise,))

    def _correlation(self, points: FloatArray, others: FloatArray) -> FloatArray:
        squares = squared_distances(points @ self.view, others @ self.view)
        return kernel(squares, self.view.shape[1], self.length)

    def predict(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return means and standard deviations, each of shape (M,).

        :param points: shape (M, n)
        """
        cross = self._correlation(points, self.points)
        explained = np.sum((cross @ self.whitening.T) ** 2, axis=1)
        spread = np.sqrt(self.variance * np.maximum(1.0 - explained, 1e-9))
        return self.mean + cross @ self.weights, spread

    def condition_on_mean(self, point: FloatArray) -> "GaussianProcess":
        """Condition on the predicted mean at a point (Kriging believer).

        The means stay, and what is unknown near the point shrinks: the next point of a generation
        goes elsewhere. Ginsbourger, Le Riche and Carraro, "Kriging is well-suited to parallelize
        optimization", 2010.

        :param point: shape (n,)
        """
        row = self.whitening @ self._correlation(self.points, point[None])[:, 0]
        last = np.sqrt(max(1.0 + self.noise - row @ row, self.noise))
        n = len(self.points)
        whitening = np.zeros((n + 1, n + 1))
        whitening[:n, :n] = self.whitening
        whitening[n] = np.append(-row @ self.whitening, 1.0) / last
        return replace(
            self,
            points=np.concatenate([self.points, point[None]]),
            whitening=whitening,
            weights=np.append(self.weights, 0.0),
        )
