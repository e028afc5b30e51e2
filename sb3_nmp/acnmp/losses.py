"""The policy gradient of ACNMP (thesis Eq. 5.2) and its advantages."""

import numpy as np
import torch as th
from numpy.typing import NDArray

from sb3_nmp.acnmp.settings import Advantage
from sb3_nmp.common.buffer import selection_weights
from sb3_nmp.common.rollouts import Generation

FloatArray = NDArray[np.float64]


def advantages(kind: Advantage, rollouts: Generation, temperature: float = 1.5) -> FloatArray:
    """Return by how much each rollout is better than the others at each time, shape (N, T).

    ``"to_go"`` and ``"step"`` are centred over the rollouts and scaled to a standard deviation of
    1; where the rewards do not come step by step, both are the whole reward's. ``"place"`` is
    positive and adds up to 1 over the rollouts: no trajectory is pushed away from.

    :param kind: ``"to_go"``, ``"step"`` or ``"place"``
    :param rollouts: of one context
    :param temperature: of ``"place"``, in places
    """
    n_time_points = rollouts.trajectories.shape[1]
    if kind == "place":
        weights = selection_weights(rollouts.rewards, temperature)
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
