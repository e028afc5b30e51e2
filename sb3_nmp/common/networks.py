"""The neural process: a network over trajectories whose forward passes return distributions.

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
        # The decoder's first layer, split by what varies with time and what does not.
        self.from_time = nn.Linear(n_features, decoder_arch[0])
        self.from_latent = nn.Linear(latent_dim + condition_dim, decoder_arch[0], bias=False)
        self.activation = activation()
        self.decoder = mlp([*decoder_arch, value_dim], activation)

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
        constant = self.from_latent(th.cat([latent, condition], dim=-1))
        hidden = self.from_time(self.features(times)) + constant[:, None]
        mean = self.decoder(self.activation(hidden))
        return Normal(mean, mean.new_tensor(self.decoder_std), validate_args=False)
