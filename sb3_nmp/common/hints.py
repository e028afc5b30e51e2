"""What an environment may tell besides its spaces: where a search begins, and what it achieves.

Shape letters: n environments, T time points, D dimensions of the trajectory.
"""

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from sb3_nmp.common.exceptions import ConfigurationError

FloatArray = NDArray[np.float64]


def initial_trajectory(env: VecEnv, space: spaces.Box) -> FloatArray:
    """Return the environment's naive trajectory for its current context, shape (T, D).

    :param env: read by its method ``initial_trajectory``; without one, the trajectory rests in the
        middle of the action space
    :param space: of the actions
    """
    if env.has_attr("initial_trajectory"):
        return np.asarray(env.env_method("initial_trajectory", indices=[0])[0], np.float64)
    return (space.low.astype(np.float64) + space.high) / 2


def initial_trajectories(env: VecEnv, space: spaces.Box) -> FloatArray:
    """Return every environment's naive trajectory for its current context, shape (n, T, D).

    :param env: read as by `initial_trajectory`
    :param space: of the actions
    """
    if env.has_attr("initial_trajectory"):
        return np.asarray(env.env_method("initial_trajectory"), np.float64)
    return np.repeat(initial_trajectory(env, space)[None], env.num_envs, axis=0)


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
    """
    if env.has_attr("exploration_scale"):
        return np.asarray(env.get_attr("exploration_scale", indices=[0])[0], np.float64)
    return (space.high.astype(np.float64) - space.low).mean(axis=0) / 10
