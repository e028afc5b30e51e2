"""`CNMP`: conditional neural movement primitives (thesis 4.3).

Shape letters: N demonstrations, B batch, T time points, D dimensions of the trajectory, C context,
K condition (the context and, where modes are told apart, the mode), O conditioning points, Z
representation, E members.
"""

import numpy as np
import torch as th
from numpy.typing import ArrayLike, NDArray
from torch import nn

from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.models.architecture import CNMPArchitecture
from sb3_nmp.models.conditional_neural_process import ConditionalNeuralProcess
from sb3_nmp.models.mode_gate import ModeGate
from sb3_nmp.models.modes import sort_into_modes
from sb3_nmp.models.via_points import (
    N_SHAPES,
    Conditioning,
    Points,
    Prior,
    checked,
    principal_deviations,
)

#: at which the shapes of demonstrations are compared to tell their modes apart
N_MOMENTS = 8


class CNMP(nn.Module):
    """A conditional neural process over trajectories, with its own scaling of data.

    Seker, Imre, Piater and Ugur, "Conditional neural movement primitives", 2019.

    >>> cnmp = CNMP(context_dim=2, trajectory_shape=(50, 3))
    >>> cnmp.trajectories([[0.1, 0.2]]).shape
    (1, 50, 3)
    >>> cnmp.trajectories([[0.1, 0.2]], points=([0.5], [[0.0, 1.0, 0.0]])).shape  # a via-point
    (1, 50, 3)

    :param context_dim: C
    :param trajectory_shape: (T, D)
    :param architecture: sizes and kinds of its layers
    """

    times: th.Tensor
    context_mean: th.Tensor
    context_std: th.Tensor
    value_mean: th.Tensor
    value_std: th.Tensor
    value_range: th.Tensor
    deviations: th.Tensor

    def __init__(
        self,
        context_dim: int,
        trajectory_shape: tuple[int, int],
        architecture: CNMPArchitecture | None = None,
    ) -> None:
        super().__init__()
        architecture = architecture or CNMPArchitecture()
        n_time_points, n_dimensions = trajectory_shape
        n_modes = architecture.n_modes
        self.gate = ModeGate(context_dim, n_modes) if n_modes > 1 else None
        condition_dim = context_dim + (n_modes * (context_dim + 1) if n_modes > 1 else 0)
        self.network = ConditionalNeuralProcess(n_dimensions, condition_dim, architecture)
        self.has_fitted_trend = architecture.has_fitted_trend
        self.register_buffer("times", th.linspace(0.0, 1.0, n_time_points))
        self.register_buffer("context_mean", th.zeros(context_dim))
        self.register_buffer("context_std", th.ones(context_dim))
        self.register_buffer("value_mean", th.zeros(n_dimensions))
        self.register_buffer("value_std", th.ones(n_dimensions))
        self.register_buffer("value_range", th.ones(n_dimensions))
        self.register_buffer("deviations", th.zeros(N_SHAPES, n_time_points, n_dimensions))

    def set_scale(self, demonstrations: Demonstrations) -> None:
        """Take mean and spread of contexts and values from demonstrations.

        :param demonstrations: those that the network will be trained on
        """
        for name, values in (
            ("context", demonstrations.contexts),
            ("value", demonstrations.trajectories.reshape(-1, self.value_mean.shape[0])),
        ):
            mean, std = values.mean(axis=0), values.std(axis=0)
            std = np.where(std < 1e-6, 1.0, std)
            for part, value in (("mean", mean), ("std", std)):
                buffer = getattr(self, f"{name}_{part}")
                buffer.copy_(th.as_tensor(value, dtype=th.float32))
        spread = np.ptp(demonstrations.trajectories, axis=(0, 1))
        self.value_range.copy_(th.as_tensor(np.where(spread < 1e-6, 1.0, spread)))
        found = principal_deviations(demonstrations.trajectories)
        self.deviations.copy_(th.as_tensor(found))

    @property
    def is_scaled(self) -> bool:
        """Whether the scale is that of demonstrations."""
        return bool((self.value_mean != 0).any() or (self.value_std != 1).any())

    def condition(self, contexts: th.Tensor, modes: th.Tensor | None = None) -> th.Tensor:
        """Return what the network is conditioned on, shape (B, K): contexts, then the mode.

        Contexts have a standard deviation of 1. Without a gate there is no mode. With one, each
        mode has a block of its own, of the context and 1, and those of the other modes are 0: so
        the trend has slopes for each mode, not an offset alone. A way round the right of something
        answers its place otherwise than a way round the left.

        :param contexts: shape (B, C)
        :param modes: shape (B,); by default the gate's choice
        """
        seen = self.normalise_contexts(contexts)
        if self.gate is None:
            return seen
        chosen = self.gate(seen) if modes is None else modes
        mode = nn.functional.one_hot(chosen, self.gate.n_modes).to(seen)
        own = mode[:, :, None] * seen[:, None, :]
        return th.cat([seen, own.flatten(1), mode], dim=1)

    def condition_near(self, contexts: th.Tensor, points: Points | None) -> th.Tensor:
        """Return the condition in the mode whose answer is nearest to via-points, shape (B, K).

        :param contexts: shape (B, C)
        :param points: None leaves the mode to the gate
        """
        if self.gate is None or points is None:
            return self.condition(contexts)
        passed = points.at(len(self.times)).to(self.times) @ self.each_mode(contexts)
        misses = self.normalise(passed) - self.normalise(points.values)
        return self.condition(contexts, self._nearest(misses))

    @th.no_grad()
    def each_mode(self, contexts: th.Tensor) -> th.Tensor:
        """Return the answer of every mode, shape (B, modes, T, D); a single one without a gate.

        :param contexts: shape (B, C)
        """
        n_modes = 1 if self.gate is None else self.gate.n_modes
        modes = th.arange(n_modes, device=contexts.device).repeat(len(contexts))
        condition = self.condition(contexts.repeat_interleave(n_modes, dim=0), modes)
        answers = self.mean(condition, self.representation(condition))
        return answers.unflatten(0, (len(contexts), n_modes))

    def find_modes(self, demonstrations: Demonstrations) -> th.Tensor:
        """Tell the modes of demonstrations apart (`sort_into_modes`), shape (N,).

        :param demonstrations: N of them, whose scale is known (`set_scale`)
        """
        if self.gate is None:
            return self._no_modes(demonstrations)
        contexts, values = self._normalised(demonstrations)
        at = th.linspace(0, len(self.times) - 1, N_MOMENTS).round().long()
        shapes = values[:, at].flatten(1).cpu().numpy().astype(np.float64)
        found = sort_into_modes(contexts.cpu().numpy(), shapes, self.gate.n_modes)
        return th.as_tensor(found, device=values.device)

    def fit_trend(self, demonstrations: Demonstrations, modes: th.Tensor) -> None:
        """Let the decoder's trend be the linear regression on demonstrations, where it is fitted.

        :param demonstrations: N of them, whose scale is known (`set_scale`)
        :param modes: theirs, shape (N,)
        """
        if self.has_fitted_trend:
            condition = self.condition(self.times.new_tensor(demonstrations.contexts), modes)
            values = self._normalised(demonstrations)[1]
            self.network.decoder.fit_trend(self.times, condition, values)

    def nearest_modes(self, demonstrations: Demonstrations) -> th.Tensor:
        """Return for each demonstration the mode whose answer is nearest to it, shape (N,).

        :param demonstrations: N of them
        """
        if self.gate is None:
            return self._no_modes(demonstrations)
        answers = self.each_mode(self.times.new_tensor(demonstrations.contexts))
        return self._nearest(self.normalise(answers) - self._normalised(demonstrations)[1][:, None])

    def _no_modes(self, demonstrations: Demonstrations) -> th.Tensor:
        """Return mode 0 for each, shape (N,), without a gate."""
        return th.zeros(len(demonstrations), dtype=th.long, device=self.times.device)

    def _nearest(self, misses: th.Tensor) -> th.Tensor:
        """Return the modes with the least squared misses, given as (B, modes, *, D)."""
        squares = misses.square().mean(dim=(2, 3))
        if self.gate is not None:
            squares = squares.masked_fill(~self.gate.is_taken, th.inf)
        return squares.argmin(dim=1)

    def teach_gate(self, demonstrations: Demonstrations, modes: th.Tensor) -> None:
        """Teach the gate in which contexts which mode was taken.

        :param demonstrations: N of them
        :param modes: shape (N,)
        """
        if self.gate is not None:
            self.gate.learn(self._normalised(demonstrations)[0], modes.cpu().numpy())

    def _normalised(self, demonstrations: Demonstrations) -> tuple[th.Tensor, th.Tensor]:
        """Return contexts (N, C) and trajectories (N, T, D) as the network sees them."""
        contexts = self.times.new_tensor(demonstrations.contexts)
        values = self.times.new_tensor(demonstrations.trajectories)
        return self.normalise_contexts(contexts), self.normalise(values)

    def normalise_contexts(self, contexts: th.Tensor) -> th.Tensor:
        """Return contexts with a standard deviation of 1.

        :param contexts: shape (*, C)
        """
        return (contexts.to(self.times.dtype) - self.context_mean) / self.context_std

    def normalise(self, values: th.Tensor) -> th.Tensor:
        """Return trajectory values as the network sees them.

        :param values: shape (*, D)
        """
        return (values - self.value_mean) / self.value_std

    def representation(self, condition: th.Tensor, points: Points | None = None) -> th.Tensor:
        """Return the representation of conditioning points, or of contexts alone, shape (B, E * Z).

        :param condition: shape (B, C), as `condition` returns it
        :param points: conditioning points; None: no points
        """
        if points is None:
            return self.network.encode_condition(condition)
        shape = (len(condition), len(points.times))
        return self.network.encode(
            points.times.expand(shape),
            self.normalise(points.values).expand(*shape, -1),
            condition,
            th.ones(shape, device=condition.device),
        )

    @th.no_grad()
    def encode_whole(self, demonstrations: Demonstrations) -> th.Tensor:
        """Return the representation of whole trajectories, shape (N, E * Z).

        :param demonstrations: contexts and trajectories
        """
        shape = (len(demonstrations), len(self.times))
        contexts = self.times.new_tensor(demonstrations.contexts)
        return self.network.encode(
            self.times.expand(shape),
            self._normalised(demonstrations)[1],
            self.condition(contexts, self.nearest_modes(demonstrations)),
            self.times.new_ones(shape),
        )

    def mean(self, condition: th.Tensor, representation: th.Tensor) -> th.Tensor:
        """Return mean trajectories in the trajectory's unit, shape (B, T, D).

        :param condition: shape (B, C), as `condition` returns it
        :param representation: shape (B, E * Z)
        """
        decoded = self.network.decode(self.times, representation, condition).mean
        return decoded * self.value_std + self.value_mean

    @th.no_grad()
    def trajectories(
        self, contexts: ArrayLike, points: tuple[ArrayLike, ArrayLike] | None = None
    ) -> NDArray[np.float64]:
        """Return the mean trajectory for each context, shape (N, T, D).

        :param contexts: shape (N, C)
        :param points: via-points that all trajectories pass: times in [0, 1], shape (O,), and
            values in the trajectory's unit, shape (O, D)
        :raises InvalidDataError: points of a wrong shape, times outside [0, 1], or points that
            contradict each other
        """
        asked = self.times.new_tensor(np.asarray(contexts))
        if points is None:
            condition = self.condition(asked)
            decoded = self.mean(condition, self.representation(condition))
        else:
            passing = self.through(points)
            condition = self.condition_near(asked, passing.points)
            representation = self.representation(condition, passing.points)
            decoded = passing.moved(self.mean(condition, representation))
        return decoded.cpu().numpy().astype(np.float64)

    def through(self, points: tuple[ArrayLike, ArrayLike]) -> Conditioning:
        """Return how trajectories are moved to pass via-points, and the points, checked.

        :param points: times in [0, 1], shape (O,), and values in the trajectory's unit, (O, D)
        :raises InvalidDataError: a wrong shape, a time outside [0, 1], a non-finite value, or
            points that contradict each other
        """
        prior = Prior.like(self.deviations, self.value_std)
        return prior.given(checked(points, len(self.times), self.value_range))
