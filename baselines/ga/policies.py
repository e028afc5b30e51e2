"""The genetic search's policy: the best trajectory seen in each context."""

from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule

from baselines.ga.skill import RegressionSkill
from sb3_nmp.common.policies import ElitePolicy
from sb3_nmp.common.regression import Regression


class GAPolicy(ElitePolicy):
    """Answers every context with the best trajectory seen in it, else with the initial one.

    >>> import numpy as np
    >>> from gymnasium.spaces import Box
    >>> policy = GAPolicy(Box(-1.0, 1.0, (1,)), Box(0.0, 4.0, (3, 1)), lambda progress: 0.0)
    >>> policy.predict(np.zeros(1, np.float32))[0].tolist()  # the middle of the space
    [[2.0], [2.0], [2.0]]

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    :param lr_schedule: unused; SB3 gives it to every policy
    :param regression: by which contexts are answered where these vary: ``"nearest"``, ``"ridge"``,
        ``"quadratic"`` or ``"gaussian-process"``
    :param n_bases: smooth bases of a trajectory, per dimension, where contexts vary
    """

    initial: th.Tensor

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        lr_schedule: Schedule,
        regression: Regression = "nearest",
        n_bases: int = 8,
    ) -> None:
        super().__init__(observation_space, action_space)
        self.settings: dict[str, Any] = {"regression": regression, "n_bases": n_bases}
        self.skill = RegressionSkill(self.context_dim, self.trajectory_shape, regression, n_bases)
        middle = (action_space.low.astype(float) + action_space.high) / 2
        self.register_buffer("initial", th.as_tensor(middle, dtype=th.float32))

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return super()._get_constructor_parameters() | self.settings

    def _may_answer(self, elite: int) -> bool:
        """Return False for a trajectory that failed, where a skill has been learned."""
        return bool(self.elites.solved[elite]) or not self.skill.is_ready

    def _learned(self, contexts: th.Tensor) -> th.Tensor | None:
        """Return the skill's answers; in a pinned context there is none."""
        return self.generalise(contexts) if self.skill.is_ready else None

    def generalise(self, contexts: th.Tensor, deterministic: bool = True) -> th.Tensor:
        """Return the skill's answers, or the initial trajectory for each context, (N, T, D).

        :param contexts: shape (N, C)
        :param deterministic: ignored: there is no distribution
        """
        del deterministic
        if self.skill.is_ready:
            rows = contexts.cpu().numpy()
            answered = self.skill.space.trajectories(rows, self.skill.answer(rows))
            return th.as_tensor(answered, dtype=th.float32, device=contexts.device)
        return self.initial.repeat(len(contexts), 1, 1)

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> th.Tensor:
        del deterministic  # there is no distribution to sample from
        return super()._predict(observation, deterministic=True)
