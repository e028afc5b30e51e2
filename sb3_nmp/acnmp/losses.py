"""The policy gradient of ACNMP (thesis Eq. 5.2) and its advantages.

Shape letters: n contexts, C context, N rollouts, T time points, D dimensions of the trajectory.
"""

import numpy as np
import torch as th
from numpy.typing import NDArray

from sb3_nmp.acnmp.settings import ACNMPAdaptation, Advantage
from sb3_nmp.common.buffer import selection_weights
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.models.cnmp import CNMP

FloatArray = NDArray[np.float64]

#: trajectories are smooth: where all time points weigh alike, Eq. 5.2 is averaged at about so many
N_MOMENTS = 50


def advantages(kind: Advantage, rollouts: Generation, temperature: float = 1.5) -> FloatArray:
    """Return by how much each rollout is better than the others at each time, shape (N, T).

    ``"to_go"`` and ``"step"`` are centred over the rollouts and scaled to a standard deviation of
    1; where the rewards do not come step by step, both are the whole reward's. ``"place"`` is
    never negative and adds up to 1 over the rollouts: no trajectory is pushed away from. Once any
    rollout has succeeded, those that failed have no weight: a failure can have the larger reward.

    :param kind: ``"to_go"``, ``"step"`` or ``"place"``
    :param rollouts: of one context
    :param temperature: of ``"place"``, in places
    """
    n, n_time_points, _ = rollouts.trajectories.shape
    if kind == "place":
        taught = rollouts.successes if rollouts.successes.any() else np.ones(n, bool)
        weights = np.zeros(n)
        weights[taught] = selection_weights(rollouts.rewards[taught], temperature)
        return np.repeat(weights[:, None], n_time_points, axis=1)
    steps = rollouts.step_rewards
    if steps is None:
        values = np.repeat(rollouts.rewards[:, None], n_time_points, axis=1)
    else:
        values = steps if kind == "step" else np.cumsum(steps[:, ::-1], axis=1)[:, ::-1]
    centred = values - values.mean(axis=0)
    return centred / max(float(centred.std()), 1e-12)


def policy_gradient_loss(mean: th.Tensor, trajectories: th.Tensor, weights: th.Tensor) -> th.Tensor:
    """Return minus Eq. 5.2's objective for a Gaussian policy of fixed variance, a scalar.

    Its gradient is the policy gradient: ``-log pi(a_t | c)`` is half the squared error to the
    policy's mean, weighted by the advantage.

    :param mean: of the policy, in normalised values, shape (T, D)
    :param trajectories: that were tried, in normalised values, shape (N, T, D)
    :param weights: advantages, shape (N, T)
    """
    squares = ((trajectories - mean) ** 2).sum(dim=-1)
    return 0.5 * (weights * squares).mean(dim=1).sum()


class PolicyGradient:
    """The policy gradient's loss over the contexts that are searched.

    :param cnmp: the policy; its means change from loss to loss
    :param settings: of advantages and weights
    :param contexts: that are searched, shape (n, C)
    :param rollouts: made in each of them
    """

    def __init__(
        self,
        cnmp: CNMP,
        settings: ACNMPAdaptation,
        contexts: NDArray[np.floating],
        rollouts: list[Generation],
    ) -> None:
        by_place = settings.advantage == "place"
        moments = slice(None, None, max(1, len(cnmp.times) // N_MOMENTS) if by_place else 1)
        self.cnmp, self.times = cnmp, cnmp.times[moments]
        self.contexts = cnmp.times.new_tensor(contexts)
        self.tried: list[tuple[th.Tensor, th.Tensor]] = []
        for each in rollouts:
            values = cnmp.normalise(cnmp.times.new_tensor(each.trajectories))
            advantage = advantages(settings.advantage, each, settings.temperature)
            weights = cnmp.times.new_tensor(settings.reward_weight * advantage)
            self.tried.append((values[:, moments], weights[:, moments]))

    def loss(self) -> th.Tensor:
        """Return Eq. 5.2's loss for the policy as it is now, the mean over contexts."""
        cnmp, condition = self.cnmp, self.cnmp.condition(self.contexts)
        means = cnmp.network.decode(self.times, cnmp.representation(condition), condition).mean
        loss = means.new_zeros(())
        for mean, (trajectories, weights) in zip(means, self.tried, strict=True):
            loss = loss + policy_gradient_loss(mean, trajectories, weights)
        return loss / len(self.tried)
