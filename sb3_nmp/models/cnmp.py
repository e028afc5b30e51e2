"""`CNMP`: conditional neural movement primitives (thesis 4.3).

Shape letters: N demonstrations, B batch, T time points, D dimensions of the trajectory, C context,
K condition, O conditioning points, Z representation, E members.
"""

import numpy as np
import torch as th
from numpy.typing import ArrayLike, NDArray
from torch import nn
from torch.distributions import Normal

from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.models.architecture import CNMPArchitecture
from sb3_nmp.models.networks import LinearPlus, TimeFeatures, TrajectoryDecoder, mlp
from sb3_nmp.models.via_points import (
    N_SHAPES,
    Conditioning,
    Points,
    Prior,
    checked,
    principal_deviations,
)


class ConditionalNeuralProcess(nn.Module):
    """Encoder from conditioning points to a representation, decoder from it to a Gaussian.

    After Garnelo et al., "Conditional neural processes", 2018; thesis 4.1 and 4.3, Fig. 4.1 and
    4.3. The points' representations, each encoded together with the task parameters, are averaged.
    Without a conditioning point, the representation comes from the task parameters alone, by a
    network of its own. The thesis gives the task parameters to the decoder too. By default, here
    they reach it through the representation alone, which therefore has to hold all that tells
    trajectories apart: moving in it moves between demonstrated skills.

    :param value_dim: D
    :param condition_dim: K, the task parameters
    :param architecture: sizes and kinds of its layers
    """

    def __init__(self, value_dim: int, condition_dim: int, architecture: CNMPArchitecture) -> None:
        super().__init__()
        a, code, n = architecture, architecture.representation_dim, architecture.n_members
        self.representation_dim, self.min_std, self.n_members = code, a.min_std, n
        self.condition_in_decoder = a.context_in_decoder
        self.features = TimeFeatures(a.n_frequencies)
        encoder_inputs = self.features.n_features + value_dim + condition_dim
        self.encoder = mlp([encoder_inputs, *a.encoder_arch, code], a.activation_fn, n)
        self.from_condition = LinearPlus([condition_dim, *a.context_arch, code], a.activation_fn, n)
        self.decoder = TrajectoryDecoder(
            a.n_frequencies,
            code + (condition_dim if a.context_in_decoder else 0),
            list(a.decoder_arch),
            2 * value_dim,
            a.activation_fn,
            value_dim if a.linear_trend else 0,
            n,
        )

    def encode(
        self, times: th.Tensor, values: th.Tensor, condition: th.Tensor, seen: th.Tensor
    ) -> th.Tensor:
        """Return the representation r, shape (B, E * Z): each member's, side by side.

        :param times: of the conditioning points, shape (B, O)
        :param values: at those times, shape (B, O, D)
        :param condition: shape (B, K)
        :param seen: 1 for the points that count and 0 for the others, shape (B, O)
        """
        return self._joined(self.encode_members(times, values, condition, seen))

    def encode_condition(self, condition: th.Tensor) -> th.Tensor:
        """Return the representation without conditioning points, shape (B, E * Z).

        :param condition: shape (B, K)
        """
        return self._joined(self.from_condition(self._for_each(condition, 2)))

    def decode(self, times: th.Tensor, representation: th.Tensor, condition: th.Tensor) -> Normal:
        """Return p(x_t | r, t) at every target time, batch shape (B, T, D).

        Of an ensemble, it has the mean of the members' means and of their variances.

        :param times: target times, shape (T,) or (B, T)
        :param representation: r, shape (B, E * Z)
        :param condition: shape (B, K); without effect unless ``condition_in_decoder``
        """
        found = self.decode_members(times, self.split(representation), condition)
        if self.n_members == 1:
            return found
        std = found.variance.mean(dim=0).sqrt()
        return Normal(found.mean.mean(dim=0), std, validate_args=False)

    def encode_members(
        self, times: th.Tensor, values: th.Tensor, condition: th.Tensor, seen: th.Tensor
    ) -> th.Tensor:
        """Return each member's representation, shape (E, B, Z), or (B, Z) of a single one.

        It is the mean over the points that are seen; where none is seen, the condition's. All
        arguments are as in `encode`, or begin with E to give each member its own.
        """
        times, condition = self._for_each(times, 2), self._for_each(condition, 2)
        values, seen = self._for_each(values, 3), self._for_each(seen, 2)
        repeated = condition[..., None, :].expand(*times.shape, -1)
        points = self.encoder(th.cat([self.features(times), values, repeated], dim=-1))
        n_seen = seen.sum(dim=-1, keepdim=True)
        mean = (points * seen[..., None]).sum(dim=-2) / n_seen.clamp(min=1.0)
        return th.where(n_seen > 0, mean, self.from_condition(condition))

    def decode_members(
        self, times: th.Tensor, representation: th.Tensor, condition: th.Tensor
    ) -> Normal:
        """Return each member's Gaussian, batch shape (E, B, T, D), or (B, T, D) of a single one.

        :param times: as in `decode`, or each member's own, shape (E, B, T)
        :param representation: shape (E, B, Z), or (B, Z) of a single one
        :param condition: as in `decode`, or each member's own, shape (E, B, K)
        """
        if self.n_members > 1:
            times = self._for_each(th.atleast_2d(times), 2)
        constant = representation
        if self.condition_in_decoder:
            constant = th.cat([representation, self._for_each(condition, 2)], dim=-1)
        mean, raw = self.decoder(times, constant).chunk(2, dim=-1)
        return Normal(mean, nn.functional.softplus(raw) + self.min_std, validate_args=False)

    def split(self, representation: th.Tensor) -> th.Tensor:
        """Return the members' representations, shape (E, B, Z), or (B, Z) of a single one.

        :param representation: shape (B, E * Z)
        """
        if self.n_members == 1:
            return representation
        return representation.unflatten(1, (self.n_members, -1)).movedim(1, 0)

    def _joined(self, members: th.Tensor) -> th.Tensor:
        return members if self.n_members == 1 else members.movedim(0, 1).flatten(1)

    def _for_each(self, given: th.Tensor, n_axes: int) -> th.Tensor:
        """Return what all members are given, or each is given, with E in front."""
        if self.n_members == 1 or given.ndim > n_axes:
            return given
        return given.expand(self.n_members, *given.shape)


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
        self.network = ConditionalNeuralProcess(n_dimensions, context_dim, architecture)
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

    def condition(self, contexts: th.Tensor) -> th.Tensor:
        """Return contexts as the network sees them, shape (B, C).

        :param contexts: shape (B, C)
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
        return self.network.encode(
            self.times.expand(shape),
            self.normalise(self.times.new_tensor(demonstrations.trajectories)),
            self.condition(self.times.new_tensor(demonstrations.contexts)),
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
        condition = self.condition(self.times.new_tensor(np.asarray(contexts)))
        if points is None:
            decoded = self.mean(condition, self.representation(condition))
        else:
            passing = self.through(points)
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
