"""Cheap algorithms, and a task without physics, with which the harness is tested."""

import multiprocessing
import os
import signal
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, ClassVar, Self, cast

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule

from benchmark_envs import Measured, Task, registry
from benchmark_envs.rollouts import FloatArray
from results import suites
from results.harness.suite import Recipe
from sb3_nmp.common.algorithm import TrajectoryAlgorithm
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.policies import ElitePolicy, TrajectoryPolicy
from sb3_nmp.common.rollouts import Generation, Information


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
        super().__init__(policy, env, population_size=population_size, seed=seed)

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


class Remembered(HillClimber):
    """Can be asked for afterwards, as long as it has not been collected."""

    alive: ClassVar[weakref.WeakSet[HillClimber]] = weakref.WeakSet()

    def _setup_model(self) -> None:
        super()._setup_model()
        self.alive.add(self)


class Broken(HillClimber):
    """Fails after its first generation on even seeds."""

    def _end_generation(self, generation: Generation) -> None:
        if self.seed is not None and self.seed % 2 == 0:
            raise RuntimeError("the matrix is singular")
        super()._end_generation(generation)


class Spendthrift(HillClimber):
    """Takes a whole generation more than it was given, as SB3's on-policy algorithms do."""

    def learn(self, total_timesteps: int, *args: Any, **kwargs: Any) -> Self:
        return super().learn(total_timesteps + self.population_size, *args, **kwargs)


class Dying(HillClimber):
    """Its worker process is killed after its first generation, if its seed is 1."""

    def _end_generation(self, generation: Generation) -> None:
        if self.seed == 1 and "Loky" in multiprocessing.current_process().name:
            os.kill(os.getpid(), signal.SIGKILL)
        super()._end_generation(generation)


class Interrupted(HillClimber):
    """The user presses Ctrl-C in its second generation, if its seed is 1."""

    def _end_generation(self, generation: Generation) -> None:
        if self.seed == 1:
            raise KeyboardInterrupt
        super()._end_generation(generation)


TARGET_TASK = "fake/Targets-v0"
ANGLES = np.deg2rad(np.linspace(-60.0, 140.0, 10))
TARGETS = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)


class TargetTask(Task):
    """A point follows its set-points exactly; the last one is to lie at the target."""

    context_names = ("target x [m]", "target y [m]")
    trajectory_names = ("x [m]", "y [m]")
    exploration_scale = (0.1, 0.1)
    reward_terms: Mapping[str, str] = {"distance": "minus the last set-point's distance [m]"}
    dt = 0.1
    targets = TARGETS
    context_space = spaces.Box(-1.5, 1.5, (2,), np.float32)
    trajectory_space = spaces.Box(-2.0, 2.0, (12, 2), np.float32)

    @property
    def reward_range(self) -> tuple[float, float]:
        return -5.0, 0.0

    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        angle, radius = rng.uniform(-1.0, 2.4), rng.uniform(0.8, 1.2)
        return radius * np.array([np.cos(angle), np.sin(angle)])

    def initial_trajectory(self, context: ArrayLike) -> FloatArray:
        return np.zeros((12, 2))

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        return np.linspace(0.0, 1.0, 12)[:, None] * self.check_context(context)

    def _execute(self, contexts: FloatArray, trajectories: FloatArray) -> Measured:
        distances = np.linalg.norm(trajectories[:, -1] - contexts, axis=1)
        return Measured(trajectories, {"distance": -distances}, distances < 0.1)


@contextmanager
def target_task() -> Iterator[None]:
    """Register `TARGET_TASK` for a while."""
    spec = EnvSpec(
        TARGET_TASK,
        entry_point="benchmark_envs.trajectory_env:TrajectoryEnv",
        kwargs={"task": TARGET_TASK},
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(registry._TASKS, TARGET_TASK, TargetTask)
        patch.setitem(gym.registry, TARGET_TASK, spec)
        yield


@contextmanager
def suite_of(recipes: Mapping[str, Recipe]) -> Iterator[None]:
    """Register suites for a while; one that bears the name of a file's stands in for it."""
    with pytest.MonkeyPatch.context() as patch:
        for name, recipe in recipes.items():
            patch.setitem(suites._REGISTERED, name, recipe)
        yield


class NearestPolicy(TrajectoryPolicy):
    """Answers with the trajectory of the nearest context that was solved."""

    contexts: th.Tensor
    trajectories: th.Tensor

    def __init__(
        self, observation_space: spaces.Box, action_space: spaces.Box, lr_schedule: Schedule
    ) -> None:
        super().__init__(observation_space, action_space)
        self.register_buffer("contexts", th.zeros((0, self.context_dim)))
        self.register_buffer("trajectories", th.zeros((0, *self.trajectory_shape)))

    def add(self, context: ArrayLike, trajectory: ArrayLike) -> None:
        """Add one, of shapes (C,) and (T, D)."""
        row, path = (th.as_tensor(np.array(value, np.float32)) for value in (context, trajectory))
        self.contexts = th.cat([self.contexts, row[None]])
        self.trajectories = th.cat([self.trajectories, path[None]])

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> th.Tensor:
        nearest = th.cdist(cast(th.Tensor, observation), self.contexts).argmin(dim=1)
        return self.trajectories[nearest]


class Adaptive(TrajectoryAlgorithm):
    """Tries what the nearest solved context has, moves step by step to the target, remembers it.

    It asks the environment for its context again until ``n_steps`` rollouts are done in it.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": NearestPolicy}

    def __init__(
        self,
        policy: str,
        env: Any,
        seed: int | None = None,
        demonstrations: Demonstrations | None = None,
        n_steps: int = 5,
        step: float = 0.25,
    ) -> None:
        if demonstrations is None:
            raise ValueError("Adaptive needs demonstrations.")
        self.step = step
        self.context: NDArray[np.float32] | None = None
        super().__init__(policy, env, population_size=n_steps, seed=seed)
        for context, trajectory in zip(
            demonstrations.contexts, demonstrations.trajectories, strict=True
        ):
            self.nearest.add(context, trajectory)

    @property
    def nearest(self) -> NearestPolicy:
        return cast(NearestPolicy, self.policy)

    def _begin_generation(self) -> None:
        self.context = None

    def _wanted_contexts(self, members: slice) -> NDArray[np.float32] | None:
        return None if self.context is None else self.context

    def _propose(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        self.context = contexts
        greedy, _ = self.predict(contexts, deterministic=True)
        ramp = np.linspace(0.0, 1.0, greedy.shape[1])[:, None]
        part = self.step * members.start * self.rng.uniform(0.5, 1.0)
        return greedy + part * ramp * (contexts - greedy[:, -1])[:, None]

    def _end_generation(self, generation: Generation) -> None:
        best = int(np.argmax(generation.rewards))
        self.nearest.add(generation.contexts[best], generation.trajectories[best])


class Guessing(HillClimber):
    """A hill climber that begins with the mean of demonstrations, and has no policy before."""

    def __init__(
        self,
        policy: str,
        env: Any,
        seed: int | None = None,
        demonstrations: Demonstrations | None = None,
    ) -> None:
        self.guess = None if demonstrations is None else demonstrations.trajectories.mean(axis=0)
        super().__init__(policy, env, seed)

    def initial_trajectory(self) -> NDArray[np.float64]:
        return super().initial_trajectory() if self.guess is None else self.guess


def straight(contexts: NDArray[np.floating]) -> FloatArray:
    """The lines to the targets, which solve `TARGET_TASK`, shape (N, 12, 2)."""
    return np.linspace(0.0, 1.0, 12)[:, None] * np.asarray(contexts, np.float64)[:, None]


class LearnerPolicy(ElitePolicy):
    """Its model solves every target, or rests."""

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        lr_schedule: Schedule,
        model_is_right: bool = True,
    ) -> None:
        super().__init__(observation_space, action_space)
        self.model_is_right = model_is_right

    def generalise(self, contexts: th.Tensor, deterministic: bool = True) -> th.Tensor:
        lines = float(self.model_is_right) * straight(contexts.numpy())
        return th.as_tensor(lines, dtype=th.float32)


class Learner(TrajectoryAlgorithm):
    """Its rollouts solve the task where its model does not, and the other way round."""

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": LearnerPolicy}

    def __init__(
        self,
        policy: str,
        env: Any,
        seed: int | None = None,
        demonstrations: Demonstrations | None = None,
        model_is_right: bool = True,
    ) -> None:
        kwargs = {"model_is_right": model_is_right}
        super().__init__(
            policy, env, population_size=4, seed=seed, demonstrations=demonstrations,
            policy_kwargs=kwargs,
        )  # fmt: skip

    @property
    def information(self) -> frozenset[Information]:
        return super().information | {Information.SUCCESS}

    def _begin_generation(self) -> None: ...

    def _propose(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        return float(not cast(LearnerPolicy, self.policy).model_is_right) * straight(contexts)

    def _end_generation(self, generation: Generation) -> None:
        cast(LearnerPolicy, self.policy).elites.update(
            generation.contexts, generation.trajectories, generation.rewards, generation.successes
        )
