"""`NeuralProcess`: the network of RC-NMP, whose passes return distributions (thesis 4.2, 6.1).

Shape letters: B batch, O conditioning points, T target times, D dimensions of the trajectory,
C size of the condition (task parameters and reward), K categories, Z latent.
"""

from dataclasses import dataclass

import torch as th
from torch import nn
from torch.distributions import Categorical, Normal

from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.models.networks import TimeFeatures, TrajectoryDecoder, mlp


@dataclass(frozen=True)
class Posterior:
    """What conditioning points tell about category k and latent z.

    :param category: q(k | conditioning points, condition), batch shape (B,), K categories
    :param latent: q(z | k, conditioning points, condition) for each k, batch shape (B, K, Z)
    """

    category: Categorical
    latent: Normal


class NeuralProcess(nn.Module):
    """Encoder from conditioning points to a latent's posterior, decoder from a latent to values.

    Thesis 4.2 and 6.1, Fig. 6.1: condition (task parameters, reward) and time are given to both
    encoder and decoder; the points' representations are averaged; the prior of z is N(0, I).

    With more than one category, a discrete latent k stands beside z and captures modes that a
    Gaussian would connect (chapter 7 names it as future work). z's posterior depends on k, and the
    decoder sees k as a one-hot vector beside z: the *code* [z, one-hot of k].

    Garnelo et al., "Neural processes", 2018.

    >>> network = NeuralProcess(2, 1, 4, [16], [16], 2, 0.1, nn.Tanh, n_categories=3)
    >>> posterior = network.encode(th.rand(5, 6), th.rand(5, 6, 2), th.rand(5, 1))
    >>> posterior.category.probs.shape, posterior.latent.mean.shape
    (torch.Size([5, 3]), torch.Size([5, 3, 4]))
    >>> category = posterior.category.sample()
    >>> code = network.code(posterior.latent.mean[th.arange(5), category], category)
    >>> network.decode(th.linspace(0, 1, 50), code, th.rand(5, 1)).batch_shape
    torch.Size([5, 50, 2])

    :param value_dim: D
    :param condition_dim: C
    :param latent_dim: Z
    :param encoder_arch: hidden layers of the encoder
    :param decoder_arch: hidden layers of the decoder
    :param n_frequencies: of the time features
    :param decoder_std: standard deviation of the decoder's Gaussian, in the values' unit
    :param activation_fn: between the layers
    :param n_categories: K; 1 is the thesis's network, which has no k
    :raises ConfigurationError: no category
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
        n_categories: int = 1,
    ) -> None:
        super().__init__()
        if n_categories < 1:
            raise ConfigurationError(
                f"n_categories is {n_categories}; it must be >= 1, where 1 leaves the Gaussian "
                "latent alone."
            )
        if latent_dim < 1:
            raise ConfigurationError(f"latent_dim is {latent_dim}; it must be >= 1.")
        for name, arch in (("encoder_arch", encoder_arch), ("decoder_arch", decoder_arch)):
            if any(width < 1 for width in arch):
                raise ConfigurationError(f"{name} is {arch}; each layer must have a width >= 1.")
        self.latent_dim, self.decoder_std = latent_dim, decoder_std
        self.n_categories = n_categories
        #: length of a code: one category needs no one-hot vector
        self.code_dim = latent_dim + (n_categories if n_categories > 1 else 0)
        self.features = TimeFeatures(n_frequencies)
        n_features = self.features.n_features
        encoder_inputs = n_features + value_dim + condition_dim
        outputs = 2 * n_categories * latent_dim + self.code_dim - latent_dim
        self.encoder = mlp([encoder_inputs, *encoder_arch, outputs], activation_fn)
        self.decoder = TrajectoryDecoder(
            n_frequencies, self.code_dim + condition_dim, decoder_arch, value_dim, activation_fn
        )
        self.prior: nn.Linear | None = None
        if n_categories > 1:
            self.prior = nn.Linear(condition_dim, n_categories)
            nn.init.zeros_(self.prior.weight)
            nn.init.zeros_(self.prior.bias)

    def encode(
        self,
        times: th.Tensor,
        values: th.Tensor,
        condition: th.Tensor,
        shares: th.Tensor | None = None,
    ) -> Posterior:
        """Return q(k, z | conditioning points, condition).

        :param times: of the conditioning points, shape (B, O)
        :param values: at those times, shape (B, O, D)
        :param condition: shape (B, C)
        :param shares: of the points in the mean of their representations, shape (O,), of sum 1;
            None takes all alike
        """
        repeated = condition[:, None].expand(-1, times.shape[1], -1)
        points = th.cat([self.features(times), values, repeated], dim=-1)
        each = self.encoder(points)
        told = each.mean(dim=1) if shares is None else (shares[:, None] * each).sum(dim=1)
        n_latent = 2 * self.n_categories * self.latent_dim
        shape = (self.n_categories, 2 * self.latent_dim)
        mean, raw = told[:, :n_latent].unflatten(1, shape).chunk(2, dim=-1)
        logits = told[:, n_latent:] if self.n_categories > 1 else told.new_zeros((len(told), 1))
        return Posterior(
            Categorical(logits=logits, validate_args=False),
            Normal(mean, nn.functional.softplus(raw) + 1e-4, validate_args=False),
        )

    def category_prior(self, condition: th.Tensor) -> Categorical:
        """Return p(k | condition): how often trajectories of that condition are of each category.

        :param condition: shape (B, C)
        """
        if self.prior is None:
            return Categorical(logits=condition.new_zeros((len(condition), 1)))
        return Categorical(logits=self.prior(condition), validate_args=False)

    def code(self, latent: th.Tensor, category: th.Tensor) -> th.Tensor:
        """Return the codes [z, one-hot of k], shape (*, `code_dim`); z alone for one category.

        :param latent: z, shape (*, Z)
        :param category: k from 0 on, shape (*,)
        """
        if self.n_categories == 1:
            return latent
        one_hot = nn.functional.one_hot(category, self.n_categories)
        return th.cat([latent, one_hot.to(latent.dtype)], dim=-1)

    def decode(self, times: th.Tensor, code: th.Tensor, condition: th.Tensor) -> Normal:
        """Return p(x_t | z, k, t, condition) at every target time, batch shape (B, T, D).

        :param times: target times, shape (T,) or (B, T)
        :param code: of `code`, shape (B, `code_dim`)
        :param condition: shape (B, C)
        """
        mean = self.decoder(times, th.cat([code, condition], dim=-1))
        return Normal(mean, mean.new_tensor(self.decoder_std), validate_args=False)
