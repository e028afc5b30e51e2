"""What an algorithm asks of an environment, and the messages for one that does not fit."""

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError

FloatArray = NDArray[np.float64]
#: a standard deviation in the trajectory's unit: one value, or one per dimension
Scale = float | tuple[float, ...]


def check_env_id(env: object) -> None:
    """Raise a helpful error for an environment id that Gymnasium does not know.

    :param env: an id such as ``"nmp/Bottles-v0"`` or ``"module:id"``, or an environment
    :raises ConfigurationError: the id is not registered
    """
    if not isinstance(env, str) or ":" in env or env in gym.registry:
        return
    known = sorted(key for key in gym.registry if key.startswith("nmp/"))
    raise ConfigurationError(
        f"no environment '{env}' is registered with Gymnasium. "
        + (
            f"There are: {', '.join(known)}, besides Gymnasium's own."
            if known
            else "The nmp/* tasks are registered by 'import benchmark_envs'."
        )
    )


def check_spaces(action: gym.Space, observation: gym.Space, algorithm: str) -> None:
    """Raise unless the spaces are those of a trajectory bandit.

    :param action: must have shape (T, D)
    :param observation: must be a box of shape (C,)
    :param algorithm: its name, for the message
    :raises ConfigurationError: they are not
    """
    if len(action.shape or ()) != 2:
        raise ConfigurationError(
            f"the action space has shape {action.shape}; {algorithm} answers with "
            "whole trajectories and needs (T, D): T time points, D dimensions."
        )
    if not isinstance(observation, spaces.Box) or len(observation.shape) != 1:
        raise ConfigurationError(
            f"the observation space is {observation}; {algorithm} needs a Box of "
            "shape (C,): the context."
        )


def check_multiple(name: str, value: int, n_envs: int) -> None:
    """Raise unless a number of rollouts can be shared out among the environments.

    :param name: of the argument
    :param value: the number
    :param n_envs: of parallel environments
    :raises ConfigurationError: it is not a positive multiple of them
    """
    if value < 1 or value % n_envs:
        raise ConfigurationError(
            f"{name} of {value} does not fit {n_envs} parallel environments: it must be a positive "
            f"multiple of {n_envs}. Change it or n_envs."
        )


def check_scale(name: str, scale: Scale, n_dimensions: int) -> None:
    """Raise unless a standard deviation fits a trajectory.

    :param name: of the argument
    :param scale: one value or one per dimension
    :param n_dimensions: D
    :raises ConfigurationError: it does not
    """
    values = np.atleast_1d(scale)
    if values.shape not in ((1,), (n_dimensions,)) or not np.all((values > 0) & (values < np.inf)):
        raise ConfigurationError(
            f"{name} is {scale}; it must be one finite number > 0, or a tuple of {n_dimensions}: "
            "one per dimension of the trajectory."
        )


def initial_trajectory(env: VecEnv, space: spaces.Box) -> FloatArray:
    """Return the environment's naive trajectory for its current context, shape (T, D).

    :param env: read by its method ``initial_trajectory``; without one, the trajectory rests in the
        middle of the action space
    :param space: of the actions
    """
    try:
        return np.asarray(env.env_method("initial_trajectory", indices=[0])[0], np.float64)
    except AttributeError:
        return (space.low.astype(np.float64) + space.high) / 2


def initial_trajectories(env: VecEnv, space: spaces.Box) -> FloatArray:
    """Return every environment's naive trajectory for its current context, shape (n, T, D).

    :param env: read as by `initial_trajectory`
    :param space: of the actions
    """
    try:
        return np.asarray(env.env_method("initial_trajectory"), np.float64)
    except AttributeError:
        return np.repeat(initial_trajectory(env, space)[None], env.num_envs, axis=0)


def tells_achievement(env: VecEnv) -> bool:
    """Return whether an environment says that rollouts tell what they achieved.

    :param env: read by its attribute ``tells_achievement``; without one, it does not
    """
    try:
        return bool(env.get_attr("tells_achievement", indices=[0])[0])
    except AttributeError:
        return False


def check_tells_achievement(env: VecEnv) -> None:
    """Raise unless an environment says that rollouts tell what they achieved.

    :param env: see `tells_achievement`
    :raises ConfigurationError: it says so of none
    """
    if not tells_achievement(env):
        raise ConfigurationError(
            "relabel is True, but this environment does not tell what a rollout achieved: its "
            "attribute tells_achievement must be True and its info hold 'achieved_context'. Give "
            "relabel=None, or False."
        )


def check_achieved(achieved: FloatArray, space: spaces.Box) -> None:
    """Raise where an achieved context lies outside the space of contexts.

    :param achieved: NaN where nothing was achieved, shape (N, C)
    :param space: of the contexts
    :raises InvalidDataError: one does
    """
    told = achieved[np.isfinite(achieved).all(axis=1)]
    outside = (told < space.low - 1e-5) | (told > space.high + 1e-5)
    if outside.any():
        row = told[outside.any(axis=1)][0]
        raise InvalidDataError(
            f"info['achieved_context'] is {row.round(6).tolist()}; it must lie within the space of "
            f"contexts, {space.low.tolist()} to {space.high.tolist()}, or be left out."
        )


def exploration_scale(env: VecEnv, space: spaces.Box) -> FloatArray:
    """Return the standard deviation at which a search may begin, shape (D,).

    :param env: read by its attribute ``exploration_scale``; without one, the scale is a tenth of
        the action space's range
    :param space: of the actions
    """
    try:
        return np.asarray(env.get_attr("exploration_scale", indices=[0])[0], np.float64)
    except AttributeError:
        return (space.high.astype(np.float64) - space.low).mean(axis=0) / 10
