"""`CNMP`: conditional neural movement primitives (thesis 4.3), trained in batches (Eq. 4.1).

Shape letters: N demonstrations, B batch, T time points, D dimensions of the trajectory, C context,
O conditioning points, P target points, Z representation.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch as th
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.utils import update_learning_rate
from torch import nn

from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError
from sb3_nmp.common.networks import ConditionalNeuralProcess


@dataclass(frozen=True)
class CNMPSettings:
    """Architecture of a CNMP.

    :param representation_dim: Z
    :param encoder_arch: hidden layers of the encoder
    :param context_arch: hidden layers from the context to the representation
    :param decoder_arch: hidden layers of the decoder
    :param context_in_decoder: give the context to the decoder too, as the thesis does
    :param linear_trend: whether the mean has a trend that is linear in the decoder's inputs
    :param n_frequencies: of the time features; 0 feeds time as it is, as the thesis does
    :param min_std: smallest standard deviation of the output, in units of the demonstrations'
        own; without it, Eq. 4.1 has no bound once the demonstrations are met exactly
    :param activation: between the layers
    """

    representation_dim: int = 16
    encoder_arch: tuple[int, ...] = (128, 128)
    context_arch: tuple[int, ...] = (64,)
    decoder_arch: tuple[int, ...] = (128, 128)
    context_in_decoder: bool = False
    linear_trend: bool = True
    n_frequencies: int = 8
    min_std: float = 0.02
    activation: type[nn.Module] = nn.ReLU


@dataclass(frozen=True)
class PretrainingSettings:
    """How a CNMP is trained on demonstrations before any rollout.

    Small batches pay: at equal time they generalise better than large ones, which meet the
    demonstrations more exactly (``results/experiments/acnmp.md``).

    :param n_steps: steps of Adam
    :param batch_size: demonstrations a step
    :param n_target_points: random time points of each at which it is predicted
    :param max_conditioning_points: the encoder sees at most so many random points, and none half
        of the time, as in `predict` without via-points
    :param learning_rate: of Adam at the start; it falls to a hundredth along a cosine
    :param weight_decay: of AdamW
    """

    n_steps: int = 3000
    batch_size: int = 8
    n_target_points: int = 5
    max_conditioning_points: int = 5
    learning_rate: float = 3e-3
    weight_decay: float = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        for name in ("n_steps", "batch_size", "n_target_points", "max_conditioning_points"):
            value = getattr(self, name)
            least = 0 if name in ("n_steps", "max_conditioning_points") else 1
            if int(value) != value or value < least:
                raise ConfigurationError(
                    f"{name} is {value}; it must be a whole number >= {least}."
                )
        if not self.learning_rate > 0 or not self.weight_decay >= 0:
            raise ConfigurationError(
                f"learning_rate is {self.learning_rate} and weight_decay {self.weight_decay}; they "
                "must be > 0 and >= 0."
            )


class CNMP(nn.Module):
    """A conditional neural process over trajectories, with its own scaling of data.

    :param context_dim: C
    :param trajectory_shape: (T, D)
    :param settings: of the architecture
    """

    times: th.Tensor
    context_mean: th.Tensor
    context_std: th.Tensor
    value_mean: th.Tensor
    value_std: th.Tensor

    def __init__(
        self,
        context_dim: int,
        trajectory_shape: tuple[int, int],
        settings: CNMPSettings | None = None,
    ) -> None:
        super().__init__()
        settings = settings or CNMPSettings()
        n_time_points, n_dimensions = trajectory_shape
        self.network = ConditionalNeuralProcess(
            n_dimensions,
            context_dim,
            settings.representation_dim,
            list(settings.encoder_arch),
            list(settings.context_arch),
            list(settings.decoder_arch),
            settings.n_frequencies,
            settings.min_std,
            settings.context_in_decoder,
            settings.linear_trend,
            settings.activation,
        )
        self.register_buffer("times", th.linspace(0.0, 1.0, n_time_points))
        self.register_buffer("context_mean", th.zeros(context_dim))
        self.register_buffer("context_std", th.ones(context_dim))
        self.register_buffer("value_mean", th.zeros(n_dimensions))
        self.register_buffer("value_std", th.ones(n_dimensions))

    def set_scale(self, demonstrations: Demonstrations) -> None:
        """Take mean and standard deviation of contexts and values from demonstrations.

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

    def representation(
        self, condition: th.Tensor, points: tuple[th.Tensor, th.Tensor] | None = None
    ) -> th.Tensor:
        """Return the representation of conditioning points, or of contexts alone, shape (B, Z).

        :param condition: shape (B, C), as `condition` returns it
        :param points: times in [0, 1], shape (O,), and values in the trajectory's unit, shape
            (O, D); None: no points
        """
        if points is None:
            return self.network.from_condition(condition)
        times, values = points
        shape = (len(condition), len(times))
        return self.network.encode(
            times.expand(shape),
            self.normalise(values).expand(*shape, -1),
            condition,
            th.ones(shape, device=condition.device),
        )

    @th.no_grad()
    def encode_whole(self, demonstrations: Demonstrations) -> th.Tensor:
        """Return the representation of whole trajectories, shape (N, Z).

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
        :param representation: shape (B, Z)
        """
        decoded = self.network.decode(self.times, representation, condition).mean
        return decoded * self.value_std + self.value_mean

    @th.no_grad()
    def trajectories(
        self, contexts: ArrayLike, points: tuple[ArrayLike, ArrayLike] | None = None
    ) -> NDArray[np.float64]:
        """Return the mean trajectory for each context, shape (N, T, D).

        :param contexts: shape (N, C)
        :param points: via-points that all trajectories should pass: times in [0, 1], shape (O,),
            and values in the trajectory's unit, shape (O, D)
        :raises InvalidDataError: points of a wrong shape, or times outside [0, 1]
        """
        checked = None if points is None else self.checked_points(points)
        condition = self.condition(self.times.new_tensor(np.asarray(contexts)))
        decoded = self.mean(condition, self.representation(condition, checked))
        return decoded.cpu().numpy().astype(np.float64)

    def checked_points(self, points: tuple[ArrayLike, ArrayLike]) -> tuple[th.Tensor, th.Tensor]:
        """Return via-points as tensors.

        :param points: times in [0, 1], shape (O,), and values, shape (O, D)
        :raises InvalidDataError: a wrong shape, a time outside [0, 1], or a non-finite value
        """
        times, values = (np.asarray(part, np.float32) for part in points)
        expected = (*times.shape, self.value_mean.shape[0])
        if times.ndim != 1 or len(times) == 0 or values.shape != expected:
            raise InvalidDataError(
                f"via-points have times of shape {times.shape} and values of shape {values.shape}; "
                f"they need (O,) and (O, D) with O >= 1 and D = {expected[-1]}."
            )
        if not (np.isfinite(values).all() and (times >= 0).all() and (times <= 1).all()):
            raise InvalidDataError(
                f"via-points at times {times.tolist()}: times must lie in [0, 1], scaled by the "
                "trajectory's duration, and values must be finite."
            )
        device = self.times.device
        return th.as_tensor(times, device=device), th.as_tensor(values, device=device)


@dataclass(frozen=True)
class PointBatch:
    """Random conditioning and target points of a batch of trajectories, in normalised values.

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
    """

    def __init__(
        self,
        settings: PretrainingSettings,
        times: th.Tensor,
        values: th.Tensor,
        condition: th.Tensor,
        rng: np.random.Generator,
    ) -> None:
        self.settings, self.rng = settings, rng
        self.times, self.values, self.condition = times, values, condition

    def draw(self, n_batches: int) -> list[PointBatch]:
        """Draw some batches.

        :param n_batches: how many
        """
        s, n_seen = self.settings, self.settings.max_conditioning_points
        size, device = min(s.batch_size, len(self.values)), self.values.device
        order = self.rng.random((n_batches, len(self.values))).argsort(axis=1)[:, :size]
        rows = th.as_tensor(order, device=device)
        n_points = n_seen + s.n_target_points
        drawn = self.rng.integers(len(self.times), size=(n_batches, size, n_points))
        points = th.as_tensor(drawn, device=device)
        counts = self.rng.integers(-n_seen, n_seen + 1, size=(n_batches, size, 1))
        seen = th.as_tensor((np.arange(n_seen) < counts).astype(np.float32), device=device)
        return [
            PointBatch(
                self.times[points[i]],
                self.values[rows[i][:, None], points[i]],
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


def negative_log_likelihood(network: ConditionalNeuralProcess, batch: PointBatch) -> th.Tensor:
    """Return Eq. 4.1, averaged over the target points and summed over dimensions; a scalar.

    :param network: the conditional neural process
    :param batch: points of demonstrations
    """
    n_seen = batch.seen.shape[1]
    representation = network.encode(
        batch.times[:, :n_seen], batch.values[:, :n_seen], batch.condition, batch.seen
    )
    predicted = network.decode(batch.times[:, n_seen:], representation, batch.condition)
    return -predicted.log_prob(batch.values[:, n_seen:]).sum(dim=-1).mean()


def pretrain(
    demonstrations: Demonstrations,
    settings: PretrainingSettings,
    rng: np.random.Generator,
    cnmp: CNMP | None = None,
) -> CNMP:
    """Train a CNMP on demonstrations by maximum likelihood (Eq. 4.1).

    :param demonstrations: of one shape, at least one
    :param settings: of the training
    :param rng: draws the batches; a new network's weights come from PyTorch's generator
    :param cnmp: the network to train; a new one by default
    :return: the trained network
    """
    cnmp = cnmp or CNMP(demonstrations.context_dim, demonstrations.trajectory_shape)
    cnmp.set_scale(demonstrations)
    optimizer = th.optim.AdamW(
        cnmp.parameters(), settings.learning_rate, weight_decay=settings.weight_decay, fused=True
    )
    sampler = PointSampler(
        settings,
        cnmp.times,
        cnmp.normalise(cnmp.times.new_tensor(demonstrations.trajectories)),
        cnmp.condition(cnmp.times.new_tensor(demonstrations.contexts)),
        rng,
    )
    batches: list[PointBatch] = []
    cnmp.train()
    for step in range(settings.n_steps):
        if step % CHUNK == 0:
            batches = sampler.draw(min(CHUNK, settings.n_steps - step))
        rate = cosine(settings.learning_rate, step / settings.n_steps)
        update_learning_rate(optimizer, rate)
        loss = negative_log_likelihood(cnmp.network, batches[step % CHUNK])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return cnmp.train(False)


#: batches drawn at once
CHUNK = 100
