"""`SkillSpace`: trajectories as smooth deviations from what a task begins with.

Shape letters: N trajectories, T time points, D dimensions, C context, B bases, P = B D weights.
"""

from typing import cast

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch import nn

from sb3_nmp.common.noise import SmoothNoise

FloatArray = NDArray[np.float64]

RAMP = 0.1  # share of the time in which deviations grow from 0 at a pinned end
RIDGE = 1e-3  # of the weights of a given trajectory, beside sums of T squares
N_MOMENTS = 20  # at which networks look at a trajectory


class SkillSpace(nn.Module):
    """Trajectory = initial trajectory of the context + smooth bases @ weights.

    The initial trajectory is taken to be linear in the context. Deviations begin at 0, as robots
    begin where they are. They end at 0 too where the initial trajectory moves, because it then
    knows the goal; one that rests knows none.

    >>> space = SkillSpace(context_dim=1, trajectory_shape=(50, 2), n_bases=6)
    >>> goals = np.array([[0.0], [1.0]])
    >>> lines = np.linspace(0.0, 1.0, 50)[:, None] * goals[:, None]
    >>> space.begin(goals, np.repeat(lines, 2, axis=2), scale=(0.1, 0.1))
    >>> space.trajectories(goals, np.zeros((2, 12)))[:, -1].round(3).tolist()
    [[0.0, 0.0], [1.0, 1.0]]

    :param context_dim: C
    :param trajectory_shape: (T, D)
    :param n_bases: B, evenly spaced over time
    """

    initial: th.Tensor
    bases: th.Tensor
    scale: th.Tensor

    def __init__(
        self, context_dim: int, trajectory_shape: tuple[int, int], n_bases: int = 8
    ) -> None:
        super().__init__()
        n_time_points, self.n_dimensions = trajectory_shape
        self.n_bases = n_bases
        double = th.float64
        self.register_buffer("initial", th.zeros(1 + context_dim, *trajectory_shape, dtype=double))
        self.register_buffer("bases", th.zeros(n_time_points, n_bases, dtype=double))
        self.register_buffer("scale", th.ones(self.n_weights))

    @property
    def n_weights(self) -> int:
        """P."""
        return self.n_bases * self.n_dimensions

    @property
    def has_begun(self) -> bool:
        """Whether `begin` has been called."""
        return bool(self.bases.any())

    def begin(
        self,
        contexts: NDArray[np.floating],
        trajectories: FloatArray,
        scale: tuple[float, ...],
    ) -> None:
        """Take over the initial trajectories, and what they say about start and goal.

        :param contexts: shape (N, C)
        :param trajectories: the initial ones of these contexts, shape (N, T, D)
        :param scale: of the exploration by dimension, length D: the unit of the weights
        """
        self.scale = self.scale.new_tensor(np.tile(scale, self.n_bases))
        rows, flat = np.asarray(contexts, np.float64), trajectories.reshape(len(contexts), -1)
        centre, middle = rows.mean(axis=0), flat.mean(axis=0)
        slopes, *_ = np.linalg.lstsq(rows - centre, flat - middle, rcond=1e-6)
        fitted = np.concatenate([(middle - centre @ slopes)[None], slopes])
        self.initial = self.initial.new_tensor(fitted.reshape(self.initial.shape))
        n_time_points = len(self.bases)
        times = np.linspace(0.0, 1.0, n_time_points)[:, None]
        bases = SmoothNoise(n_bases=self.n_bases).bases(n_time_points)
        bases = bases * np.minimum(1.0, times / RAMP)
        if np.abs(trajectories[:, -1] - trajectories[:, 0]).max() > 1e-6:
            bases = bases * np.minimum(1.0, (1.0 - times) / RAMP)
        self.bases = self.bases.new_tensor(bases)

    def start_from(self, contexts: NDArray[np.floating]) -> FloatArray:
        """Return the initial trajectories of contexts, shape (N, T, D).

        :param contexts: shape (N, C)
        """
        rows = np.column_stack([np.ones(len(contexts)), np.asarray(contexts, np.float64)])
        return np.tensordot(rows, self.initial.cpu().numpy(), axes=1)

    def trajectories(self, contexts: NDArray[np.floating], weights: FloatArray) -> FloatArray:
        """Return the trajectories of weights, shape (N, T, D).

        :param contexts: shape (N, C)
        :param weights: shape (N, P)
        """
        shaped = weights.reshape(len(weights), self.n_bases, self.n_dimensions)
        return self.start_from(contexts) + self.bases.cpu().numpy() @ shaped

    def weights(
        self, contexts: NDArray[np.floating], trajectories: NDArray[np.floating]
    ) -> FloatArray:
        """Return the weights whose trajectories are nearest to given ones, shape (N, P).

        :param contexts: shape (N, C)
        :param trajectories: shape (N, T, D)
        """
        bases = self.bases.cpu().numpy()
        gram = bases.T @ bases
        gram += RIDGE * np.eye(self.n_bases)
        deviations = np.asarray(trajectories, np.float64) - self.start_from(contexts)
        fitted = np.linalg.solve(gram, bases.T) @ deviations
        return cast(FloatArray, fitted.reshape(len(fitted), self.n_weights))

    def moments(self, weights: th.Tensor) -> th.Tensor:
        """Return the deviations at some moments, shape (..., moments * D); they have a gradient.

        :param weights: shape (..., P)
        """
        at = th.linspace(0, len(self.bases) - 1, N_MOMENTS).long()
        bases = self.bases[at].to(weights.dtype)
        shaped = weights.unflatten(-1, (self.n_bases, self.n_dimensions))
        return (bases @ shaped).flatten(-2)

    def initial_moments(self, contexts: th.Tensor) -> th.Tensor:
        """Return the initial trajectories at the same moments, shape (N, moments * D).

        Without what they have in common: 0 where they do not depend on the context.

        :param contexts: shape (N, C)
        """
        at = th.linspace(0, len(self.bases) - 1, N_MOMENTS).long()
        slopes = self.initial[1:, at].to(contexts.dtype)
        return th.tensordot(contexts, slopes, dims=1).flatten(-2)
