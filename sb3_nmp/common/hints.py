"""What an environment may tell besides its spaces: where a search begins, and what it achieves.

Shape letters: n environments, T time points, D dimensions of the trajectory.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from sb3_nmp.common.environment import check_scale
from sb3_nmp.common.exceptions import ConfigurationError

FloatArray = NDArray[np.float64]


def initial_trajectory(env: VecEnv, space: spaces.Box) -> FloatArray:
    """Return the environment's naive trajectory for its current context, shape (T, D).

    :param env: read by its method ``initial_trajectory``; without one, the trajectory rests in the
        middle of the action space
    :param space: of the actions
    :raises ConfigurationError: what it tells is no trajectory of the action space
    """
    if env.has_attr("initial_trajectory"):
        return _told_trajectories(env, space, [0])[0]
    return (space.low.astype(np.float64) + space.high) / 2


def initial_trajectories(env: VecEnv, space: spaces.Box) -> FloatArray:
    """Return every environment's naive trajectory for its current context, shape (n, T, D).

    :param env: read as by `initial_trajectory`
    :param space: of the actions
    :raises ConfigurationError: what one tells is no trajectory of the action space
    """
    if env.has_attr("initial_trajectory"):
        return _told_trajectories(env, space, None)
    return np.repeat(initial_trajectory(env, space)[None], env.num_envs, axis=0)


def _told_trajectories(env: VecEnv, space: spaces.Box, indices: list[int] | None) -> FloatArray:
    """Return what environments tell as their naive trajectories, checked, shape (n, T, D)."""
    _check_space(env, "initial_trajectory", space)
    rule = (
        "it must be a method without arguments that returns one finite trajectory of the action "
        f"space's shape (T, D) = {space.shape}."
    )
    try:
        told = [np.asarray(x) for x in env.env_method("initial_trajectory", indices=indices)]
    except TypeError as error:
        raise ConfigurationError(
            f"the environment's initial_trajectory cannot be called: {error}; {rule}"
        ) from error
    for each in told:
        if each.shape != space.shape or each.dtype.kind not in "fiu" or not np.isfinite(each).all():
            raise ConfigurationError(
                "the environment's initial_trajectory returned an array of shape "
                f"{each.shape} and dtype {each.dtype}"
                f"{' with values that are not finite' if each.shape == space.shape else ''}; "
                f"{rule}"
            )
    return np.stack(told).astype(np.float64)


def _check_space(env: VecEnv, name: str, space: spaces.Box) -> None:
    """Raise where a wrapper has changed the action space in whose unit a hint is told.

    Only environments of this process can be asked.

    :param env: that has the hint
    :param name: of the hint
    :param space: of the actions, as the algorithm sees it
    :raises ConfigurationError: a wrapper has
    """
    each = next(iter(getattr(env.unwrapped, "envs", ())), None)
    outermost = type(each).__name__
    while isinstance(each, gym.Wrapper) and not hasattr(type(each), name):
        if name in vars(each):
            break
        each = each.env
    told = getattr(each, "action_space", space)
    if told != space:
        raise ConfigurationError(
            f"{type(each).__name__} tells its {name} in the unit of its own action space, "
            f"{_extent(told)}, but a wrapper ({outermost} is the outermost) has made "
            f"{_extent(space)} of that. Leave wrappers that change the actions out: algorithms "
            f"here scale trajectories by themselves. Or give the wrapper an {name} of its own."
        )


def _extent(space: gym.Space[Any]) -> str:
    """Return a space in a few words."""
    if not isinstance(space, spaces.Box):
        return str(space)
    return f"a Box of shape {space.shape} from {space.low.min():.4g} to {space.high.max():.4g}"


def tells_achievement(env: VecEnv) -> bool:
    """Return whether an environment says that rollouts tell what they achieved.

    :param env: read by its attribute ``tells_achievement``; without one, it does not
    """
    return env.has_attr("tells_achievement") and bool(env.get_attr("tells_achievement", [0])[0])


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


def exploration_scale(env: VecEnv, space: spaces.Box) -> FloatArray:
    """Return the standard deviation at which a search may begin, shape (D,).

    :param env: read by its attribute ``exploration_scale``; without one, the scale is a tenth of
        the action space's range
    :param space: of the actions
    :raises ConfigurationError: it is no standard deviation of a trajectory
    """
    if not env.has_attr("exploration_scale"):
        return (space.high.astype(np.float64) - space.low).mean(axis=0) / 10
    _check_space(env, "exploration_scale", space)
    told, n_dimensions = env.get_attr("exploration_scale", indices=[0])[0], space.shape[1]
    check_scale("the environment's exploration_scale", told, n_dimensions)
    return np.broadcast_to(np.asarray(told, np.float64), (n_dimensions,)).copy()
