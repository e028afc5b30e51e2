"""How a CNMP learns trajectories: random points, Eq. 4.1, and the training on demonstrations.

Shape letters: N demonstrations, B batch, T time points, D dimensions of the trajectory, C context,
O conditioning points, P target points, E members.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch as th
from stable_baselines3.common.utils import update_learning_rate

from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.settings import Rules, Settings, settings_name, whole
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.conditional_neural_process import ConditionalNeuralProcess

#: batches drawn at once
CHUNK = 100


@settings_name("cnmp-pretraining")
@dataclass(frozen=True)
class CNMPPretraining(Settings):
    """How a CNMP is trained on demonstrations before any rollout.

    Small batches pay: at equal time they generalise better than large ones, which meet the
    demonstrations more exactly (``results/experiments/acnmp.md``).

    >>> from sb3_nmp import CNMPPretraining
    >>> CNMPPretraining(n_steps=500).batch_size
    8

    :param n_steps: steps of Adam
    :param batch_size: demonstrations per step
    :param n_target_points: random time points of each at which it is predicted
    :param max_conditioning_points: the encoder sees at most so many random points, and none half
        of the time, as in `predict` without via-points
    :param learning_rate: of Adam at the start; it falls to a hundredth along a cosine
    :param weight_decay: of AdamW
    :raises ConfigurationError: a value outside its range
    """

    n_steps: int = 3000
    batch_size: int = 8
    n_target_points: int = 5
    max_conditioning_points: int = 5
    learning_rate: float = 3e-3
    weight_decay: float = 0.0

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {
            "n_steps": whole(self.n_steps, least=0),
            "batch_size": whole(self.batch_size, least=1),
            "n_target_points": whole(self.n_target_points, least=1),
            "max_conditioning_points": whole(self.max_conditioning_points, least=0),
            "learning_rate": (self.learning_rate > 0, "> 0"),
            "weight_decay": (self.weight_decay >= 0, ">= 0"),
        }


@dataclass(frozen=True)
class PointBatch:
    """Random conditioning and target points of a batch of trajectories, in normalised values.

    Where each member of an ensemble has its own batch, all shapes begin with E.

    :param times: of all points, shape (B, O + P)
    :param values: at those times, shape (B, O + P, D)
    :param seen: which of the first O points are shown to the encoder, shape (B, O)
    :param condition: shape (B, C)
    """

    times: th.Tensor
    values: th.Tensor
    seen: th.Tensor
    condition: th.Tensor


class PointSampler:
    """Draws batches of points from trajectories, many batches with one call of the generator.

    :param settings: sizes of the batches
    :param times: of the time points, shape (T,)
    :param values: normalised trajectories, shape (N, T, D)
    :param condition: normalised contexts, shape (N, C)
    :param rng: the generator to draw from
    :param n_members: members of an ensemble that get batches of their own; 1: one batch for all
    """

    def __init__(
        self,
        settings: CNMPPretraining,
        times: th.Tensor,
        values: th.Tensor,
        condition: th.Tensor,
        rng: np.random.Generator,
        n_members: int = 1,
    ) -> None:
        self.settings, self.rng = settings, rng
        self.members = () if n_members == 1 else (n_members,)
        self.times, self.values, self.condition = times, values, condition

    def draw(self, n_batches: int) -> list[PointBatch]:
        """Draw some batches.

        :param n_batches: how many
        """
        s, n_seen = self.settings, self.settings.max_conditioning_points
        size, device = min(s.batch_size, len(self.values)), self.values.device
        each = (n_batches, *self.members)
        order = self.rng.random((*each, len(self.values))).argsort(axis=-1)[..., :size]
        rows = th.as_tensor(order, device=device)
        n_points = n_seen + s.n_target_points
        drawn = self.rng.integers(len(self.times), size=(*each, size, n_points))
        points = th.as_tensor(drawn, device=device)
        counts = self.rng.integers(-n_seen, n_seen + 1, size=(*each, size, 1))
        seen = th.as_tensor((np.arange(n_seen) < counts).astype(np.float32), device=device)
        return [
            PointBatch(
                self.times[points[i]],
                self.values[rows[i][..., None], points[i]],
                seen[i],
                self.condition[rows[i]],
            )
            for i in range(n_batches)
        ]


def cosine(highest: float, progress: float) -> float:
    """Return a learning rate that falls from the highest to a hundredth of it.

    :param highest: at the start
    :param progress: of the training, in [0, 1]
    """
    return highest * (0.505 + 0.495 * math.cos(math.pi * progress))


def encode_shown(network: ConditionalNeuralProcess, batch: PointBatch) -> th.Tensor:
    """Return each member's representation of the points that are seen, shape ([E,] B, Z).

    :param network: the conditional neural process
    :param batch: points of demonstrations
    """
    n_seen = batch.seen.shape[-1]
    shown = batch.values[..., :n_seen, :]
    return network.encode_members(batch.times[..., :n_seen], shown, batch.condition, batch.seen)


def target_likelihood(
    network: ConditionalNeuralProcess,
    batch: PointBatch,
    representation: th.Tensor,
    beta: float = 0.0,
) -> th.Tensor:
    """Return Eq. 4.1 for a representation, averaged over members and target points.

    :param network: the conditional neural process
    :param batch: points of demonstrations
    :param representation: of each member, shape ([E,] B, Z)
    :param beta: points weigh as their predicted variance to this power, which no gradient goes
        through; see `CNMPArchitecture`
    :return: the negative log-likelihood, summed over dimensions
    """
    n_seen = batch.seen.shape[-1]
    targets = batch.values[..., n_seen:, :]
    predicted = network.decode_members(batch.times[..., n_seen:], representation, batch.condition)
    likelihood = predicted.log_prob(targets)
    if beta > 0:
        likelihood = likelihood * predicted.variance.detach() ** beta
    return -likelihood.sum(dim=-1).mean()


def negative_log_likelihood(
    network: ConditionalNeuralProcess, batch: PointBatch, beta: float = 0.0
) -> th.Tensor:
    """Return Eq. 4.1, averaged over members and target points, summed over dimensions.

    :param network: the conditional neural process
    :param batch: points of demonstrations
    :param beta: see `target_likelihood`
    """
    return target_likelihood(network, batch, encode_shown(network, batch), beta)


def pretrain(
    demonstrations: Demonstrations,
    settings: CNMPPretraining,
    rng: np.random.Generator,
    cnmp: CNMP | None = None,
) -> CNMP:
    """Train a CNMP on demonstrations by maximum likelihood (Eq. 4.1), weighed by ``beta_nll``.

    :param demonstrations: of one shape, at least one
    :param settings: of the training
    :param rng: draws the batches; a new network's weights come from PyTorch's generator
    :param cnmp: the network to train; a new one by default
    :return: the trained network
    """
    cnmp = cnmp or CNMP(demonstrations.context_dim, demonstrations.trajectory_shape)
    cnmp.set_scale(demonstrations)
    modes = cnmp.find_modes(demonstrations)
    cnmp.teach_gate(demonstrations, modes)
    cnmp.fit_trend(demonstrations, modes)
    optimizer = th.optim.AdamW(
        cnmp.parameters(), settings.learning_rate, weight_decay=settings.weight_decay, fused=True
    )
    sampler = PointSampler(
        settings,
        cnmp.times,
        cnmp.normalise(cnmp.times.new_tensor(demonstrations.trajectories)),
        cnmp.condition(cnmp.times.new_tensor(demonstrations.contexts), modes),
        rng,
        cnmp.network.n_members,
    )
    batches: list[PointBatch] = []
    cnmp.train()
    for step in range(settings.n_steps):
        if step % CHUNK == 0:
            batches = sampler.draw(min(CHUNK, settings.n_steps - step))
        rate = cosine(settings.learning_rate, step / settings.n_steps)
        update_learning_rate(optimizer, rate)
        loss = negative_log_likelihood(cnmp.network, batches[step % CHUNK], cnmp.network.beta_nll)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return cnmp.train(False)
