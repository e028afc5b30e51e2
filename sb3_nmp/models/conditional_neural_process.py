"""`ConditionalNeuralProcess`: the network of a CNMP (thesis 4.1 and 4.3).

Shape letters: B batch, T time points, D dimensions of the trajectory, K condition, O conditioning
points, Z representation, E members.
"""

import torch as th
from torch import nn
from torch.distributions import Normal

from sb3_nmp.models.architecture import CNMPArchitecture
from sb3_nmp.models.networks import LinearPlus, TimeFeatures, TrajectoryDecoder, mlp


class ConditionalNeuralProcess(nn.Module):
    """Encoder from conditioning points to a representation, decoder from it to a Gaussian.

    After Garnelo et al., "Conditional neural processes", 2018; thesis 4.1 and 4.3, Fig. 4.1 and
    4.3. The points' representations, each encoded together with the task parameters, are averaged.
    Without a conditioning point, the representation comes from the task parameters alone, by a
    network of its own. The decoder is given the task parameters too, as in the thesis. With
    ``context_in_decoder=False`` and no fitted trend they reach it through the representation alone,
    which therefore has to hold all that tells trajectories apart: moving in it moves between
    demonstrated skills.

    :param value_dim: D
    :param condition_dim: K, the task parameters
    :param architecture: sizes and kinds of its layers
    """

    def __init__(self, value_dim: int, condition_dim: int, architecture: CNMPArchitecture) -> None:
        super().__init__()
        a, code, n = architecture, architecture.representation_dim, architecture.n_members
        self.representation_dim, self.min_std, self.n_members = code, a.min_std, n
        self.beta_nll = a.beta_nll
        self.condition_in_decoder = a.context_in_decoder
        self.condition_in_trend = a.has_fitted_trend and not a.context_in_decoder
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
            condition_dim if self.condition_in_trend else 0,
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
        :param condition: shape (B, K); without effect unless the decoder or its trend is given it
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
        constant, beside = representation, None
        if self.condition_in_decoder:
            constant = th.cat([representation, self._for_each(condition, 2)], dim=-1)
        elif self.condition_in_trend:
            beside = self._for_each(condition, 2)
        mean, raw = self.decoder(times, constant, beside).chunk(2, dim=-1)
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
