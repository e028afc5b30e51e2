"""Two algorithms against each other, and many pairs at once: which differences can be told."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm, rankdata

from results.exceptions import BenchmarkError
from results.report.statistics.bootstrap import NO_INTERVAL
from results.report.statistics.quantiles import CONFIDENCE

N_PERMUTATIONS = 20_000
LEVEL = 0.05
GRID = 20_001  # of probabilities, in which the ends of an interval are looked for

FloatArray = NDArray[np.float64]
Alternative = Literal["two-sided", "less"]
Verdict = Literal["better", "worse", "cannot be told"]


def probability_of_improvement(values: ArrayLike, others: ArrayLike) -> tuple[float, float, float]:
    """Return how often a run is better (larger) than another's, ties half; and a 95 % interval.

    The interval is Newcombe's fifth, "Confidence intervals for an effect size measure based on the
    Mann-Whitney statistic, part 2", Statistics in Medicine 25, 2006: all probabilities from which
    the observed one is no farther than 1.96 standard errors at that probability. A bootstrap would
    find no spread at all where every run wins.

    :param values: of one algorithm's seeds, shape (N,)
    :param others: of the other's, shape (M,)
    :return: probability, low, high; the interval is NaN where one has but one seed
    """
    return improvement_within([(values, others)])


def improvement_within(
    strata: Sequence[tuple[ArrayLike, ArrayLike]],
) -> tuple[float, float, float]:
    """Return `probability_of_improvement` over pairs of runs of one stratum each.

    It is above one half exactly where the statistic of `permutation_p` is above 0. Pairs across
    strata, such as a hard variant of a task and an easy one, would tell of the variants.

    >>> easy, hard = ([10.0, 10.0], [11.0, 11.0]), ([2.0, 2.0], [3.0, 3.0])
    >>> improvement_within([easy, hard])[0], probability_of_improvement(*easy)[0]
    (0.0, 0.0)

    :param strata: values of both algorithms in each stratum, shapes (n,) and (m,); larger is better
    :return: as of `probability_of_improvement`
    """
    wins, n_pairs, n, m = 0.0, 0, 0, 0
    for values, others in strata:
        ours, theirs = np.asarray(values, float), np.asarray(others, float)
        each = (ours[:, None] > theirs) + 0.5 * (ours[:, None] == theirs)
        wins, n_pairs = wins + float(each.sum()), n_pairs + each.size
        n, m = n + len(ours), m + len(theirs)
    found = wins / n_pairs if n_pairs else float("nan")
    if min(n, m) < 2:
        return found, *NO_INTERVAL
    p = np.linspace(0.0, 1.0, GRID)
    more = (n + m) / 2 - 1
    variance = p * (1 - p) * (1 + more * (1 - p) / (2 - p) + more * p / (1 + p)) / (n * m)
    z = norm.ppf((1 + CONFIDENCE) / 2)
    inside = p[np.abs(p - found) <= z * np.sqrt(variance) + 1e-12]
    return found, float(inside[0]), float(inside[-1])


def permutation_p(
    strata: Sequence[tuple[ArrayLike, ArrayLike]],
    alternative: Alternative = "two-sided",
    n_permutations: int = N_PERMUTATIONS,
    seed: int = 0,
    together: bool = False,
) -> float:
    """Return the p-value of a difference: seeds are dealt anew between both within each stratum.

    The statistic is the sum of the first one's ranks, within strata (van Elteren's with weights of
    1), so one rank sum test over several tasks; it is exact, whatever the distribution and the
    ties (Phipson and Smyth 2010 for the added one). A stratum is what makes runs alike: a task, or
    a context.

    :param strata: values of both algorithms in each stratum, shapes (n,) and (m,); larger is better
    :param alternative: ``"two-sided"``, or ``"less"``: the first one is worse
    :param n_permutations: how often seeds are dealt anew
    :param seed: of the dealing
    :param together: rank the values of all strata together, so that it counts how far apart those
        of a stratum are: a pair alone would else tell which one is better, and no more
    :raises BenchmarkError: a value that is no number, which has no rank
    """
    rng = np.random.default_rng(seed)
    observed, permuted = 0.0, np.zeros(n_permutations)
    pooled = [np.concatenate([np.asarray(x, float), np.asarray(y, float)]) for x, y in strata]
    if any(np.isnan(values).any() for values in pooled):
        raise BenchmarkError("a value is NaN, which has no rank; leave such runs out, and say so.")
    ends = np.cumsum([len(values) for values in pooled])[:-1]
    ranked = np.split(rankdata(np.concatenate(pooled)), ends) if together else map(rankdata, pooled)
    for (ours, _), found in zip(strata, ranked, strict=True):
        n, ranks = len(np.asarray(ours)), found - found.mean()  # centred, so that strata add up
        observed += ranks[:n].sum()
        dealt = rng.permuted(np.tile(ranks, (n_permutations, 1)), axis=1)
        permuted += dealt[:, :n].sum(axis=1)
    slack = 1e-9  # sums of halves are exact, but not in every order
    if alternative == "less":
        extreme = permuted <= observed + slack
    else:
        extreme = np.abs(permuted) >= abs(observed) - slack
    return float((1 + extreme.sum()) / (1 + n_permutations))


def holm(p_values: ArrayLike) -> FloatArray:
    """Return p-values corrected for their number (Holm 1979).

    With them, the probability of one false verdict or more in the whole table is at most the level.

    >>> holm([0.01, 0.04, 0.03]).tolist()
    [0.03, 0.06, 0.06]

    :param p_values: shape (K,)
    :raises BenchmarkError: one of them is no probability
    """
    p = np.asarray(p_values, float)
    if not ((p >= 0) & (p <= 1)).all():
        raise BenchmarkError(f"the p-values are {p.tolist()}; each must lie in [0, 1].")
    order = np.argsort(p, kind="stable")
    corrected = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    result = np.empty_like(p)
    result[order] = np.minimum(corrected, 1.0)
    return result


def verdict(probability: float, corrected_p: float) -> Verdict:
    """Return what a comparison shows.

    >>> verdict(0.9, 0.01), verdict(0.1, 0.01), verdict(0.9, 0.2)
    ('better', 'worse', 'cannot be told')

    :param probability: of improvement
    :param corrected_p: the p-value, corrected by `holm`
    """
    if corrected_p > LEVEL:
        return "cannot be told"
    return "better" if probability > 0.5 else "worse"
