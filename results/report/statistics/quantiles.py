"""Quantiles and means of one group of values; infinite ones are allowed where it says so."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binomtest, trim_mean

CONFIDENCE = 0.95


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


def quartiles(name: str, values: ArrayLike) -> dict[str, float]:
    """Return ``<name>_median``, ``<name>_q25`` and ``<name>_q75``, NaN of no values.

    :param name: of the values
    :param values: shape (N,); infinite ones are allowed, NaN are left out
    """
    known = np.asarray(values, float)
    known = known[~np.isnan(known)]
    ends = (("median", 0.5), ("q25", 0.25), ("q75", 0.75))
    return {f"{name}_{end}": quantile(known, q) if len(known) else np.nan for end, q in ends}


def interquartile_mean(values: ArrayLike) -> float:
    """Return the mean without the lowest and the highest quarter.

    :param values: shape (N,), N at least 1
    """
    return float(trim_mean(np.sort(np.asarray(values, float)), 0.25))


def named(name: str, ends: Iterable[str], values: Iterable[float]) -> dict[str, float]:
    """Return numbers by ``<name>_<end>``.

    >>> named("rate", ("low", "high"), (0.1, 0.2))
    {'rate_low': 0.1, 'rate_high': 0.2}

    :param name: what they are about
    :param ends: what tells them apart
    :param values: one for each end
    """
    return {f"{name}_{end}": value for end, value in zip(ends, values, strict=True)}
