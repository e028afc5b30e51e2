"""Where ACNMP explores: directions in trajectory space that noise and the latent space give.

A trajectory is tried at ``answer + sum_j x_j direction_j``. There is a direction for each smooth
basis over time in each dimension; this noise moves the dimensions together as the demonstrations
do. `ACNMPExploration` can add one for each principal axis of the demonstrations' representations
and for each task parameter, both seen through the decoder. The thesis claims that exploration
comes from the latent space of the demonstrations (5.1); by default, here none does.
"""

import numpy as np
import torch as th
from numpy.typing import NDArray

from sb3_nmp.acnmp.settings import ACNMPExploration
from sb3_nmp.bayesian.shaped_noise import shaped_directions
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.models.cnmp import CNMP

FloatArray = NDArray[np.float64]

#: of a standard deviation: over this step the decoder's answer is taken to be linear
SMALL = 0.3


@th.no_grad()
def directions(
    settings: ACNMPExploration,
    scale: tuple[float, ...],
    cnmp: CNMP,
    demonstrations: Demonstrations,
    context: FloatArray,
) -> FloatArray:
    """Return the directions in trajectory space, each of one standard deviation, shape (n, T, D).

    :param settings: what is explored, in units of the scale
    :param scale: of exploration, in the trajectory's unit, length D
    :param cnmp: trained on the demonstrations
    :param demonstrations: their spread shapes the noise, their representations span the latents
    :param context: shape (C,)
    """
    condition = cnmp.condition(cnmp.times.new_tensor(context)[None])
    sigma = np.broadcast_to(np.asarray(scale), demonstrations.trajectory_shape)
    found: list[FloatArray] = []
    if settings.latent and settings.n_latents:
        axes = latent_axes(cnmp, demonstrations, settings.n_latents)
        along = effects_of_latents(cnmp, condition, SMALL * axes)
        found.append(settings.latent * along / max(deviation(along[:1], sigma)[0], 1e-12))
    if settings.context:
        along = effects_of_contexts(cnmp, condition, len(context))
        found.append(settings.context * along / deviation(along, sigma)[:, None, None])
    if settings.noise:
        found.append(shaped_directions(settings, scale, demonstrations))
    return np.concatenate(found)


def latent_axes(cnmp: CNMP, demonstrations: Demonstrations, n_axes: int) -> th.Tensor:
    """Return the principal axes of the demonstrations' representations, (<= n_axes, E * Z).

    Each has the length of the representations' standard deviation along it.

    :param cnmp: trained on the demonstrations
    :param demonstrations: to encode
    :param n_axes: how many at most; there are less than demonstrations
    """
    codes = cnmp.encode_whole(demonstrations)
    _, lengths, axes = th.linalg.svd(codes - codes.mean(dim=0), full_matrices=False)
    n = min(n_axes, max(len(codes) - 1, 1))
    return axes[:n] * (lengths[:n, None] / len(codes) ** 0.5)


def effects_of_latents(cnmp: CNMP, condition: th.Tensor, steps: th.Tensor) -> FloatArray:
    """Return how trajectories change with steps in the latent space, shape (n, T, D).

    :param cnmp: the network
    :param condition: of the context, shape (1, C)
    :param steps: of all E members side by side, shape (n, E * Z)
    """
    centre, same = cnmp.representation(condition), condition.expand(len(steps), -1)
    change = cnmp.mean(same, centre + steps) - cnmp.mean(same, centre - steps)
    return (change / 2).cpu().numpy().astype(np.float64)


def effects_of_contexts(cnmp: CNMP, condition: th.Tensor, context_dim: int) -> FloatArray:
    """Return how trajectories change with the context that is asked for, shape (C, T, D).

    :param cnmp: the network
    :param condition: of the context, shape (1, K)
    :param context_dim: C; these come first, then the mode
    """
    step = SMALL * th.eye(context_dim, condition.shape[1], device=condition.device)
    ahead, back = condition + step, condition - step
    change = cnmp.mean(ahead, cnmp.representation(ahead)) - cnmp.mean(
        back, cnmp.representation(back)
    )
    return (change / 2).cpu().numpy().astype(np.float64)


def deviation(trajectories: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return the root mean square over time and dimensions, in units of sigma, shape (n,).

    :param trajectories: deviations, shape (n, T, D)
    :param sigma: shape (T, D)
    """
    return np.maximum(np.sqrt(np.mean((trajectories / sigma) ** 2, axis=(1, 2))), 1e-12)
