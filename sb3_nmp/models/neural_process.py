"""`NeuralProcess`: the network of RC-NMP, whose passes return distributions (thesis 4.2, 6.1).

Shape letters: B batch, O conditioning points, T target times, D dimensions of the trajectory,
K size of the condition (task parameters and reward), Z latent.
"""

import torch as th
from torch import nn
from torch.distributions import Normal

from sb3_nmp.models.networks import TimeFeatures, TrajectoryDecoder, mlp


class NeuralProcess(nn.Module):
    """Encoder from conditioning points to a latent Gaussian, decoder from a latent to values.

    Thesis 4.2 and 6.1, Fig. 6.1: condition (task parameters, reward) and time are given to both
    encoder and decoder; the points' representations are averaged; the prior of z is N(0, I).

    Garnelo et al., "Neural processes", 2018.

    >>> network = NeuralProcess(2, 1, 4, [16], [16], 2, 0.1, nn.Tanh)
    >>> posterior = network.encode(th.rand(3, 5), th.rand(3, 5, 2), th.rand(3, 1))
    >>> network.decode(th.linspace(0, 1, 50), posterior.mean, th.rand(3, 1)).batch_shape
    torch.Size([3, 50, 2])

    :param value_dim: D
    :param condition_dim: K
    :param latent_dim: Z
    :param encoder_arch: hidden layers of the encoder
    :param decoder_arch: hidden layers of the decoder
    :param n_frequencies: of the time features
    :param decoder_std: standard deviation of the decoder's Gaussian, in the values' unit
    :param activation_fn: between the layers
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
        activation_fn: type[nn.Module],
    ) -> None:
        super().__init__()
        self.latent_dim, self.decoder_std = latent_dim, decoder_std
        self.features = TimeFeatures(n_frequencies)
        n_features = self.features.n_features
        encoder_inputs = n_features + value_dim + condition_dim
        self.encoder = mlp([encoder_inputs, *encoder_arch, 2 * latent_dim], activation_fn)
        self.decoder = TrajectoryDecoder(
            n_frequencies, latent_dim + condition_dim, decoder_arch, value_dim, activation_fn
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
