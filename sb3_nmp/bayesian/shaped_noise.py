"""Smooth noise that moves the dimensions together as the demonstrations do."""

from typing import cast

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.bayesian.settings import ShapedExploration
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.regression import least_error_penalty, leave_one_out_error

FloatArray = NDArray[np.float64]
#: demonstrations from which their errors can be told
FEWEST = 5
#: of the scale: tasks are not always so forgiving as their demonstrations are alike
LEAST_SHARE = 0.15


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


def nearer_scale(
    settings: ShapedExploration, scale: tuple[float, ...], demonstrations: Demonstrations
) -> tuple[float, ...]:
    """Return the scale of a search among drawn contexts, at most the one given, length D.

    What a policy gets wrong in a new context is about as large as what a linear regression gets
    wrong in demonstrated ones that are left out in turn. So the first generation is drawn with that
    standard deviation, where it is less than the scale's own: searching far around answers that are
    nearly right costs rollouts.

    :param settings: of the noise; its radius is of the first generation
    :param scale: of exploration, in the trajectory's unit, length D
    :param demonstrations: of one way to do the task
    """
    if not settings.foretold or len(demonstrations) < FEWEST:
        return scale
    std = demonstrations.contexts.std(axis=0, dtype=np.float64)
    known = demonstrations.contexts / np.where(std > 1e-9, std, 1.0)
    values = (demonstrations.trajectories / np.asarray(scale)).reshape(len(known), -1)
    values = values.astype(np.float64)
    error = leave_one_out_error(known, values, least_error_penalty(known, values)) ** 0.5
    share = float(np.clip(error / settings.radius, LEAST_SHARE, 1.0))
    return tuple(share * each for each in scale)


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
