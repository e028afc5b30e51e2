"""How two CNMPs learn one latent space from proxy skills (Eq. 5.4).

Shape letters: N proxy skills, B batch, T time points, D dimensions, O conditioning points, P target
points, E members.
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch as th
from stable_baselines3.common.utils import update_learning_rate

from sb3_nmp.common.resampling import resample
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.cnmp_training import CHUNK, PointBatch, cosine, encode_shown, target_likelihood
from sb3_nmp.transfer.settings import TransferTraining

#: a batch of the same skills, as each robot does them
Pair = tuple[PointBatch, PointBatch]


class PairSampler:
    """Draws batches of proxy skills, and of each robot's trajectory points of its own.

    :param settings: sizes of the batches
    :param robots: each robot's network, with its normalised trajectories of shape (N, T, D)
    :param rng: the generator to draw from
    """

    def __init__(
        self,
        settings: TransferTraining,
        robots: Sequence[tuple[CNMP, th.Tensor]],
        rng: np.random.Generator,
    ) -> None:
        self.settings, self.robots, self.rng = settings, robots, rng
        self.members = _members(robots)

    def draw(self, n_batches: int) -> list[Pair]:
        """Draw some batches.

        :param n_batches: how many
        """
        rows = self._rows(n_batches)
        first, second = (self._points(cnmp, values, rows) for cnmp, values in self.robots)
        return list(zip(first, second, strict=True))

    def _rows(self, n_batches: int) -> th.Tensor:
        """Return which skills each batch has, and each member's, shape (n, [E,] B)."""
        n_skills = len(self.robots[0][1])
        size = min(self.settings.batch_size, n_skills)
        drawn = self.rng.random((n_batches, *self.members, n_skills))
        return th.as_tensor(drawn.argsort(axis=-1)[..., :size])

    def _points(self, cnmp: CNMP, values: th.Tensor, rows: th.Tensor) -> list[PointBatch]:
        """Draw random points of one robot's trajectories."""
        s, shape = self.settings, (*rows.shape,)
        low, high = s.conditioning_points
        drawn = self.rng.integers(len(cnmp.times), size=(*shape, high + s.n_target_points))
        counts = self.rng.integers(low, high + 1, size=(*shape, 1))
        seen = th.as_tensor((np.arange(high) < counts).astype(np.float32))
        points = th.as_tensor(drawn)
        nothing = values.new_zeros((*shape[1:], 1))
        return [
            PointBatch(
                cnmp.times[points[i]], values[rows[i][..., None], points[i]], seen[i], nothing
            )
            for i in range(len(rows))
        ]


class MomentSampler:
    """Draws moments of proxy skills: a point of each robot's trajectory, at the same time.

    A point is shown to its robot's encoder and predicted by its decoder, so that a representation
    is of one moment. Trajectories of different numbers of time points are interpolated linearly.

    :param settings: a batch has ``batch_size * n_target_points`` moments
    :param robots: each robot's network, with its normalised trajectories of shape (N, T, D)
    :param rng: the generator to draw from
    """

    def __init__(
        self,
        settings: TransferTraining,
        robots: Sequence[tuple[CNMP, th.Tensor]],
        rng: np.random.Generator,
    ) -> None:
        self.size, self.rng = settings.batch_size * settings.n_target_points, rng
        self.members = _members(robots)
        n_moments = max(values.shape[1] for _, values in robots)
        self.values = [
            values.new_tensor(resample(list(values.cpu().numpy()), n_moments))
            for _, values in robots
        ]
        self.times = th.linspace(0.0, 1.0, n_moments)

    def draw(self, n_batches: int) -> list[Pair]:
        """Draw some batches.

        :param n_batches: how many
        """
        shape = (n_batches, *self.members, self.size)
        rows = th.as_tensor(self.rng.integers(len(self.values[0]), size=shape))
        moments = th.as_tensor(self.rng.integers(len(self.times), size=shape))
        seen = self.times.new_ones((*shape[1:], 1))
        twice = self.times[moments][..., None].expand(*shape, 2)  # shown, and predicted
        first, second = (
            [
                PointBatch(times, points[..., None, :].expand(*shape[1:], 2, -1), seen, 0 * seen)
                for times, points in zip(twice, values[rows, moments], strict=True)
            ]
            for values in self.values
        )
        return list(zip(first, second, strict=True))


def _members(robots: Sequence[tuple[CNMP, th.Tensor]]) -> tuple[int, ...]:
    """Return the axis of batches that each member of an ensemble has for itself: (E,), or none."""
    n_members = robots[0][0].network.n_members
    return () if n_members == 1 else (n_members,)


def shared_latent_loss(networks: tuple[CNMP, CNMP], pair: Pair, latent_weight: float) -> th.Tensor:
    """Return Eq. 5.4: both robots' Eq. 4.1, and how far their representations lie apart.

    The distance is the mean squared error, averaged over skills and entries of the latent.

    :param networks: of the two robots
    :param pair: the same skills of both
    :param latent_weight: of the distance
    """
    codes = [encode_shown(cnmp.network, batch) for cnmp, batch in zip(networks, pair, strict=True)]
    losses = [
        target_likelihood(cnmp.network, batch, code)
        for cnmp, batch, code in zip(networks, pair, codes, strict=True)
    ]
    distance = th.nn.functional.mse_loss(codes[0], codes[1])
    return losses[0] + losses[1] + latent_weight * distance


def train_pair(
    networks: tuple[CNMP, CNMP],
    sampler: PairSampler | MomentSampler,
    settings: TransferTraining,
    watch: Callable[[int], None] | None = None,
) -> None:
    """Train both networks by Eq. 5.4.

    :param networks: of the two robots, scaled to their demonstrations
    :param sampler: of the batches
    :param settings: of the training
    :param watch: is told the number of steps that are done, from 0 on
    """
    parameters = [p for cnmp in networks for p in cnmp.parameters()]
    rate, decay = settings.learning_rate, settings.weight_decay
    optimizer = th.optim.AdamW(parameters, rate, weight_decay=decay, fused=True)
    batches: list[Pair] = []
    for step in range(settings.n_steps):
        if watch is not None:
            watch(step)
        if step % CHUNK == 0:
            batches = sampler.draw(min(CHUNK, settings.n_steps - step))
        update_learning_rate(optimizer, cosine(rate, step / settings.n_steps))
        loss = shared_latent_loss(networks, batches[step % CHUNK], settings.latent_weight)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    if watch is not None:
        watch(settings.n_steps)
