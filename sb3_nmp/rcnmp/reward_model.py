"""RC-NMP's reward model in one context: which candidates are likely to earn the wanted reward.

The neural process proposes trajectories for a reward; an ensemble that has seen all rollouts,
failures too, judges them by Bayes' rule as in `sb3_nmp.rcnmp.skill`::

    p(w | r*) ~ p(w) p(r* | w)

Shape letters: E members, N candidates, F features of a trajectory.
"""

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch import nn

from sb3_nmp.common.buffer import selection_weights
from sb3_nmp.common.judging import Wanted, features
from sb3_nmp.common.niches import View
from sb3_nmp.models.ensemble import Ensemble
from sb3_nmp.rcnmp.settings import RCNMPRewardModel

FloatArray = NDArray[np.float64]


def judge(
    stored: NDArray[np.floating],
    view: View,
    candidates: FloatArray,
    settings: RCNMPRewardModel,
    generator: th.Generator,
) -> FloatArray:
    """Return log p(r* | w) of candidates up to a constant, in each member's opinion, shape (E, N).

    As long as too few rollouts have succeeded, it is the place of the reward instead.

    :param stored: all rollouts so far, shape (M, T, D)
    :param view: what they are worth
    :param candidates: w, shape (N, T, D)
    :param settings: of the ensemble
    :param generator: of weights and batches
    """
    known, asked = (th.as_tensor(rows, dtype=th.float32) for rows in features(stored, candidates))
    wanted = Wanted.of(view.rewards, view.successes)
    columns = [wanted.success, wanted.score] if wanted.is_split else [wanted.score]
    targets = th.as_tensor(np.stack(columns, axis=1), dtype=th.float32)
    sizes = [known.shape[1], *settings.arch, len(columns)]
    ensemble = Ensemble(sizes, settings.n_members, generator)
    shares = 0.5 * selection_weights(view.rewards, settings.temperature) + 0.5 / len(stored)
    loss = success_and_score if wanted.is_split else nn.functional.mse_loss
    with th.enable_grad():
        ensemble.fit(known, targets, settings.n_steps, settings.training, generator, loss, shares)
    with th.no_grad():
        told = ensemble(asked)
    if wanted.is_split:
        told = nn.functional.logsigmoid(told[..., 0]) + told[..., 1]
    else:
        told = told[..., 0]
    return told.numpy().astype(np.float64)


def success_and_score(predicted: th.Tensor, wanted: th.Tensor) -> th.Tensor:
    """Return the loss of a success's logit and, where it is a success, of its score.

    :param predicted: logit and score, shape (..., 2)
    :param wanted: success (0 or 1) and score, shape (..., 2)
    """
    success = wanted[..., 0]
    surprise = nn.functional.binary_cross_entropy_with_logits(predicted[..., 0], success)
    return surprise + (success * (predicted[..., 1] - wanted[..., 1]) ** 2).mean()
