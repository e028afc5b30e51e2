"""The two networks of thesis 6.2.1, trained on demonstrations without reward.

Shape letters: N samples, M demonstrations, T time points.
"""

from dataclasses import dataclass

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch import nn
from torch.distributions import Normal

from results.sampling.curves import FloatArray
from sb3_nmp import Demonstrations, RCNMPTraining
from sb3_nmp.models.cnmp_training import CNMPPretraining, cosine, pretrain
from sb3_nmp.models.neural_process import NeuralProcess
from sb3_nmp.rcnmp.training import batches, elbo

START = (0.0, 0.0)  # time and value of the one conditioning point


@dataclass(frozen=True)
class SamplingTraining:
    """How RC-NMP's network is trained on demonstrations; chosen on seeds from 1000 on.

    The weight of z's divergence falls from ``first_beta`` to ``beta`` on a logarithmic scale, for
    categories only: while z is dear, k has to tell the modes apart.

    :param n_steps: steps of Adam
    :param batch_size: demonstrations per step, drawn with replacement
    :param n_target_points: random time points of each at which it is predicted
    :param learning_rate: at the start; it falls to a hundredth along a cosine
    :param beta: weight of z's divergence in the end
    :param first_beta: at the start, with several categories
    """

    n_steps: int = 2000
    batch_size: int = 32
    n_target_points: int = 10
    learning_rate: float = 5e-3
    beta: float = 0.3
    first_beta: float = 100.0


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
    network = NeuralProcess(1, 1, 4, [64, 64], [64, 64], 4, 0.1, nn.Tanh, n_categories)
    optimizer = th.optim.Adam(network.parameters(), training.learning_rate, fused=True)
    scale = float(np.sqrt(np.mean(demonstrations**2)))
    times = th.linspace(0.0, 1.0, demonstrations.shape[1])
    drawn = batches(
        RCNMPTraining(training.n_steps, training.batch_size, training.n_target_points, 20),
        times,
        th.as_tensor(demonstrations / scale, dtype=th.float32),
        th.zeros(len(demonstrations), 1),
        np.full(len(demonstrations), 1 / len(demonstrations)),
        network.latent_dim,
        np.random.default_rng(seed),
    )
    raised = training.first_beta / training.beta if n_categories > 1 else 1.0
    for step, batch in enumerate(drawn):
        progress = step / training.n_steps
        optimizer.param_groups[0]["lr"] = cosine(training.learning_rate, progress)
        beta = training.beta * max(1.0, raised ** (1 - 2 * progress))
        optimizer.zero_grad()
        elbo(network, batch, beta).loss.backward()
        optimizer.step()
    return Sampler(network, times, scale)


def train_cnmp(demonstrations: FloatArray, seed: int, n_steps: int) -> Normal:
    """Train a CNMP and return its Gaussian at every time, given `START`; batch shape (T, 1).

    :param demonstrations: shape (M, T, 1)
    :param seed: of the weights and the batches
    :param n_steps: of its training
    """
    th.manual_seed(seed)
    shown = Demonstrations(np.zeros((len(demonstrations), 1)), demonstrations)
    settings = CNMPPretraining(n_steps=n_steps)
    cnmp = pretrain(shown, settings, np.random.default_rng(seed))
    condition = cnmp.condition(th.zeros(1, 1))
    time, value = START
    with th.no_grad():
        seen = cnmp.representation(condition, cnmp.checked_points(([time], [[value]])))
        told = cnmp.network.decode(cnmp.times, seen, condition)
    scale, middle = cnmp.value_std, cnmp.value_mean
    return Normal(told.mean[0] * scale + middle, told.stddev[0] * scale)
