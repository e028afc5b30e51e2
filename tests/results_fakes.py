"""Cheap algorithms with which the harness is tested."""

from typing import Any, ClassVar, cast

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule

from sb3_nmp.common.algorithm import Generation, TrajectoryAlgorithm
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.policies import TrajectoryPolicy


class BestPolicy(TrajectoryPolicy):
    """Answers with the best trajectory seen."""

    best: th.Tensor

    def __init__(
        self, observation_space: spaces.Box, action_space: spaces.Box, lr_schedule: Schedule
    ) -> None:
        super().__init__(observation_space, action_space)
        self.register_buffer("best", th.zeros(self.trajectory_shape))

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> th.Tensor:
        return self.best.expand(len(cast(th.Tensor, observation)), -1, -1)


class HillClimber(TrajectoryAlgorithm):
    """Adds smooth noise to the best trajectory seen, its ends excepted."""

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": BestPolicy}

    def __init__(
        self,
        policy: str,
        env: Any,
        seed: int | None = None,
        population_size: int = 5,
        sigma: float = 0.12,
        noise: SmoothNoise | None = None,
    ) -> None:
        self.noise = noise or SmoothNoise(sigma)
        self.best_reward = -np.inf
        super().__init__(
            policy, env, population_size, 0.0, None, 100, None, 0, seed, "cpu", True
        )  # fmt: skip

    @property
    def best_policy(self) -> BestPolicy:
        return cast(BestPolicy, self.policy)

    def _begin_generation(self) -> None:
        if not np.isfinite(self.best_reward):
            self.best_policy.best = th.as_tensor(self.initial_trajectory(), dtype=th.float32)
        shape, decay = self.best_policy.trajectory_shape, 0.97**self._n_updates
        noise = decay * self.noise.sample(self.rng, self.population_size, shape)
        self.deviations = noise * np.sin(np.linspace(0.0, np.pi, shape[0]))[:, None]

    def _propose(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        return self.best_policy.best.numpy() + self.deviations[members]

    def _end_generation(self, generation: Generation) -> None:
        best = int(np.argmax(generation.rewards))
        if generation.rewards[best] > self.best_reward:
            self.best_reward = float(generation.rewards[best])
            self.best_policy.best = th.as_tensor(generation.trajectories[best])


class Broken(HillClimber):
    """Fails after its first generation on even seeds."""

    def _end_generation(self, generation: Generation) -> None:
        if self.seed is not None and self.seed % 2 == 0:
            raise RuntimeError("the matrix is singular")
        super()._end_generation(generation)


class Interrupted(HillClimber):
    """The user presses Ctrl-C in its second generation, if its seed is 1."""

    def _end_generation(self, generation: Generation) -> None:
        if self.seed == 1:
            raise KeyboardInterrupt
        super()._end_generation(generation)
