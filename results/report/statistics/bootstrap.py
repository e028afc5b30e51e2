"""The stratified bootstrap: within each task seeds are drawn, with all that belongs to them.

A percentile interval from few seeds is too short: by sqrt((n - 1) / n), since resamples vary less
than samples do, and by the normal distribution's quantile where Student's is due. All intervals
here take quantiles farther out to make up for both, as in Hesterberg, "What teachers should know
about the bootstrap", The American Statistician 69(4), 2015 ("expanded percentile interval").
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm, t, trim_mean

from results.report.statistics.quantiles import CONFIDENCE

N_RESAMPLES = 5000
NO_INTERVAL = (float("nan"), float("nan"))

FloatArray = NDArray[np.float64]
#: of samples (R, M), each in a row, gives (R,)
Statistic = Callable[[FloatArray], FloatArray]


def tail_for(sizes: Sequence[int]) -> float:
    """Return at which quantile of the resamples an interval ends.

    >>> round(tail_for([10_000]), 4), round(tail_for([5]), 5)
    (0.025, 0.00095)

    :param sizes: seeds in each stratum, at least 2
    """
    degrees = sum(size - 1 for size in sizes)
    widening = np.sqrt(min(sizes) / (min(sizes) - 1))
    return float(norm.sf(widening * t.ppf((1 + CONFIDENCE) / 2, degrees)))


def stratified_interval(
    strata: Sequence[ArrayLike], statistic: Statistic, seed: int = 0
) -> tuple[float, float]:
    """Return a 95 % interval of a statistic of all values together; NaN where one seed is alone.

    Seeds are drawn with replacement within each stratum; all values of a seed stay together, so
    that ten targets of one seed do not count as ten seeds.

    :param strata: for each task, shape (n_seeds,) or (n_seeds, values of a seed)
    :param statistic: of rows of values; rows hold the values of all strata
    :param seed: of the resampling
    """
    rows = [
        np.asarray(stratum, float).reshape(len(np.atleast_1d(stratum)), -1) for stratum in strata
    ]
    sizes = [len(row) for row in rows]
    if min(sizes) < 2:
        return NO_INTERVAL
    rng = np.random.default_rng(seed)
    drawn = [row[rng.integers(0, len(row), (N_RESAMPLES, len(row)))] for row in rows]
    samples = np.concatenate([sample.reshape(N_RESAMPLES, -1) for sample in drawn], axis=1)
    return interval_of(statistic(samples), sizes)


def interval_of(resampled: FloatArray, sizes: Sequence[int]) -> tuple[float, float]:
    """Return the ends of an interval.

    :param resampled: a statistic's values in the resamples, shape (R,)
    :param sizes: seeds in each stratum
    """
    tail = tail_for(sizes)
    low, high = np.quantile(resampled, [tail, 1 - tail])
    return float(low), float(high)


def interquartile_mean_interval(values: ArrayLike, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % interval of the interquartile mean; NaN for one seed.

    :param values: shape (n_seeds,)
    :param seed: of the resampling
    """
    return stratified_interval([np.sort(np.asarray(values, float))], _trimmed, seed)


def _trimmed(samples: FloatArray) -> FloatArray:
    return trim_mean(samples, 0.25, axis=1)


def mean_interval(values: ArrayLike, seed: int = 0) -> tuple[FloatArray, ...]:
    """Return the ends of the 95 % interval of the mean over the first axis.

    :param values: one row per run, shape (N, ...)
    :param seed: of the resampling
    :return: low and high of the shape of a row; NaN for a single run
    """
    rows = np.asarray(values, float)
    if len(rows) < 2:
        nothing = np.full(rows.shape[1:], np.nan)
        return nothing, nothing
    drawn = np.random.default_rng(seed).multinomial(
        len(rows), np.full(len(rows), 1 / len(rows)), N_RESAMPLES
    )
    means = np.tensordot(drawn / len(rows), rows, axes=1)
    tail = tail_for([len(rows)])
    return np.quantile(means, tail, axis=0), np.quantile(means, 1 - tail, axis=0)
