"""Smooth noise that moves the dimensions together as the demonstrations do."""

from typing import cast

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.bayesian.settings import ShapedExploration
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.noise import SmoothNoise

FloatArray = NDArray[np.float64]


def shaped_directions(
    settings: ShapedExploration, scale: tuple[float, ...], demonstrations: Demonstrations
) -> FloatArray:
    """Return one direction for each basis and dimension, shape (n_bases * D, T, D).

    Each is of one standard deviation of the exploration.

    :param settings: of the noise
    :param scale: of exploration, in the trajectory's unit, length D
    :param demonstrations: their spread shapes the noise
    """
    mixing = spread_over_time(demonstrations, settings.shaped) * np.asarray(scale)
    return noise_directions(settings.noise * mixing, settings.n_bases)


def spread_over_time(demonstrations: Demonstrations, share: float) -> FloatArray:
    """Return how noise is to be mixed over time to spread as the demonstrations do, (T, D, D).

    The symmetric root, at each time, of ``share * C + (1 - share) * I``, with C the covariance of
    the demonstrations at that time, in units of each dimension's root mean square over time. In a
    dimension in which all of them agree throughout, C is that of unit noise.

    :param demonstrations: at least one
    :param share: in [0, 1]
    """
    deviations = demonstrations.trajectories - demonstrations.trajectories.mean(axis=0)
    typical = np.sqrt((deviations**2).mean(axis=(0, 1)))
    scaled = deviations / np.maximum(typical, 1e-9)
    scaled[..., typical <= 1e-9] = 0.0
    covariance = np.einsum("ntd,nte->tde", scaled, scaled) / len(scaled)
    covariance += np.diag((typical <= 1e-9).astype(np.float64))
    identity = np.eye(len(typical))
    values, axes = np.linalg.eigh(share * covariance + (1.0 - share) * identity)
    roots = np.sqrt(np.maximum(values, 0.0))
    return cast(FloatArray, np.einsum("tdi,ti,tei->tde", axes, roots, axes))


def noise_directions(mixing: FloatArray, n_bases: int) -> FloatArray:
    """Return one direction for each basis and dimension, shape (n_bases * D, T, D).

    :param mixing: at each time, how unit noise in each dimension (rows) moves the trajectory's
        dimensions (columns), in the trajectory's unit, shape (T, D, D)
    :param n_bases: of `SmoothNoise`
    """
    n_time_points, n_dimensions, _ = mixing.shape
    bases = SmoothNoise(n_bases=n_bases).bases(n_time_points)
    each = np.einsum("tk,tde->kdte", bases, mixing)
    return each.reshape(-1, n_time_points, n_dimensions)
