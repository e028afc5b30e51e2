"""`Critic`: what ACNMP's search expects of the reward at points that were not tried.

Shape letters: N rollouts, M queries, n coordinates.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, rankdata

from sb3_nmp.bayesian.gaussian_process import GaussianProcess, Hypotheses
from sb3_nmp.common.rollouts import DIVERGED, Generation

FloatArray = NDArray[np.float64]
#: what processes chose, by what they predict
Chosen = Mapping[str, Hypotheses]

#: rollouts at most from which a critic that aims predicts: those that achieved the nearest
N_AIMED = 12


def normal_scores(rewards: FloatArray) -> FloatArray:
    """Return rewards by rank as quantiles of N(0, 1), shape (N,): outliers and units do not matter.

    >>> normal_scores(np.array([-7.0, -1.0, -1e9])).round(2).tolist()
    [0.0, 0.97, -0.97]

    :param rewards: shape (N,)
    """
    return cast(FloatArray, norm.ppf((rankdata(rewards) - 0.5) / len(rewards)))


@dataclass(frozen=True)
class Critic:
    """A Gaussian process of the reward, or one of each error that the reward adds up.

    A reward that is the sum of several costs (errors at the start, at the goal, in between) is
    predicted error by error, as each rollout tells about all of them: Bayesian optimisation of a
    composite function (Astudillo and Frazier, "Bayesian optimization of composite functions",
    2019). Two costs of which at most one is paid at a time (too little and too much) are the two
    sides of one error: their signed difference is smooth where it passes zero, and tells on which
    side of a rollout to look. Of any other cost the square is predicted, which is smooth where the
    cost is a distance. Where the reward is no such sum, but rollouts tell which context they
    achieved, the signed errors are what that lacks of the context in which they were made, entry by
    entry: the search aims. A reward that tells nothing more is predicted by its normal scores.

    :param whole: of the reward's normal scores, if nothing else is known
    :param squares: of minus the squared costs
    :param signed: of the signed errors
    :param names: what they predict, in the order above
    :param to_gain: how far a reward can rise at most: the best rollout's costs or misses, or 1 for
        scores
    """

    whole: GaussianProcess | None
    squares: tuple[GaussianProcess, ...] = ()
    signed: tuple[GaussianProcess, ...] = ()
    names: tuple[str, ...] = ("reward",)
    to_gain: float = 1.0

    @classmethod
    def fit(
        cls,
        points: FloatArray,
        rollouts: Generation,
        hypotheses: Hypotheses,
        chosen: Chosen | None = None,
        unit: FloatArray | None = None,
    ) -> "Critic":
        """Fit the Gaussian processes.

        :param points: shape (N, n)
        :param rollouts: N of them
        :param hypotheses: for the evidence to choose from
        :param chosen: what an earlier critic's processes chose, which saves the choice; without
            effect where others are predicted now
        :param unit: of each entry of the context; 1 by default
        """
        squares: dict[str, FloatArray] = {}
        signed: dict[str, FloatArray] = {}
        to_gain = 1.0
        if tells_misses(rollouts, unit):
            rows, misses = nearest_misses(rollouts, unit)
            varying = np.flatnonzero(np.ptp(misses, axis=0) > 0)
            points, signed = points[rows], {f"entry {i}": misses[:, i] for i in varying}
            to_gain = float(np.abs(misses).sum(axis=1).min())
        elif len(costs := varying_costs(rollouts)) >= 2:
            alone, signed = two_sided(costs)
            squares = {name: -(cost**2) for name, cost in alone.items()}
            to_gain = -float(rollouts.rewards.max())
        targets = {**squares, **signed} or {"reward": normal_scores(rollouts.rewards)}
        known = chosen if chosen and chosen.keys() == targets.keys() else {}
        fitted = tuple(
            GaussianProcess.fit(points, target, known.get(name, hypotheses))
            for name, target in targets.items()
        )
        if not squares and not signed:
            return cls(fitted[0])
        n = len(squares)
        return cls(None, fitted[:n], fitted[n:], tuple(targets), to_gain)

    @property
    def chosen(self) -> Chosen:
        """What the processes chose."""
        whole = () if self.whole is None else (self.whole,)
        fitted = (*whole, *self.squares, *self.signed)
        return {name: one.chosen for name, one in zip(self.names, fitted, strict=True)}

    def draw_upper_bounds(self, points: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return a random upper confidence bound of each point's reward, shape (M,).

        Each process's mean is off by a half-normal number of standard deviations, to the better
        side. Berk, Gupta, Rana and Venkatesh, "Randomised Gaussian process upper confidence bound
        for Bayesian optimisation", 2020, draw the number from a Gamma distribution.

        :param points: shape (M, n)
        :param rng: the generator to draw from
        """

        def predict(process: GaussianProcess) -> tuple[FloatArray, FloatArray]:
            mean, std = process.predict(points)
            return mean, std * np.abs(rng.standard_normal(len(points)))

        if self.whole is not None:
            return np.sum(predict(self.whole), axis=0)
        bound = np.zeros(len(points))
        for process in self.squares:
            bound -= np.sqrt(np.maximum(-np.sum(predict(process), axis=0), 0.0))
        for process in self.signed:
            mean, luck = predict(process)
            bound -= np.maximum(np.abs(mean) - luck, 0.0)
        return bound

    def condition_on_mean(self, point: FloatArray) -> "Critic":
        """Condition every process on its mean at this point (Kriging believer).

        :param point: shape (n,)
        """
        return Critic(
            None if self.whole is None else self.whole.condition_on_mean(point),
            tuple(process.condition_on_mean(point) for process in self.squares),
            tuple(process.condition_on_mean(point) for process in self.signed),
            self.names,
            self.to_gain,
        )


def told_costs(rollouts: Generation) -> dict[str, FloatArray]:
    """Return the costs whose sum is minus the reward, by the term's name, each of shape (N,).

    :param rollouts: N of them
    :return: empty if the reward is no sum of costs >= 0
    """
    costs = {name: -term for name, term in rollouts.terms.items()}
    known = np.sum(list(costs.values()), axis=0) if costs else np.zeros(len(rollouts))
    is_sum = not any((cost < 0).any() for cost in costs.values())
    return costs if is_sum and np.allclose(known, -rollouts.rewards) else {}


def varying_costs(rollouts: Generation) -> dict[str, FloatArray]:
    """Return those of the `told_costs` that are not constant.

    :param rollouts: N of them
    """
    return {name: cost for name, cost in told_costs(rollouts).items() if np.ptp(cost) > 0}


def may_aim(rollouts: Generation) -> bool:
    """Return whether what rollouts achieved is the best that is told of them.

    It is not where the reward is told as a sum of costs, that of divergence aside.

    :param rollouts: N of them
    """
    told = rollouts.achieved is not None and np.isfinite(rollouts.achieved).all(axis=1).any()
    return bool(told) and len(told_costs(rollouts).keys() - {DIVERGED}) < 2


def tells_misses(rollouts: Generation, unit: FloatArray | None = None) -> bool:
    """Return whether a critic of these rollouts aims: the nearest miss in different ways.

    :param rollouts: N of them
    :param unit: of each entry of the context, shape (C,); 1 by default
    """
    if not may_aim(rollouts):
        return False
    misses = nearest_misses(rollouts, unit)[1]
    return len(misses) >= 2 and bool(np.ptp(misses, axis=0).any())


def nearest_misses(
    rollouts: Generation, unit: FloatArray | None = None
) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the rows that achieved what is nearest, in order, and by how much they miss, (M, C).

    Rollouts far off, such as those in which an object slips away, would spoil the prediction near
    the context; so there are at most `N_AIMED`.

    :param rollouts: N of them, in one context
    :param unit: of each entry of the context, shape (C,); 1 by default
    """
    achieved = cast(FloatArray, rollouts.achieved)
    misses = (achieved - rollouts.contexts) / (1.0 if unit is None else unit)
    far = np.abs(misses).sum(axis=1)
    rows = np.sort(np.argsort(far, kind="stable")[: min(N_AIMED, int(np.isfinite(far).sum()))])
    return rows, misses[rows]


def two_sided(
    costs: Mapping[str, FloatArray],
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Return the costs that stand alone, and the signed errors of which two are the two sides.

    >>> less, more = np.array([0.0, 3.0, 0.0]), np.array([2.0, 0.0, 0.0])
    >>> two_sided({"less": less, "far": np.array([1.0, 1.0, 2.0]), "more": more})
    ({'far': array([1., 1., 2.])}, {'more - less': array([ 2., -3.,  0.])})

    :param costs: by name, none of them constant, each of shape (N,)
    """
    alone: dict[str, FloatArray] = {}
    signed: dict[str, FloatArray] = {}
    for name, cost in costs.items():
        other = next((one for one in alone if not (alone[one] * cost).any()), None)
        if other is None:
            alone[name] = cost
        else:
            signed[f"{name} - {other}"] = cost - alone.pop(other)
    return alone, signed
