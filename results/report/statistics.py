"""Quantiles, means and their intervals; the seed is the unit of replication."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binomtest, trim_mean

CONFIDENCE = 0.95
N_RESAMPLES = 5000
NO_INTERVAL = (float("nan"), float("nan"))


def success_interval(successes: int, n: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of a success rate.

    :param successes: how many of n
    :param n: at least 1
    """
    interval = binomtest(successes, n).proportion_ci(CONFIDENCE, method="wilson")
    return float(interval.low), float(interval.high)


def quantile(values: ArrayLike, q: float) -> float:
    """Return a quantile of values that may be infinite, by linear interpolation.

    >>> quantile([30, 10, np.inf, 20], 0.5), quantile([10, np.inf], 0.5)
    (25.0, inf)

    :param values: shape (N,), N at least 1
    :param q: in [0, 1]
    """
    ordered = np.sort(np.asarray(values, float))
    position = q * (len(ordered) - 1)
    below = int(position)
    part = position - below
    if part == 0:
        return float(ordered[below])
    if np.isinf(ordered[below + 1]):
        return float(ordered[below + 1])
    return float(ordered[below] + part * (ordered[below + 1] - ordered[below]))


def interquartile_mean(values: ArrayLike) -> float:
    """Return the mean without the lowest and the highest quarter.

    :param values: shape (N,), N at least 1
    """
    return float(trim_mean(np.sort(np.asarray(values, float)), 0.25))


def interquartile_mean_interval(values: ArrayLike, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % percentile-bootstrap interval of the interquartile mean; NaN for one value.

    :param values: shape (N,)
    :param seed: of the resampling
    """
    ordered = np.sort(np.asarray(values, float))
    if len(ordered) < 2:
        return NO_INTERVAL
    draws = np.random.default_rng(seed).integers(0, len(ordered), (N_RESAMPLES, len(ordered)))
    return _central(trim_mean(ordered[draws], 0.25, axis=1))


def mean_interval(values: ArrayLike, seed: int = 0) -> tuple[NDArray[np.float64], ...]:
    """Return the ends of the 95 % percentile-bootstrap interval of the mean over the first axis.

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
    tail = (1 - CONFIDENCE) / 2
    return np.quantile(means, tail, axis=0), np.quantile(means, 1 - tail, axis=0)


def probability_of_improvement(
    values: ArrayLike, others: ArrayLike, seed: int = 0
) -> tuple[float, float, float]:
    """Return how often a run is better (larger) than another's, ties half; and a 95 % interval.

    The interval comes from a bootstrap over the runs of both; it is NaN where one has but one run.

    :param values: of one algorithm's runs, shape (N,)
    :param others: of the other's, shape (M,)
    :param seed: of the resampling
    """
    ours, theirs = np.sort(np.asarray(values, float)), np.sort(np.asarray(others, float))
    wins = (ours[:, None] > theirs) + 0.5 * (ours[:, None] == theirs)
    if min(wins.shape) < 2:
        return float(wins.mean()), *NO_INTERVAL
    rng = np.random.default_rng(seed)
    n_drawn = [rng.multinomial(n, np.full(n, 1 / n), N_RESAMPLES) for n in wins.shape]
    means = (n_drawn[0] @ wins * n_drawn[1]).sum(axis=1) / wins.size
    return float(wins.mean()), *_central(means)


def _central(samples: np.ndarray) -> tuple[float, float]:
    """Return the ends of the samples' central 95 %."""
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(samples, [tail, 1 - tail])
    return float(low), float(high)


def quartiles(name: str, values: ArrayLike) -> dict[str, float]:
    """Return ``<name>_median``, ``<name>_q25`` and ``<name>_q75``, NaN of no values.

    :param name: of the values
    :param values: shape (N,); infinite ones are allowed, NaN are left out
    """
    known = np.asarray(values, float)
    known = known[~np.isnan(known)]
    ends = (("median", 0.5), ("q25", 0.25), ("q75", 0.75))
    return {f"{name}_{end}": quantile(known, q) if len(known) else np.nan for end, q in ends}


def named(name: str, ends: Iterable[str], values: Iterable[float]) -> dict[str, float]:
    """Return numbers by ``<name>_<end>``.

    >>> named("rate", ("low", "high"), (0.1, 0.2))
    {'rate_low': 0.1, 'rate_high': 0.2}

    :param name: what they are about
    :param ends: what tells them apart
    :param values: one for each end
    """
    return {f"{name}_{end}": value for end, value in zip(ends, values, strict=True)}
