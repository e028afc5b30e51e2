"""`ContextualSkill`: RC-NMP's answer to contexts, by reward or by what was achieved."""

from typing import Any, cast

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch import nn

from sb3_nmp.common.contextual import Experience
from sb3_nmp.models.skill_space import SkillSpace
from sb3_nmp.rcnmp.achievement import AchievementConditionedSkill
from sb3_nmp.rcnmp.settings import RCNMPAchievement, RCNMPSkill
from sb3_nmp.rcnmp.skill import RewardConditionedSkill

Conditioned = RewardConditionedSkill | AchievementConditionedSkill


class ContextualSkill(nn.Module):
    """Conditioned on what was achieved where rollouts tell it, else on reward.

    Its networks are made when it learns first: a model of one context has none.

    :param context_dim: C
    :param trajectory_shape: (T, D)
    :param skill: settings of the skill conditioned on reward
    :param achievement: of that conditioned on what was achieved
    """

    by_achievement: th.Tensor

    def __init__(
        self,
        context_dim: int,
        trajectory_shape: tuple[int, int],
        skill: RCNMPSkill,
        achievement: RCNMPAchievement,
    ) -> None:
        super().__init__()
        self.context_dim, self.settings = context_dim, (skill, achievement)
        self.space = SkillSpace(context_dim, trajectory_shape, skill.n_bases)
        self.register_buffer("by_achievement", th.zeros((), dtype=th.bool))
        self.conditioned: nn.Module | None = None

    @property
    def is_ready(self) -> bool:
        """Whether it has learned anything."""
        return self.conditioned is not None

    def _make(self, by_achievement: bool) -> Conditioned:
        """Make the networks of one kind."""
        self.by_achievement.fill_(by_achievement)
        skill, achievement = self.settings
        made = (
            AchievementConditionedSkill(self.space, self.context_dim, achievement)
            if by_achievement
            else RewardConditionedSkill(self.space, self.context_dim, skill)
        )
        self.conditioned = made.requires_grad_(False)
        return made

    def learn(self, experience: Experience, generator: th.Generator) -> None:
        """Learn from all rollouts so far.

        :param experience: of which something was right
        :param generator: of weights and batches
        """
        wanted = experience.achieved is not None
        known = cast(Conditioned | None, self.conditioned)
        if known is None or bool(self.by_achievement) != wanted:
            known = self._make(wanted)
        with th.enable_grad():
            known.learn(self.space, experience, generator)

    @th.no_grad()
    def answer(self, contexts: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the weights that answer contexts, shape (N, P).

        :param contexts: shape (N, C)
        """
        device = self.by_achievement.device
        rows = th.as_tensor(np.asarray(contexts), dtype=th.float32, device=device)
        known = cast(Conditioned, self.conditioned)
        return known.answer(self.space, rows).cpu().numpy().astype(np.float64)

    def explore(
        self, contexts: NDArray[np.floating], members: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """Return the weights around which members of a generation explore, shape (n, P).

        They take the modes in turn, so that none is forgotten for having promised less once.

        :param contexts: shape (n, C)
        :param members: which ones, shape (n,)
        """
        answers, _ = self.modes(contexts)
        return answers[np.arange(len(answers)), members % answers.shape[1]]

    @th.no_grad()
    def modes(
        self, contexts: NDArray[np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the answers of all modes (N, K, P), and what each promises (N, K).

        What was achieved tells no modes apart: K is 1 there, and the promise 0.

        :param contexts: shape (N, C)
        """
        known = self.conditioned
        if not isinstance(known, RewardConditionedSkill):
            return self.answer(contexts)[:, None], np.zeros((len(contexts), 1))
        rows = th.as_tensor(
            np.asarray(contexts), dtype=th.float32, device=self.by_achievement.device
        )
        answers, promises = (each.cpu().numpy() for each in known.modes(self.space, rows))
        return answers.astype(np.float64), promises.astype(np.float64)

    def _load_from_state_dict(  # pyright: ignore[reportIncompatibleMethodOverride]
        self,
        state_dict: dict[str, Any],
        prefix: str,
        *args: Any,  # noqa: ANN401
    ) -> None:
        """Make the networks that were saved, before PyTorch fills them."""
        if any(key.startswith(f"{prefix}conditioned.") for key in state_dict):
            self._make(bool(state_dict[f"{prefix}by_achievement"]))
        super()._load_from_state_dict(state_dict, prefix, *args)
