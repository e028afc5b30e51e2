"""The supervised learning of RC-NMP: mini-batches from the buffer and the ELBO (thesis Eq. 6.2).

Shape letters: S training steps, B batch, O conditioning points, P target points, D dimensions of
the trajectory, C size of the condition, K categories, Z latent.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch.distributions import Normal, kl_divergence

from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.settings import settings_name
from sb3_nmp.models.neural_process import NeuralProcess


@settings_name("rcnmp-training")
@dataclass(frozen=True)
class RCNMPTraining:
    """How long and on what mini-batches RC-NMP's network is trained after each generation.

    >>> from sb3_nmp import RCNMPTraining
    >>> RCNMPTraining(n_steps=30).batch_size
    16

    :param n_steps: steps of Adam
    :param batch_size: trajectories per step
    :param n_target_points: random time points of each trajectory at which it is predicted
    :param max_conditioning_points: the encoder sees 1 to this many random points
    """

    n_steps: int = 60
    batch_size: int = 16
    n_target_points: int = 20
    max_conditioning_points: int = 10

    def __post_init__(self) -> None:
        """Check the values."""
        for name, value in vars(self).items():
            if int(value) != value or value < 1:
                raise ConfigurationError(f"{name} is {value}; it must be a whole number >= 1.")


@dataclass(frozen=True)
class Batch:
    """One mini-batch.

    :param observed_times: of the conditioning points, shape (B, O)
    :param observed_values: at those times, shape (B, O, D)
    :param target_times: shape (B, P)
    :param target_values: shape (B, P, D)
    :param condition: task parameters and reward, shape (B, C)
    :param noise: standard normal, for the reparametrisation, shape (B, Z)
    """

    observed_times: th.Tensor
    observed_values: th.Tensor
    target_times: th.Tensor
    target_values: th.Tensor
    condition: th.Tensor
    noise: th.Tensor


@dataclass(frozen=True)
class Elbo:
    """Eq. 6.2 and its terms, averaged over a batch; scalars.

    :param loss: minus the bound, and for several categories minus what `elbo` adds to it
    :param log_likelihood: E_q[log p(x_t | z, k, t, r)], averaged over the target points
    :param divergence: E_q(k)[KL(q(z | k, O, r) || N(0, I))]
    :param imbalance: KL(q(k) || uniform) of the batch's mean q(k); 0 for one category
    """

    loss: th.Tensor
    log_likelihood: th.Tensor
    divergence: th.Tensor
    imbalance: th.Tensor


def elbo(network: NeuralProcess, batch: Batch, beta: float, balance: float = 10.0) -> Elbo:
    """Return the evidence lower bound of Eq. 6.2 with one latent sample per trajectory.

    The log-likelihood is averaged, not summed, over time, so that beta does not depend on how
    many points are drawn.

    The expectation over categories k is the exact sum over all of them. The bound's divergence
    KL(q(k | O, r) || uniform), averaged over trajectories, is what k tells of them plus
    KL(q(k) || uniform) of their mean q(k) (Hoffman and Johnson, "ELBO surgery", 2016). Only the
    second part is charged: then no category dies, and telling modes apart costs nothing, where z
    pays beta for it. The prior p(k | r) follows q(k | O, r) and does not act on it.

    :param network: the neural process
    :param batch: trajectories drawn from the replay buffer
    :param beta: weight of the KL divergence of z
    :param balance: weight of KL(q(k) || uniform); measured in results/experiments/sampling.md
    """
    k = network.n_categories
    posterior = network.encode(batch.observed_times, batch.observed_values, batch.condition)
    latent = posterior.latent.mean + posterior.latent.stddev * batch.noise[:, None]
    category = th.arange(k, device=latent.device).expand(len(latent), k)
    predicted = network.decode(
        batch.target_times.repeat_interleave(k, dim=0),
        network.code(latent, category).flatten(0, 1),
        batch.condition.repeat_interleave(k, dim=0),
    )
    targets = batch.target_values.repeat_interleave(k, dim=0)
    by_category = predicted.log_prob(targets).sum(dim=-1).unflatten(0, (-1, k))
    shares = posterior.category.probs
    log_likelihood = (shares[..., None] * by_category).sum(dim=1).mean()
    prior = Normal(th.zeros_like(latent), 1.0, validate_args=False)
    divergence = (shares * kl_divergence(posterior.latent, prior).sum(dim=-1)).sum(dim=1).mean()
    loss = beta * divergence - log_likelihood
    if k == 1:
        return Elbo(loss, log_likelihood, divergence, loss.new_zeros(()))
    share = shares.mean(dim=0)
    imbalance = (share * (k * share).clamp(min=1e-12).log()).sum()
    learned = network.category_prior(batch.condition).logits
    prior_loss = -(shares.detach() * learned).sum(dim=1).mean()
    return Elbo(loss + balance * imbalance + prior_loss, log_likelihood, divergence, imbalance)


def batches(
    settings: RCNMPTraining,
    times: th.Tensor,
    values: th.Tensor,
    condition: th.Tensor,
    probabilities: NDArray[np.float64],
    latent_dim: int,
    rng: np.random.Generator,
) -> Iterator[Batch]:
    """Draw the mini-batches of one training phase.

    :param settings: sizes and number of batches
    :param times: of the time points, shape (T,)
    :param values: trajectories, shape (N, T, D)
    :param condition: shape (N, C)
    :param probabilities: of drawing each trajectory, shape (N,)
    :param latent_dim: Z
    :param rng: the generator to draw from
    """
    s, b, p = settings.n_steps, settings.batch_size, settings.n_target_points
    most = settings.max_conditioning_points
    rows = th.as_tensor(rng.choice(len(values), (s, b), p=probabilities), device=values.device)
    points = th.as_tensor(rng.integers(len(times), size=(s, b, p + most)), device=values.device)
    n_observed = rng.integers(1, most + 1, size=s)
    noise = th.as_tensor(rng.standard_normal((s, b, latent_dim), np.float32), device=values.device)
    for step in range(s):
        row, point = rows[step], points[step, :, : p + int(n_observed[step])]
        drawn, at = values[row[:, None], point], times[point]
        yield Batch(
            observed_times=at[:, p:],
            observed_values=drawn[:, p:],
            target_times=at[:, :p],
            target_values=drawn[:, :p],
            condition=condition[row],
            noise=noise[step],
        )
