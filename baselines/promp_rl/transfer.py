"""From the movement primitives of old targets to the first Gaussian for a new one.

After Stark, Peters and Rueckert, "Experience reuse with probabilistic movement primitives", 2019
(thesis [1]). Shape letters: M old targets, P weights, C context.
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def context_scale(contexts: FloatArray) -> FloatArray:
    """Return the standard deviation of each entry, 1 where it does not vary, shape (C,).

    :param contexts: shape (M, C)
    """
    std = contexts.std(axis=0)
    return np.where(std > 1e-9 * np.maximum(1.0, np.abs(contexts).max(axis=0)), std, 1.0)


def neighbour_distance(contexts: FloatArray) -> float:
    """Return the median distance of an old target to its nearest neighbour, 1 if there is none.

    :param contexts: in units of their scale, shape (M, C)
    """
    distances = np.linalg.norm(contexts[:, None] - contexts, axis=2)
    np.fill_diagonal(distances, np.inf)
    nearest = distances.min(axis=1)
    nearest = nearest[np.isfinite(nearest) & (nearest > 0)]
    return float(np.median(nearest)) if len(nearest) else 1.0


def target_relevance(contexts: FloatArray, targets: FloatArray, width: float) -> FloatArray:
    """Return how much each old target tells about new ones; rows add up to 1, shape (N, M).

    A Gaussian of the distance between the contexts.

    :param contexts: of the old targets, shape (M, C)
    :param targets: the new ones, shape (N, C)
    :param width: of the Gaussian, in units of the old targets' median neighbour distance
    """
    scale = context_scale(contexts)
    old, new = contexts / scale, targets / scale
    unit = width * neighbour_distance(old)
    squares = np.sum(((new[:, None] - old) / unit) ** 2, axis=2)
    shares = np.exp(-0.5 * (squares - squares.min(axis=1, keepdims=True)))
    return shares / shares.sum(axis=1, keepdims=True)


def collapse(
    means: FloatArray, covariance: FloatArray, shares: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the Gaussian with the moments of a mixture: mean (P,) and covariance (P, P).

    :param means: of the components, shape (M, P)
    :param covariance: common to all, shape (P, P)
    :param shares: of the components, they add up to 1, shape (M,)
    """
    mean = shares @ means
    deviations = means - mean
    return mean, covariance + (deviations * shares[:, None]).T @ deviations
