"""A Gaussian process for a handful of points, whose kernel is chosen by evidence.

Shape letters: N known points, M queries, n coordinates, d what the kernel sees of them.
"""

from dataclasses import dataclass
from itertools import product
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular

FloatArray = NDArray[np.float64]


def kernel(one: FloatArray, other: FloatArray, length: float) -> FloatArray:
    """Return the squared-exponential correlation at every pair of points, shape (N, M).

    :param one: shape (N, d)
    :param other: shape (M, d)
    :param length: in units of sqrt(2 d), the typical distance of two draws from N(0, I)
    """
    squares = np.sum(one**2, axis=1)[:, None] + np.sum(other**2, axis=1) - 2 * one @ other.T
    return np.exp(-0.25 * np.maximum(squares, 0.0) / one.shape[1] / length**2)


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
    :param factor: lower Cholesky factor of the correlation matrix, with noise, shape (N, N)
    :param weights: its inverse times the values less their mean, shape (N,)
    """

    points: FloatArray
    view: FloatArray
    length: float
    noise: float
    variance: float
    mean: float
    factor: FloatArray
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
        mean = float(values.mean())
        best: tuple[float, GaussianProcess] | None = None
        for view in hypotheses.views:
            seen = points @ view
            for length, noise in product(hypotheses.lengths, hypotheses.noises):
                correlation = kernel(seen, seen, length) + noise * np.eye(len(points))
                factor, _ = cho_factor(correlation, lower=True)
                weights = cho_solve((factor, True), values - mean)
                variance = max(float((values - mean) @ weights) / len(values), 1e-9)
                evidence = -0.5 * len(values) * np.log(variance) - np.log(np.diag(factor)).sum()
                if best is None or evidence > best[0]:
                    known = (variance, mean, np.tril(factor), weights)
                    best = (evidence, cls(points, view, length, noise, *known))
        return cast(tuple[float, GaussianProcess], best)[1]

    def predict(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return means and standard deviations, each of shape (M,).

        :param points: shape (M, n)
        """
        cross = kernel(points @ self.view, self.points @ self.view, self.length)
        explained = np.sum(solve_triangular(self.factor, cross.T, lower=True) ** 2, axis=0)
        spread = np.sqrt(self.variance * np.maximum(1.0 - explained, 1e-9))
        return self.mean + cross @ self.weights, spread

    def condition_on_mean(self, points: FloatArray) -> "GaussianProcess":
        """Condition on the predicted means at these points (Kriging believer).

        With it, the next point of a generation goes elsewhere. Ginsbourger, Le Riche and Carraro,
        "Kriging is well-suited to parallelize optimization", 2010.

        :param points: shape (M, n)
        """
        values = self.mean + self.factor @ (self.factor.T @ self.weights)
        return GaussianProcess.fit(
            np.concatenate([self.points, points]),
            np.append(values, self.predict(points)[0]),
            Hypotheses((self.view,), (self.length,), (self.noise,)),
        )
