"""Networks over trajectories, whose forward passes return distributions.

Shape letters: B batch, O conditioning points, T target times, D dimensions of the trajectory,
K size of the condition (task parameters and reward), Z latent.
"""

import math
from itertools import pairwise

import torch as th
from torch import nn
from torch.distributions import Normal


def mlp(sizes: list[int], activation: type[nn.Module]) -> nn.Sequential:
    """Return a multi-layer perceptron with a linear last layer.

    :param sizes: of input, hidden layers and output
    :param activation: between the layers
    """
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), activation()]
    return nn.Sequential(*layers[:-1])


class LinearPlus(nn.Module):
    """A linear map plus a multi-layer perceptron: few examples determine the linear part best.

    :param sizes: of input, hidden layers and output
    :param activation: between the layers
    """

    def __init__(self, sizes: list[int], activation: type[nn.Module]) -> None:
        super().__init__()
        self.linear = nn.Linear(sizes[0], sizes[-1])
        self.correction = mlp(sizes, activation)

    def forward(self, inputs: th.Tensor) -> th.Tensor:
        """Return the sum, shape (*, outputs).

        :param inputs: shape (*, inputs)
        """
        return self.linear(inputs) + self.correction(inputs)


class TimeFeatures(nn.Module):
    """Time as a vector: t itself, and sines and cosines up to a highest frequency.

    A multi-layer perceptron fed with t alone is slow to learn a path that bends several times;
    the thesis's networks are fed with t alone (``n_frequencies = 0``).

    :param n_frequencies: number of frequencies: 1/2, 1, 3/2, ... periods over [0, 1]
    """

    frequencies: th.Tensor

    def __init__(self, n_frequencies: int) -> None:
        super().__init__()
        self.n_features = 1 + 2 * n_frequencies
        self.register_buffer("frequencies", math.pi * th.arange(1, n_frequencies + 1))

    def forward(self, times: th.Tensor) -> th.Tensor:
        """Return the features, shape (*, n_features).

        :param times: in [0, 1], shape (*,)
        """
        angles = times[..., None] * self.frequencies
        return th.cat([times[..., None], angles.sin(), angles.cos()], dim=-1)


class TrajectoryDecoder(nn.Module):
    """From a latent, a condition and target times to the values at those times.

    The first layer is split by what varies with time and what does not, so that a batch of
    trajectories over common times costs the time features once.

    :param n_frequencies: of the time features
    :param inputs: size of latent and condition together
    :param arch: hidden layers
    :param outputs: size of the output at each target time
    :param activation: between the layers
    :param trend_dim: adds to so many of the outputs, the first ones, a trend that is linear in the
        inputs and in the time features. It is what few examples determine best
    """

    def __init__(
        self,
        n_frequencies: int,
        inputs: int,
        arch: list[int],
        outputs: int,
        activation: type[nn.Module],
        trend_dim: int = 0,
    ) -> None:
        super().__init__()
        self.features = TimeFeatures(n_frequencies)
        self.from_time = nn.Linear(self.features.n_features, arch[0])
        self.from_latent = nn.Linear(inputs, arch[0], bias=False)
        self.activation = activation()
        self.layers = mlp([*arch, outputs], activation)
        self.trend: nn.Linear | None = None
        if trend_dim:
            self.trend = nn.Linear(inputs, (self.features.n_features + 1) * trend_dim)
            nn.init.zeros_(self.trend.weight)
            nn.init.zeros_(self.trend.bias)

    def forward(self, times: th.Tensor, constant: th.Tensor) -> th.Tensor:
        """Return the outputs, shape (B, T, outputs).

        :param times: target times, shape (T,) or (B, T)
        :param constant: latent and condition, shape (B, inputs)
        """
        features = self.features(times)
        hidden = self.from_time(features) + self.from_latent(constant)[:, None]
        outputs = self.layers(self.activation(hidden))
        if self.trend is None:
            return outputs
        bases = nn.functional.pad(features, (0, 1), value=1.0).expand(*outputs.shape[:2], -1)
        trend = bases @ self.trend(constant).unflatten(1, (bases.shape[-1], -1))
        return outputs + nn.functional.pad(trend, (0, outputs.shape[-1] - trend.shape[-1]))


class NeuralProcess(nn.Module):
    """Encoder from conditioning points to a latent Gaussian, decoder from a latent to values.

    Thesis 4.2 and 6.1, Fig. 6.1: condition (task parameters, reward) and time are given to both
    encoder and decoder; the points' representations are averaged; the prior of z is N(0, I).

    :param value_dim: D
    :param condition_dim: K
    :param latent_dim: Z
    :param encoder_arch: hidden layers of the encoder
    :param decoder_arch: hidden layers of the decoder
    :param n_frequencies: of the time features
    :param decoder_std: standard deviation of the decoder's Gaussian, in the values' unit
    :param activation: between the layers
    """

    def __init__(
        self,
        value_dim: int,
        condition_dim: int,
        latent_dim: int,
        encoder_arch: list[int],
        decoder_arch: list[int],
        n_frequencies: int,
        decoder_std: float,
        activation: type[nn.Module],
    ) -> None:
        super().__init__()
        self.latent_dim, self.decoder_std = latent_dim, decoder_std
        self.features = TimeFeatures(n_frequencies)
        n_features = self.features.n_features
        encoder_inputs = n_features + value_dim + condition_dim
        self.encoder = mlp([encoder_inputs, *encoder_arch, 2 * latent_dim], activation)
        self.decoder = TrajectoryDecoder(
            n_frequencies, latent_dim + condition_dim, decoder_arch, value_dim, activation
        )

    def encode(self, times: th.Tensor, values: th.Tensor, condition: th.Tensor) -> Normal:
        """Return q(z | conditioning points, condition), batch shape (B, Z).

        :param times: of the conditioning points, shape (B, O)
        :param values: at those times, shape (B, O, D)
        :param condition: shape (B, K)
        """
        repeated = condition[:, None].expand(-1, times.shape[1], -1)
        points = th.cat([self.features(times), values, repeated], dim=-1)
        mean, raw = self.encoder(points).mean(dim=1).chunk(2, dim=-1)
        return Normal(mean, nn.functional.softplus(raw) + 1e-4, validate_args=False)

    def decode(self, times: th.Tensor, latent: th.Tensor, condition: th.Tensor) -> Normal:
        """Return p(x_t | z, t, condition) at every target time, batch shape (B, T, D).

        :param times: target times, shape (T,) or (B, T)
        :param latent: z, shape (B, Z)
        :param condition: shape (B, K)
        """
        mean = self.decoder(times, th.cat([latent, condition], dim=-1))
        return Normal(mean, mean.new_tensor(self.decoder_std), validate_args=False)


class ConditionalNeuralProcess(nn.Module):
    """Encoder from conditioning points to a representation, decoder from it to a Gaussian.

    Thesis 4.1 and 4.3, Fig. 4.1 and 4.3: the points' representations, each encoded together with
    the task parameters, are averaged. Without a conditioning point, the representation comes from
    the task parameters alone, by a network of its own. The thesis gives the task parameters to the
    decoder too; by default, here they reach it through the representation only, which therefore
    has to hold all that tells trajectories apart: moving in it moves between demonstrated skills.

    :param value_dim: D
    :param condition_dim: K, the task parameters
    :param representation_dim: Z
    :param encoder_arch: hidden layers of the encoder
    :param context_arch: hidden layers of the network from task parameters to representation
    :param decoder_arch: hidden layers of the decoder
    :param n_frequencies: of the time features
    :param min_std: smallest standard deviation that the decoder gives, in the values' unit
    :param condition_in_decoder: give the task parameters to the decoder too
    :param linear_trend: whether the mean has a trend that is linear in the decoder's inputs
    :param activation: between the layers
    """

    def __init__(
        self,
        value_dim: int,
        condition_dim: int,
        representation_dim: int,
        encoder_arch: list[int],
        context_arch: list[int],
        decoder_arch: list[int],
        n_frequencies: int,
        min_std: float,
        condition_in_decoder: bool,
        linear_trend: bool,
        activation: type[nn.Module],
    ) -> None:
        super().__init__()
        self.representation_dim, self.min_std = representation_dim, min_std
        self.condition_in_decoder = condition_in_decoder
        self.features = TimeFeatures(n_frequencies)
        encoder_inputs = self.features.n_features + value_dim + condition_dim
        self.encoder = mlp([encoder_inputs, *encoder_arch, representation_dim], activation)
        self.from_condition = LinearPlus(
            [condition_dim, *context_arch, representation_dim], activation
        )
        self.decoder = TrajectoryDecoder(
            n_frequencies,
            representation_dim + (condition_dim if condition_in_decoder else 0),
            decoder_arch,
            2 * value_dim,
            activation,
            value_dim if linear_trend else 0,
        )

    def encode(
        self, times: th.Tensor, values: th.Tensor, condition: th.Tensor, seen: th.Tensor
    ) -> th.Tensor:
        """Return the representation r, shape (B, Z): the mean over the points that are seen.

        Where none is seen, it is the condition's.

        :param times: of the conditioning points, shape (B, O)
        :param values: at those times, shape (B, O, D)
        :param condition: shape (B, K)
        :param seen: 1 for the points that count and 0 for the others, shape (B, O)
        """
        repeated = condition[:, None].expand(-1, times.shape[1], -1)
        points = self.encoder(th.cat([self.features(times), values, repeated], dim=-1))
        n_seen = seen.sum(dim=1, keepdim=True)
        mean = (points * seen[..., None]).sum(dim=1) / n_seen.clamp(min=1.0)
        return th.where(n_seen > 0, mean, self.from_condition(condition))

    def decode(self, times: th.Tensor, representation: th.Tensor, condition: th.Tensor) -> Normal:
        """Return p(x_t | r, t) at every target time, batch shape (B, T, D).

        :param times: target times, shape (T,) or (B, T)
        :param representation: r, shape (B, Z)
        :param condition: shape (B, K); without effect unless ``condition_in_decoder``
        """
        constant = (
            th.cat([representation, condition], dim=-1)
            if self.condition_in_decoder
            else representation
        )
        mean, raw = self.decoder(times, constant).chunk(2, dim=-1)
        return Normal(mean, nn.functional.softplus(raw) + self.min_std, validate_args=False)
