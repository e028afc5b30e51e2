"""`TrajectoryVecEnv`: n episodes of a task in one call of the batched simulator."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import DummyVecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from benchmark_envs.exceptions import TaskError
from benchmark_envs.trajectory_env import TrajectoryEnv


class TrajectoryVecEnv(DummyVecEnv):
    """SB3 VecEnv of n `TrajectoryEnv` of one task, whose rollouts are simulated as a batch.

    All wrappers around the environments stay in force: each environment is handed its rollout
    before its ``step`` is called. What a `gymnasium.ActionWrapper` makes of an action, such as the
    trajectory that `MovementPrimitiveWrapper` makes of weights, is simulated in the batch; where
    another wrapper changed the action, its environment simulates again by itself.

    >>> from stable_baselines3.common.env_util import make_vec_env
    >>> env = make_vec_env("nmp/Bottles-v0", n_envs=20, vec_env_cls=TrajectoryVecEnv)
    >>> env.reset().shape, env.action_space.shape
    ((20, 4), (200, 2))

    :param env_fns: functions that build the environments
    :raises TaskError: an environment is no TrajectoryEnv, or their tasks' settings differ
    """

    def __init__(self, env_fns: list[Callable[[], gym.Env]]) -> None:
        super().__init__(env_fns)
        self._trajectory_envs = [self._unwrap(env) for env in self.envs]
        self.task = self._trajectory_envs[0].task
        for index, env in enumerate(self._trajectory_envs):
            same = type(env.task) is type(self.task) and env.task.settings == self.task.settings
            if not same:
                raise TaskError(
                    f"environment {index} is {type(env.task).__name__}({env.task.settings}) but "
                    f"environment 0 is {type(self.task).__name__}({self.task.settings}): a "
                    "TrajectoryVecEnv holds one task; use DummyVecEnv or SubprocVecEnv for a mix."
                )

    @staticmethod
    def _unwrap(env: gym.Env) -> TrajectoryEnv:
        inner = env.unwrapped
        if not isinstance(inner, TrajectoryEnv):
            raise TaskError(
                f"TrajectoryVecEnv holds TrajectoryEnv only, not {type(inner).__name__}; use "
                "DummyVecEnv or SubprocVecEnv for other environments."
            )
        return inner

    def step_wait(self) -> VecEnvStepReturn:
        """Simulate all rollouts at once, then step every environment with its own."""
        contexts = np.stack([env._current_context() for env in self._trajectory_envs])
        actions = zip(self.envs, self.actions, strict=True)
        trajectories = np.stack([_as_executed(env, action) for env, action in actions])
        rollouts = self.task.simulate(contexts, trajectories)
        for index, env in enumerate(self._trajectory_envs):
            env.prefetch(rollouts[index])
        return super().step_wait()


def _as_executed(env: gym.Env, action: NDArray[Any]) -> NDArray[Any]:
    """Return what an environment's action wrappers make of an action, the outermost first.

    :param env: the environment with its wrappers
    :param action: as the outermost one takes it
    """
    while isinstance(env, gym.Wrapper):
        if isinstance(env, gym.ActionWrapper):
            action = env.action(action)
        env = env.env
    return action
