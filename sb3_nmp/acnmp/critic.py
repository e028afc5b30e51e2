"""The critic: a Gaussian process over the coordinates of a search, from a handful of rollouts."""

from dataclasses import dataclass
from itertools import product
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.stats import norm, rankdata

from sb3_nmp.common.algorithm import Generation

FloatArray = NDArray[np.float64]

#: length scales that the critic chooses from, in units of the typical distance of two draws from
#: the exploration's distribution; over the longest ones it is as good as quadratic
LENGTHS = (0.4, 0.6, 0.9, 1.3, 2.0, 3.0, 5.0, 8.0)
#: variances of noise that it chooses from, as shares of the kernel's: nearly equal trajectories can
#: fare differently, as where grains fall by chance
NOISES = (1e-4, 1e-2, 1e-1)


def normal_scores(rewards: FloatArray) -> FloatArray:
    """Return rewards by rank as quantiles of N(0, 1), shape (N,): outliers and units do not matter.

    >>> normal_scores(np.array([-7.0, -1.0, -1e9])).round(2).tolist()
    [0.0, 0.97, -0.97]

    :param rewards: shape (N,)
    """
    return cast(FloatArray, norm.ppf((rankdata(rewards) - 0.5) / len(rewards)))


def kernel(one: FloatArray, other: FloatArray, length: float) -> FloatArray:
    """Return the correlation of the values at every pair of points, shape (N, M).

    :param one: shape (N, d)
    :param other: shape (M, d)
    :param length: in units of sqrt(2 d), the typical distance of two draws from N(0, I)
    """
    squares = np.sum(one**2, axis=1)[:, None] + np.sum(other**2, axis=1) - 2 * one @ other.T
    return np.exp(-0.25 * np.maximum(squares, 0.0) / one.shape[1] / length**2)


@dataclass(frozen=True)
class Critic:
    """A Gaussian process with a squared-exponential kernel; `fit` makes one.

    It sees the points through a *view*, a linear map: a cost that depends on where a trajectory is
    at one moment, such as an error at the goal, is learned from far fewer rollouts by a critic
    that looks at that moment alone. Which view explains a cost best is chosen by the evidence.

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
        cls,
        points: FloatArray,
        values: FloatArray,
        views: tuple[FloatArray, ...],
        lengths: tuple[float, ...] = LENGTHS,
        noises: tuple[float, ...] = NOISES,
    ) -> "Critic":
        """Choose the view, length scale and noise of largest marginal likelihood.

        :param points: shape (N, n)
        :param values: shape (N,)
        :param views: to choose from, each of shape (n, d), such that the d values of a draw from
            the exploration's distribution have a variance of about 1
        :param lengths: to choose from (`LENGTHS`)
        :param noises: to choose from (`NOISES`)
        """
        mean = float(values.mean())
        best: tuple[float, Critic] | None = None
        for view in views:
            seen = points @ view
            for length, noise in product(lengths, noises):
                correlation = kernel(seen, seen, length) + noise * np.eye(len(points))
                factor, _ = cho_factor(correlation, lower=True)
                weights = cho_solve((factor, True), values - mean)
                variance = max(float((values - mean) @ weights) / len(values), 1e-9)
                evidence = -0.5 * len(values) * np.log(variance) - np.log(np.diag(factor)).sum()
                if best is None or evidence > best[0]:
                    known = (variance, mean, np.tril(factor), weights)
                    best = (evidence, cls(points, view, length, noise, *known))
        return cast(tuple[float, Critic], best)[1]

    def predict(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return means and standard deviations, each of shape (M,).

        :param points: shape (M, n)
        """
        cross = kernel(points @ self.view, self.points @ self.view, self.length)
        explained = np.sum(solve_triangular(self.factor, cross.T, lower=True) ** 2, axis=0)
        spread = np.sqrt(self.variance * np.maximum(1.0 - explained, 1e-9))
        return self.mean + cross @ self.weights, spread

    def believing(self, points: FloatArray) -> "Critic":
        """Return the critic that has seen its own predictions at some points come true.

        With it, the next point of a generation goes elsewhere.

        :param points: shape (M, n)
        """
        known = np.concatenate([self.points, points])
        values = self._values()
        return Critic.fit(
            known,
            np.append(values, self.predict(points)[0]),
            (self.view,),
            (self.length,),
            (self.noise,),
        )

    def _values(self) -> FloatArray:
        return self.mean + self.factor @ (self.factor.T @ self.weights)


@dataclass(frozen=True)
class RewardCritic:
    """What a search expects of a reward: one Gaussian process, or one for each of its errors.

    A reward that is the sum of several costs (errors at the start, at the goal, in between) is
    predicted error by error, as each rollout tells about all of them. Two costs of which at most
    one is paid at a time (too little and too much) are the two sides of one error: their signed
    difference is smooth where it passes zero, and tells on which side of a rollout to look. Of any
    other cost the square is predicted, which is smooth where the cost is a distance. A reward that
    is no such sum is predicted by its normal scores.

    :param whole: of the reward's normal scores, if it is no sum of costs
    :param squares: of minus the squared costs
    :param signed: of the signed errors
    :param to_gain: how far a reward can rise at most: the best rollout's costs, or 1 for scores
    """

    whole: Critic | None
    squares: tuple[Critic, ...] = ()
    signed: tuple[Critic, ...] = ()
    to_gain: float = 1.0

    @classmethod
    def fit(
        cls, points: FloatArray, rollouts: Generation, views: tuple[FloatArray, ...]
    ) -> "RewardCritic":
        """Fit the Gaussian processes.

        :param points: shape (N, n)
        :param rollouts: N of them
        :param views: of the points, see `Critic.fit`
        """
        costs = varying_costs(rollouts)
        if len(costs) < 2:
            return cls(Critic.fit(points, normal_scores(rollouts.rewards), views))
        alone, signed = two_sided(costs)
        return cls(
            None,
            tuple(Critic.fit(points, -(cost**2), views) for cost in alone),
            tuple(Critic.fit(points, error, views) for error in signed),
            -float(rollouts.rewards.max()),
        )

    def optimistic(self, points: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return a random upper bound of each point's reward, shape (M,).

        Each critic's mean is off by a half-normal deviation, to the better side.

        :param points: shape (M, n)
        :param rng: the generator to draw from
        """

        def predict(critic: Critic) -> tuple[FloatArray, FloatArray]:
            mean, std = critic.predict(points)
            return mean, std * np.abs(rng.standard_normal(len(points)))

        if self.whole is not None:
            return np.sum(predict(self.whole), axis=0)
        bound = np.zeros(len(points))
        for critic in self.squares:
            bound -= np.sqrt(np.maximum(-np.sum(predict(critic), axis=0), 0.0))
        for critic in self.signed:
            mean, luck = predict(critic)
            bound -= np.maximum(np.abs(mean) - luck, 0.0)
        return bound

    def believing(self, points: FloatArray) -> "RewardCritic":
        """Return the critic that has seen its own predictions come true; see `Critic`.

        :param points: shape (M, n)
        """
        return RewardCritic(
            None if self.whole is None else self.whole.believing(points),
            tuple(critic.believing(points) for critic in self.squares),
            tuple(critic.believing(points) for critic in self.signed),
            self.to_gain,
        )


def varying_costs(rollouts: Generation) -> list[FloatArray]:
    """Return the costs whose sum is minus the reward and that are not constant, each of shape (N,).

    :param rollouts: N of them
    :return: empty if the reward is no sum of costs >= 0
    """
    costs = [-term for term in rollouts.terms.values()]
    known = np.sum(costs, axis=0) if costs else np.zeros(len(rollouts))
    if any((cost < 0).any() for cost in costs) or not np.allclose(known, -rollouts.rewards):
        return []
    return [cost for cost in costs if np.ptp(cost) > 0]


def two_sided(costs: list[FloatArray]) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the costs that stand alone, and the signed errors of which two are the two sides.

    >>> two_sided([np.array([0.0, 3.0, 0.0]), np.array([1.0, 1.0, 2.0]), np.array([2.0, 0.0, 0.0])])
    ([array([1., 1., 2.])], [array([ 2., -3.,  0.])])

    :param costs: none of them constant, each of shape (N,)
    """
    alone: list[FloatArray] = []
    signed: list[FloatArray] = []
    for cost in costs:
        other = next((i for i, one in enumerate(alone) if not (one * cost).any()), None)
        if other is None:
            alone.append(cost)
        else:
            signed.append(cost - alone.pop(other))
    return alone, signed
