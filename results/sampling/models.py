"""The two networks of thesis 6.2.1, trained on demonstrations without reward.

Shape letters: N samples, M demonstrations, T time points.
"""

from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch import nn
from torch.distributions import Normal

from results.sampling.curves import FloatArray
from sb3_nmp import CNMPArchitecture, Demonstrations, RCNMPTraining
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.cnmp_training import CNMPPretraining, cosine, pretrain
from sb3_nmp.models.neural_process import NeuralProcess
from sb3_nmp.rcnmp.training import batches, elbo

START = (0.0, 0.0)  # time and value of the one conditioning point
JUDGED = 100  # steps whose mean loss tells starts apart


@dataclass(frozen=True)
class SamplingTraining:
    """How RC-NMP's network is trained on demonstrations; chosen on seeds from 1000 on.

    The weight of z's divergence falls from ``first_beta`` to ``beta`` on a logarithmic scale, for
    categories only: while z is dear, k has to tell the modes apart. Which modes it joins is settled
    then, as in k-means, and does not mend later; so several networks begin, and the one of the
    least loss goes on.

    :param n_steps: steps of Adam, of the network that goes on
    :param batch_size: demonstrations per step, drawn with replacement
    :param n_target_points: random time points of each at which it is predicted
    :param learning_rate: at the start; it falls to a hundredth along a cosine
    :param beta: weight of z's divergence in the end
    :param first_beta: at the start, with several categories
    :param n_starts: networks that begin, with several categories
    :param start_steps: after how many of the steps they are compared
    """

    n_steps: int = 2000
    batch_size: int = 32
    n_target_points: int = 10
    learning_rate: float = 5e-3
    beta: float = 0.3
    first_beta: float = 100.0
    n_starts: int = 5
    start_steps: int = 400


class Sampler:
    """RC-NMP's network after training, in the demonstrations' unit.

    :param network: trained
    :param times: in [0, 1], shape (T,)
    :param scale: of the network's values
    """

    def __init__(self, network: NeuralProcess, times: th.Tensor, scale: float) -> None:
        self.network, self.times, self.scale = network, times, scale

    @th.no_grad()
    def draw(self, n: int, rng: np.random.Generator) -> tuple[FloatArray, NDArray[np.int_]]:
        """Draw k from its prior and z from N(0, I); return trajectories (N, T, 1) and k (N,).

        :param n: N
        :param rng: the generator to draw from
        """
        condition = th.zeros(n, 1)
        shares = self.network.category_prior(condition[:1]).probs[0].double().numpy()
        category = rng.choice(len(shares), n, p=shares / shares.sum())
        latent = th.as_tensor(rng.standard_normal((n, self.network.latent_dim)), dtype=th.float32)
        code = self.network.code(latent, th.as_tensor(category))
        drawn = self.network.decode(self.times, code, condition).mean
        return self.scale * drawn.numpy().astype(np.float64), category


class Start:
    """A network in training; those of equal seeds see the same batches.

    :param values: trajectories in the network's unit, shape (M, T, 1)
    :param times: in [0, 1], shape (T,)
    :param n_categories: K
    :param seed: of the batches
    :param training: how
    """

    def __init__(
        self, values: th.Tensor, times: th.Tensor, n_categories: int, seed: int,
        training: SamplingTraining,
    ) -> None:  # fmt: skip
        self.training, self.n_done = training, 0
        self.network = NeuralProcess(1, 1, 4, [64, 64], [64, 64], 4, 0.1, nn.Tanh, n_categories)
        self.optimizer = th.optim.Adam(
            self.network.parameters(), training.learning_rate, fused=True
        )
        self.batches = batches(
            RCNMPTraining(training.n_steps, training.batch_size, training.n_target_points, 20),
            times,
            values,
            th.zeros(len(values), 1),
            np.full(len(values), 1 / len(values)),
            self.network.latent_dim,
            np.random.default_rng(seed),
        )

    def train(self, until: int) -> list[float]:
        """Train on, and return the loss of each step.

        :param until: steps since the beginning, not fewer than were done
        """
        training, losses = self.training, list[float]()
        raised = training.first_beta / training.beta if self.network.n_categories > 1 else 1.0
        for batch in islice(self.batches, until - self.n_done):
            progress = self.n_done / training.n_steps
            self.optimizer.param_groups[0]["lr"] = cosine(training.learning_rate, progress)
            beta = training.beta * max(1.0, raised ** (1 - 2 * progress))
            self.optimizer.zero_grad()
            loss = elbo(self.network, batch, beta).loss
            loss.backward()
            self.optimizer.step()
            losses.append(loss.item())
            self.n_done += 1
        return losses


def train_sampler(
    demonstrations: FloatArray, n_categories: int, seed: int, training: SamplingTraining
) -> Sampler:
    """Train RC-NMP's network on demonstrations, all of reward 0.

    :param demonstrations: shape (M, T, 1)
    :param n_categories: K
    :param seed: of the weights and the batches
    :param training: how
    """
    th.manual_seed(seed)
    scale = float(np.sqrt(np.mean(demonstrations**2)))
    times = th.linspace(0.0, 1.0, demonstrations.shape[1])
    values = th.as_tensor(demonstrations / scale, dtype=th.float32)
    n_starts = training.n_starts if n_categories > 1 else 1
    starts = [Start(values, times, n_categories, seed, training) for _ in range(n_starts)]
    losses = [np.mean(start.train(training.start_steps)[-JUDGED:]) for start in starts]
    best = starts[int(np.argmin(losses))]
    best.train(training.n_steps)
    return Sampler(best.network, times, scale)


def train_cnmp(demonstrations: FloatArray, seed: int, n_steps: int) -> Normal:
    """Train a CNMP and return its Gaussian at every time, given `START`; batch shape (T, 1).

    :param demonstrations: shape (M, T, 1)
    :param seed: of the weights and the batches
    :param n_steps: of its training
    """
    th.manual_seed(seed)
    shown = Demonstrations(np.zeros((len(demonstrations), 1)), demonstrations)
    settings = CNMPPretraining(n_steps=n_steps)
    architecture = replace(CNMPArchitecture.preset("latent"), n_members=1)
    one = CNMP(shown.context_dim, shown.trajectory_shape, architecture)
    cnmp = pretrain(shown, settings, np.random.default_rng(seed), one)
    condition = cnmp.condition(th.zeros(1, 1))
    time, value = START
    with th.no_grad():
        seen = cnmp.representation(condition, cnmp.through(([time], [[value]])).points)
        told = cnmp.network.decode(cnmp.times, seen, condition)
    scale, middle = cnmp.value_std, cnmp.value_mean
    return Normal(told.mean[0] * scale + middle, told.stddev[0] * scale)
