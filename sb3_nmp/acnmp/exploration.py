"""Where ACNMP explores: directions in trajectory space that the latent space and noise give.

The thesis claims that exploration comes from the latent space of the demonstrations (5.1). Here a
trajectory is tried at ``mean + sum_j x_j direction_j``, with a direction for each principal axis of
the demonstrations' representations and for each task parameter, both seen through the decoder, and
for each smooth basis over time in each dimension.
"""

from dataclasses import dataclass

import numpy as np
import torch as th
from numpy.typing import NDArray

from sb3_nmp.common.cnmp import CNMP
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.noise import SmoothNoise

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Exploration:
    """Scales of exploration; each part is switched off by a 0.

    :param latent_std: along the principal axes of the demonstrations' representations, in their
        standard deviations
    :param n_latents: how many of these axes
    :param context_std: along the task parameters at which the CNMP is queried, in the
        demonstrations' standard deviations
    :param noise: smooth noise in the trajectory's unit; its sigma None takes the environment's
        ``exploration_scale``
    :param shaped: scale the noise over time as the demonstrations spread, so that nothing is
        explored where all of them agree, such as a common start
    :raises ConfigurationError: a value below 0, or nothing to explore
    """

    latent_std: float = 0.3
    n_latents: int = 3
    context_std: float = 0.0
    noise: SmoothNoise | None = SmoothNoise(n_bases=4)  # noqa: RUF009 (frozen)
    shaped: bool = True

    def __post_init__(self) -> None:
        """Check the values."""
        for name in ("latent_std", "n_latents", "context_std"):
            if not getattr(self, name) >= 0:
                raise ConfigurationError(f"{name} is {getattr(self, name)}; it must be >= 0.")
        if self.noise is None and not (self.latent_std and self.n_latents) and not self.context_std:
            raise ConfigurationError(
                "nothing is explored: give a noise, latent_std and n_latents, or context_std."
            )


@th.no_grad()
def directions(
    settings: Exploration, cnmp: CNMP, demonstrations: Demonstrations, context: FloatArray
) -> FloatArray:
    """Return the directions in trajectory space, each of one standard deviation, shape (n, T, D).

    :param settings: the scales; its noise has a sigma
    :param cnmp: trained on the demonstrations
    :param demonstrations: their spread shapes the noise, their representations span the latents
    :param context: shape (C,)
    """
    condition = cnmp.condition(cnmp.times.new_tensor(context)[None])
    found: list[FloatArray] = []
    if settings.latent_std and settings.n_latents:
        centre = cnmp.representation(condition)
        axes = settings.latent_std * latent_axes(cnmp, demonstrations, settings.n_latents)
        same = condition.expand(len(axes), -1)
        found.append(_half(cnmp.mean(same, centre + axes) - cnmp.mean(same, centre - axes)))
    if settings.context_std:
        shift = settings.context_std * th.eye(condition.shape[1], device=condition.device)
        ahead, back = condition + shift, condition - shift
        moved = cnmp.mean(ahead, cnmp.representation(ahead))
        found.append(_half(moved - cnmp.mean(back, cnmp.representation(back))))
    if settings.noise is not None:
        found.append(noise_directions(settings.noise, settings.shaped, demonstrations))
    return np.concatenate(found)


def latent_axes(cnmp: CNMP, demonstrations: Demonstrations, n_axes: int) -> th.Tensor:
    """Return the principal axes of the demonstrations' representations, shape (<= n_axes, Z).

    Each has the length of the representations' standard deviation along it.

    :param cnmp: trained on the demonstrations
    :param demonstrations: to encode
    :param n_axes: how many at most; there are less than demonstrations
    """
    codes = cnmp.encode_whole(demonstrations)
    _, lengths, axes = th.linalg.svd(codes - codes.mean(dim=0), full_matrices=False)
    n = min(n_axes, len(codes) - 1)
    return axes[:n] * (lengths[:n, None] / len(codes) ** 0.5)


def noise_directions(
    noise: SmoothNoise, shaped: bool, demonstrations: Demonstrations
) -> FloatArray:
    """Return one direction for each basis and dimension, shape (n_bases * D, T, D).

    :param noise: its bases, and its sigma by dimension
    :param shaped: scale it over time as the demonstrations spread, at the same root mean square
    :param demonstrations: shape (N, T, D)
    """
    n_time_points, n_dimensions = demonstrations.trajectory_shape
    scale = np.ones((n_time_points, n_dimensions))
    if shaped and len(demonstrations) > 1:
        spread = demonstrations.trajectories.std(axis=0)
        typical = np.sqrt((spread**2).mean(axis=0))
        scale = np.where(typical > 1e-9, spread / np.maximum(typical, 1e-9), 1.0)
    scale = scale * np.asarray(noise.sigma)
    bases = noise.bases(n_time_points)
    each = np.einsum("tk,td,de->kdte", bases, scale, np.eye(n_dimensions))
    return each.reshape(-1, n_time_points, n_dimensions)


def _half(difference: th.Tensor) -> FloatArray:
    return (difference / 2).cpu().numpy().astype(np.float64)
