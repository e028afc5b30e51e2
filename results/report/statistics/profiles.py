"""Performance profiles: which share of the runs is at least as good as a score, for every score."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from results.report.statistics.bootstrap import N_RESAMPLES, tail_for

FloatArray = NDArray[np.float64]


def performance_profile(strata: Sequence[ArrayLike], scores: ArrayLike) -> FloatArray:
    """Return the share of runs above each score, each task counting the same.

    Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice", NeurIPS
    2021; of minus the rollouts to success it is the share of runs that are solved within so many.

    >>> performance_profile([[1.0, 3.0], [2.0, 2.0]], [0.0, 1.5, 2.5]).tolist()
    [1.0, 0.75, 0.25]

    :param strata: for each task, the values of its seeds, shape (n_seeds,) or (n_seeds, K); larger
        is better
    :param scores: at which to count, shape (S,)
    :return: shape (S,)
    """
    at = np.asarray(scores, float)
    return np.mean([_above(stratum, at).mean(axis=0) for stratum in strata], axis=0)


def performance_profile_band(
    strata: Sequence[ArrayLike], scores: ArrayLike, seed: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Return the pointwise 95 % interval of `performance_profile`; NaN where one seed is alone.

    :param strata: see there
    :param scores: shape (S,)
    :param seed: of the resampling of seeds within tasks
    """
    at = np.asarray(scores, float)
    sizes = [len(np.asarray(stratum)) for stratum in strata]
    if min(sizes) < 2:
        return np.full(at.shape, np.nan), np.full(at.shape, np.nan)
    rng = np.random.default_rng(seed)
    shares = np.zeros((N_RESAMPLES, len(at)))
    for stratum, n in zip(strata, sizes, strict=True):
        drawn = rng.multinomial(n, np.full(n, 1 / n), N_RESAMPLES)
        shares += drawn @ _above(stratum, at) / n / len(sizes)
    tail = tail_for(sizes)
    return np.quantile(shares, tail, axis=0), np.quantile(shares, 1 - tail, axis=0)


def _above(stratum: ArrayLike, scores: FloatArray) -> FloatArray:
    """Return for each seed which share of its values lies above each score, (n_seeds, S)."""
    values = np.asarray(stratum, float)
    rows = values.reshape(len(values), -1, 1)
    return (rows > scores).mean(axis=1)
