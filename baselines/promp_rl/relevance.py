"""Relevance of weights to objectives, after Ewerton et al. 2019 (thesis [2]), as pure functions.

Shape letters: N samples, P weights.
"""

import numpy as np
from numpy.typing import NDArray

from baselines.reps.dual import solve

FloatArray = NDArray[np.float64]


def pearson(samples: FloatArray, values: FloatArray) -> FloatArray:
    """Return the Pearson correlation of each weight with an objective, in [-1, 1], shape (P,).

    It is 0 where either of them does not vary.

    :param samples: shape (N, P)
    :param values: of the objective, shape (N,)
    """
    deviations, changes = samples - samples.mean(axis=0), values - values.mean()
    norms = np.linalg.norm(deviations, axis=0) * np.linalg.norm(changes)
    varies = norms > 1e-12 * max(1.0, float(np.abs(values).max(initial=0.0)))
    return np.where(varies, changes @ deviations / np.where(varies, norms, 1.0), 0.0)


def relevance(samples: FloatArray, values: FloatArray) -> FloatArray:
    """Return |Pearson correlation| of each weight, scaled so that the largest is 1, shape (P,).

    All zeros where the objective does not vary: these samples say nothing about it.

    :param samples: shape (N, P)
    :param values: of the objective, shape (N,)
    """
    correlations = np.abs(pearson(samples, values))
    highest = float(correlations.max())
    return correlations / highest if highest > 0 else correlations


def update(
    samples: FloatArray,
    values: FloatArray,
    mean: FloatArray,
    variances: FloatArray,
    relevances: FloatArray,
    epsilon: float,
) -> tuple[FloatArray, FloatArray]:
    """Return mean and variances after a reward-weighted update for one objective, each (P,).

    The samples count as ``exp(value / eta)``. The published algorithm gives the temperature eta by
    hand; here it follows from a bound on the KL divergence, as in REPS, so that objectives of any
    scale need no setting. Variances move towards the weighted ones in proportion to the relevance.

    :param samples: drawn around the mean, their variances scaled by the relevances, shape (N, P)
    :param values: of the objective, larger is better, shape (N,)
    :param mean: before the update, shape (P,)
    :param variances: before the update, shape (P,)
    :param relevances: to this objective, in [0, 1], shape (P,)
    :param epsilon: bound on KL(weights of the samples || uniform), in nats
    """
    shares = solve(values, epsilon).weights
    weighted = shares @ (samples - mean) ** 2
    return shares @ samples, (1 - relevances) * variances + relevances * weighted
