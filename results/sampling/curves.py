"""The demonstrations of thesis 6.2.1: curves from (0, 0) to (1, 0), and bundles of them.

x is time and y the only dimension of a trajectory; both are without unit. The thesis prints its
curves only. These have the shape of the obstacle demonstrations of its original code, so each is
told by its height, the curve's factor; its largest value is 1.005 of that. Shape letters: N
curves, T time points.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
N_TIME_POINTS = 200
#: heights of the six demonstrations
HEIGHTS = (-0.6, -0.4, -0.2, 0.2, 0.4, 0.6)
#: by kind of modes: lowest and highest height of each bundle
BUNDLES = {
    "two bundles": ((-0.6, -0.3), (0.3, 0.6)),
    "six bundles": tuple((height - 0.03, height + 0.03) for height in HEIGHTS),
}
PER_BUNDLE = 10


def shape() -> FloatArray:
    """Return the curve of height 1: two bumps, 0 at both ends, shape (T,)."""
    x = np.linspace(-0.5, 0.5, N_TIME_POINTS)
    left, right = (np.exp(-((x - centre) ** 2) / (2 * 0.15**2)) for centre in (-0.25, 0.25))
    bumps = left + right
    return (bumps - bumps[0]) / (1 - bumps[0])


def curves(heights: ArrayLike) -> FloatArray:
    """Return trajectories of one dimension, shape (N, T, 1).

    :param heights: shape (N,)
    """
    return np.asarray(heights, float)[:, None, None] * shape()[:, None]


def bundle_heights(bundles: Sequence[tuple[float, float]]) -> FloatArray:
    """Return the heights of all curves of bundles, `PER_BUNDLE` evenly spaced in each.

    :param bundles: lowest and highest height of each
    """
    return np.concatenate([np.linspace(low, high, PER_BUNDLE) for low, high in bundles])


def heights_of(trajectories: FloatArray) -> FloatArray:
    """Return the heights of the curves nearest to trajectories, by least squares, shape (N,).

    :param trajectories: shape (N, T, 1)
    """
    form = shape()
    return trajectories[..., 0] @ form / (form @ form)
