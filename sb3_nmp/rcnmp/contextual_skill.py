"""`ContextualSkill`: RC-NMP's answer to contexts, by reward or by what was achieved."""

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch import nn

from sb3_nmp.common.contextual import Experience
from sb3_nmp.models.skill_space import SkillSpace
from sb3_nmp.rcnmp.achievement import AchievementConditionedSkill, RCNMPAchievement
from sb3_nmp.rcnmp.skill import RCNMPSkill, RewardConditionedSkill


class ContextualSkill(nn.Module):
    """Conditioned on what was achieved where rollouts tell it, else on reward.

    :param context_dim: C
    :param trajectory_shape: (T, D)
    :param skill: settings of the skill conditioned on reward
    :param achievement: of that conditioned on what was achieved
    """

    ready: th.Tensor
    by_achievement: th.Tensor

    def __init__(
        self,
        context_dim: int,
        trajectory_shape: tuple[int, int],
        skill: RCNMPSkill,
        achievement: RCNMPAchievement,
    ) -> None:
        super().__init__()
        self.space = SkillSpace(context_dim, trajectory_shape, skill.n_bases)
        self.by_reward = RewardConditionedSkill(self.space, context_dim, skill)
        self.by_outcome = AchievementConditionedSkill(self.space, context_dim, achievement)
        self.register_buffer("ready", th.zeros((), dtype=th.bool))
        self.register_buffer("by_achievement", th.zeros((), dtype=th.bool))
        self.requires_grad_(False)

    @property
    def is_ready(self) -> bool:
        """Whether it has learned anything."""
        return bool(self.ready)

    def learn(self, experience: Experience, generator: th.Generator) -> None:
        """Learn from all rollouts so far.

        :param experience: of which something was right
        :param generator: of weights and batches
        """
        self.by_achievement.fill_(experience.achieved is not None)
        chosen = self.by_outcome if self.by_achievement else self.by_reward
        with th.enable_grad():
            chosen.learn(self.space, experience, generator)
        self.ready.fill_(True)

    @th.no_grad()
    def answer(self, contexts: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the weights that answer contexts, shape (N, P).

        :param contexts: shape (N, C)
        """
        rows = th.as_tensor(np.asarray(contexts), dtype=th.float32, device=self.ready.device)
        chosen = self.by_outcome if self.by_achievement else self.by_reward
        return chosen.answer(self.space, rows).cpu().numpy().astype(np.float64)
