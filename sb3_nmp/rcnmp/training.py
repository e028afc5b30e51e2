"""The supervised learning of RC-NMP: mini-batches from the buffer and the ELBO (thesis Eq. 6.2).

Shape letters: S training steps, B batch, O conditioning points, P target points, D dimensions of
the trajectory, C size of the condition, K categories, Z latent.
"""

from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch import nn
from torch.distributions import Normal, kl_divergence
from torch.func import functional_call, vmap
from torch.optim import Optimizer

from sb3_nmp.common.lockstep import TrainingPhase
from sb3_nmp.models.neural_process import NeuralProcess
from sb3_nmp.models.stacking import Stack, shapes_of, stage_of
from sb3_nmp.rcnmp.settings import RCNMPTraining


@dataclass(frozen=True)
class Batch:
    """One mini-batch.

    :param observed_times: of the conditioning points, shape (B, O)
    :param observed_values: at those times, shape (B, O, D)
    :param target_times: shape (B, P)
    :param target_values: shape (B, P, D)
    :param condition: task parameters and reward, shape (B, C)
    :param noise: standard normal, for the reparametrisation, shape (B, Z)
    :param shares: of the conditioning points in their mean, shape (O,); None: all alike
    """

    observed_times: th.Tensor
    observed_values: th.Tensor
    target_times: th.Tensor
    target_values: th.Tensor
    condition: th.Tensor
    noise: th.Tensor
    shares: th.Tensor | None = None

    def padded(self, n: int) -> "Batch":
        """Return the same with n conditioning points, of which those that are new have no share.

        :param n: at least as many as there are
        """
        n_more = n - self.observed_times.shape[1]
        shares = self.noise.new_full((n - n_more,), 1 / (n - n_more))
        return replace(
            self,
            observed_times=nn.functional.pad(self.observed_times, (0, n_more)),
            observed_values=nn.functional.pad(self.observed_values, (0, 0, 0, n_more)),
            shares=nn.functional.pad(shares, (0, n_more)),
        )


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
    posterior = network.encode(
        batch.observed_times, batch.observed_values, batch.condition, batch.shares
    )
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


@dataclass(eq=False)
class ElboPhase(TrainingPhase):
    """The training of a network after a generation.

    :param network: the neural process
    :param optimizer: of its parameters
    :param settings: sizes and number of the batches
    :param batches: of `batches`
    :param beta: weight of the KL divergence of z
    :param bound: Eq. 6.2 of the last batch, once the phase is done
    """

    network: NeuralProcess
    optimizer: Optimizer
    settings: RCNMPTraining
    batches: Iterable[Batch]
    beta: float
    bound: Elbo | None = field(default=None, init=False)

    @property
    def kind(self) -> Hashable:
        """Shapes, settings, and steps that the optimizer has done."""
        network = shapes_of(self.network), self.network.decoder_std
        return network, stage_of(self.optimizer), self.settings, self.beta

    def alone(self) -> None:
        """Train the network."""
        for batch in self.batches:
            self.bound = elbo(self.network, batch, self.beta)
            self.optimizer.zero_grad()
            self.bound.loss.backward()
            self.optimizer.step()

    @classmethod
    def as_one(cls, phases: Sequence[Self]) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Train all networks as one.

        :param phases: of one kind
        """
        n_points = phases[0].settings.max_conditioning_points
        stack = Stack([phase.network for phase in phases], [phase.optimizer for phase in phases])
        bound = _Elbo(phases[0].network, phases[0].beta)
        bounds = vmap(lambda parameters, *batch: functional_call(bound, parameters, batch))
        parameters = {f"network.{name}": each for name, each in stack.parameters.items()}
        found: tuple[th.Tensor, ...] = ()
        for drawn in zip(*(phase.batches for phase in phases), strict=True):
            rows = zip(*(_tensors(batch.padded(n_points)) for batch in drawn), strict=True)
            found = bounds(parameters, *map(th.stack, rows))
            stack.optimizer.zero_grad()
            found[0].sum().backward()
            stack.optimizer.step()
        stack.give_back()
        for phase, *terms in zip(phases, *found, strict=True):
            phase.bound = Elbo(*terms)


class _Elbo(nn.Module):
    """Eq. 6.2 as a function of the tensors of a batch, for `functional_call`.

    :param network: the neural process
    :param beta: weight of the KL divergence of z
    """

    def __init__(self, network: NeuralProcess, beta: float) -> None:
        super().__init__()
        self.network, self.beta = network, beta

    def forward(self, *batch: th.Tensor) -> tuple[th.Tensor, ...]:
        """Return the terms of `Elbo`.

        :param batch: the tensors of a `Batch`
        """
        return _tensors(elbo(self.network, Batch(*batch), self.beta))


def _tensors(of: Batch | Elbo) -> tuple[th.Tensor, ...]:
    return tuple(vars(of).values())
