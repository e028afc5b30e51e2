"""Rollouts to success where some runs never succeed within their budget."""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import t

from results.report.statistics.quantiles import CONFIDENCE


def expected_rollouts(
    rollouts: ArrayLike, budgets: ArrayLike, seeds: ArrayLike | None = None
) -> tuple[float, float, float]:
    """Return the expected rollouts to success of an algorithm that is begun anew until it succeeds.

    All rollouts that were spent, by the number of successes: the expected running time of Hansen
    et al., "COCO: performance assessment" (2016), and the maximum-likelihood estimate where each
    rollout succeeds with the same probability. A run that needs none (0) costs nothing.

    The interval is Student's, of the logarithm, with the delta method's standard error over seeds.
    Where no run succeeds, the estimate is infinite, and the low end is the mean for which so many
    failures have a probability of 2.5 % (at a constant rate of success).

    >>> expected_rollouts([10, 30, np.inf], 50)[0]
    45.0

    :param rollouts: to success, infinite where a run did not succeed, shape (N,)
    :param budgets: of the runs, shape (N,), or one for all
    :param seeds: which runs belong to one seed, shape (N,); by default each is alone
    :return: the estimate, and the ends of its 95 % interval, NaN for one seed
    """
    counts = np.asarray(rollouts, float)
    solved = np.isfinite(counts)
    spent = np.where(solved, counts, np.broadcast_to(np.asarray(budgets, float), counts.shape))
    _, of_seed = np.unique(np.arange(len(counts)) if seeds is None else seeds, return_inverse=True)
    costs = np.bincount(of_seed, spent)
    wins = np.bincount(of_seed, solved)
    return _ratio(costs, wins)


def _ratio(costs: np.ndarray, wins: np.ndarray) -> tuple[float, float, float]:
    """Return the sum of costs by the sum of wins, and an interval; one entry a seed."""
    n, cost = len(costs), float(costs.sum())
    if wins.sum() == 0:
        return math.inf, cost / -math.log((1 - CONFIDENCE) / 2), math.inf
    mean = cost / float(wins.sum())
    if n < 2:
        return mean, math.nan, math.nan
    if cost == 0:
        return 0.0, 0.0, 0.0
    error = math.sqrt(n / (n - 1) * float(np.sum((costs - mean * wins) ** 2))) / cost
    factor = math.exp(float(t.ppf((1 + CONFIDENCE) / 2, n - 1)) * error)
    return mean, mean / factor, mean * factor
