"""The base of all policies that answer a context with a whole trajectory."""

from typing import Any, cast

import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import PyTorchObs


class TrajectoryPolicy(BasePolicy):
    """SB3 policy whose observation is a context (C,) and whose action is a trajectory (T, D)."""

    @property
    def trajectory_shape(self) -> tuple[int, int]:
        """Return (T, D)."""
        n_time_points, n_dimensions = cast(spaces.Box, self.action_space).shape
        return n_time_points, n_dimensions

    @property
    def context_dim(self) -> int:
        """Return C."""
        return cast(spaces.Box, self.observation_space).shape[0]

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {
            "observation_space": self.observation_space,
            "action_space": self.action_space,
            "lr_schedule": self._dummy_schedule,  # a loaded policy is not trained further
        }

    def forward(self, observation: PyTorchObs, deterministic: bool = False) -> th.Tensor:
        """Return a trajectory for each context, shape (N, T, D).

        :param observation: contexts, shape (N, C)
        :param deterministic: the greedy trajectory instead of a sample
        """
        return self._predict(observation, deterministic)
