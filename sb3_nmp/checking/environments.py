"""Environments in which an algorithm is examined.

Shape letters: T time points, D dimensions of the trajectory, C context.
"""

from typing import Any, SupportsFloat, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import AlgorithmContractError
from sb3_nmp.common.rollouts import (
    ACHIEVED_CONTEXT,
    IS_SUCCESS,
    STEP_REWARDS,
    TERM_PREFIX,
    Information,
)

FloatArray = NDArray[np.float64]
Step = tuple[NDArray[np.float32], SupportsFloat, bool, bool, dict[str, Any]]


class ReachEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """A trajectory bandit that costs no time: a point is to end at a target.

    A context is the target's height, shape (1,); a trajectory has shape (20, 2).

    :param context: pins the context of every episode; by default it is drawn
    """

    observation_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
    action_space = spaces.Box(-2.0, 2.0, (20, 2), np.float32)
    exploration_scale = np.array([0.2, 0.2])
    tells_achievement = True

    def __init__(self, context: float | None = None) -> None:
        self.pinned = context
        self.context = np.zeros(1, np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Draw a target.

        :param seed: of the generator
        :param options: ``{"context": c}`` asks for a target, shape (1,)
        """
        super().reset(seed=seed)
        drawn = self.np_random.uniform(-1.0, 1.0) if self.pinned is None else self.pinned
        self.context = np.array((options or {}).get("context", [drawn]), np.float32)
        return self.context.copy(), {}

    def step(self, action: NDArray[np.float32]) -> Step:
        """Execute a trajectory.

        :param action: shape (20, 2)
        """
        end = np.asarray(action, np.float64)[-1]
        miss = float(np.hypot(end[0] - 1.0, end[1] - self.context[0]))
        way = 0.01 * float(np.abs(np.diff(action, axis=0)).sum())
        info = {
            IS_SUCCESS: miss < 0.1,
            f"{TERM_PREFIX}miss": -miss,
            f"{TERM_PREFIX}way": -way,
            STEP_REWARDS: np.append(np.full(19, -way / 19), -miss),
        }
        return self.context.copy(), -miss - way, True, False, info

    def initial_trajectory(self) -> FloatArray:
        """Return the trajectory from which a search starts, shape (20, 2)."""
        return np.linspace(0.0, 1.0, 20)[:, None] * np.array([1.0, 0.0])

    @staticmethod
    def demonstrations() -> Demonstrations:
        """Return three ways to targets, of an expert that does not quite get there."""
        heights = np.array([[-0.8], [0.1], [0.9]])
        ends = np.column_stack([np.full(3, 0.9), heights[:, 0]])
        return Demonstrations(heights, np.linspace(0.0, 1.0, 20)[None, :, None] * ends[:, None])


class Recording(gym.Wrapper[Any, Any, Any, Any]):
    """Keeps what was executed in it, and refuses what cannot be.

    :param env: any
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self.trajectories: list[NDArray[np.float32]] = []

    def step(self, action: NDArray[np.float32]) -> Step:
        """Execute a trajectory, and keep it.

        :param action: shape (T, D)
        :raises AlgorithmContractError: it does not lie in the action space
        """
        self.trajectories.append(np.array(action))
        if not self.action_space.contains(action):
            raise AlgorithmContractError(
                f"rollout {len(self.trajectories)} is a trajectory of shape {np.shape(action)} and "
                f"dtype {action.dtype}, from {np.min(action):.4g} to {np.max(action):.4g}; it must "
                f"lie in {self.action_space}: clip it, and let no value become nan."
            )
        return self.env.step(action)


class Telling(gym.Wrapper[Any, Any, Any, Any]):
    """Tells all that can be told, made up at random; one kind can be told otherwise.

    :param env: any
    :param altered: the kind of information that is told otherwise
    """

    tells_achievement = True

    def __init__(self, env: gym.Env[Any, Any], altered: Information | None = None) -> None:
        super().__init__(env)
        self.altered, self.n_steps = altered, 0

    def _drawn(self, kind: Information) -> np.random.Generator:
        return np.random.default_rng([self.n_steps, list(Information).index(kind)])

    def step(self, action: NDArray[np.float32]) -> Step:
        """Execute a trajectory, and tell of it what is made up.

        :param action: shape (T, D)
        """
        obs, given, ended, cut, info = self.env.step(action)
        self.n_steps += 1
        told = {kind: self._drawn(kind).uniform(0.2, 0.8) for kind in Information}
        if self.altered is not None:
            told[self.altered] = 1.0 - told[self.altered]
        reward = float(given) - 20.0 * told[Information.REWARD]
        info = {key: info[key] for key in info if not key.startswith(TERM_PREFIX)}
        share = told[Information.TERMS]
        info[f"{TERM_PREFIX}one"] = share * reward
        info[f"{TERM_PREFIX}other"] = (1.0 - share) * reward
        info[IS_SUCCESS] = bool(told[Information.SUCCESS] > 0.5)
        rate = 100.0 * told[Information.STEP_REWARDS]
        info[STEP_REWARDS] = np.sin(rate * np.arange(len(action)))
        along = told[Information.ACHIEVED_CONTEXTS]
        space = cast(spaces.Box, self.env.observation_space)
        info[ACHIEVED_CONTEXT] = space.low + along * (space.high - space.low)
        return obs, reward, ended, cut, info
