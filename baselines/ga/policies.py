"""The genetic search's policy: the best trajectory seen in each context."""

from typing import cast

import torch as th
from gymnasium import spaces
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule

from sb3_nmp.common.elites import EliteMemory
from sb3_nmp.common.policies import TrajectoryPolicy


class ElitePolicy(TrajectoryPolicy):
    """Answers every context with the best trajectory seen in it, else with the initial one.

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    :param lr_schedule: unused; SB3 gives it to every policy
    """

    initial: th.Tensor

    def __init__(
        self, observation_space: spaces.Box, action_space: spaces.Box, lr_schedule: Schedule
    ) -> None:
        super().__init__(observation_space, action_space)
        self.elites = EliteMemory(self.context_dim, self.trajectory_shape)
        middle = (action_space.low.astype(float) + action_space.high) / 2
        self.register_buffer("initial", th.as_tensor(middle, dtype=th.float32))

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> th.Tensor:
        del deterministic  # there is no distribution to sample from
        trajectories = []
        for context in cast(th.Tensor, observation):
            index = self.elites.find(context)
            trajectories.append(self.initial if index is None else self.elites.trajectories[index])
        return th.stack(trajectories)
