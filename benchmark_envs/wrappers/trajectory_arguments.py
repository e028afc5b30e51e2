"""What the wrappers ask of their arguments, and the messages for those that do not fit.

Shape letters: T time points, D dimensions of a set-point.
"""

from numbers import Integral
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from benchmark_envs.arguments import as_numbers
from benchmark_envs.exceptions import TaskError
from benchmark_envs.rollouts import FloatArray


def check_env(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """Return an environment.

    :param env: to be wrapped
    :raises TaskError: an id, a class, or anything else that is none
    """
    if not isinstance(env, gym.Env):
        raise TaskError(f"env is {env!r}; it must be an environment, such as gym.make(id) returns.")
    return env


def length(env: gym.Env[Any, Any], n_time_points: int | None) -> int:
    """Return T.

    :param env: the step-based environment
    :param n_time_points: T; None: the environment's ``max_episode_steps``
    :raises TaskError: it is not known, no whole number, or longer than an episode
    """
    longest = None if env.spec is None else env.spec.max_episode_steps
    chosen = longest if n_time_points is None else n_time_points
    if not isinstance(chosen, Integral) or chosen < 2:
        raise TaskError(
            f"n_time_points is {n_time_points!r} and the environment's max_episode_steps "
            f"{longest}; give n_time_points >= 2, a whole number."
        )
    if longest is not None and chosen > longest:
        raise TaskError(
            f"n_time_points is {chosen}, but the environment ends after {longest} steps; give at "
            f"most these, or gym.make(..., max_episode_steps={chosen})."
        )
    return int(chosen)


def bounds(low: ArrayLike, high: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest set-point, each of shape (D,).

    :param low: one value, or one for each dimension
    :param high: of the shape of ``low``
    :raises TaskError: they do not fit
    """
    rule = "finite numbers, shape (D,)"
    lows = np.atleast_1d(as_numbers("low", low, rule))
    highs = np.atleast_1d(as_numbers("high", high, rule))
    fits = lows.ndim == 1 and lows.shape == highs.shape and np.isfinite([lows, highs]).all()
    if not (fits and (lows < highs).all()):
        raise TaskError(
            f"low is {lows.tolist()}, high {highs.tolist()}; they must be finite, of one shape "
            "(D,), and low < high."
        )
    return lows, highs


def scale(given: ArrayLike | None, otherwise: FloatArray, of: str) -> FloatArray:
    """Return the standard deviation at which a search may begin, shape (D,).

    :param given: one value, or one for each dimension
    :param otherwise: where none is given, shape (D,)
    :param of: what has these dimensions, in words
    :raises TaskError: it does not fit
    """
    shape = otherwise.shape
    rule = f"one finite number > 0, or {shape[0]}: one for each dimension of {of}"
    found = as_numbers("exploration_scale", otherwise if given is None else given, rule)
    if found.shape not in ((), shape) or not ((found > 0) & (found < np.inf)).all():
        raise TaskError(f"exploration_scale is {given}; it must be {rule}.")
    return np.array(np.broadcast_to(found, shape))


def rest(given: ArrayLike, space: spaces.Box) -> FloatArray:
    """Return the set-point at which the naive trajectory rests, shape (D,).

    :param given: shape (D,)
    :param space: of the trajectories
    :raises TaskError: it does not fit
    """
    shape = space.shape[1:]
    point = as_numbers("initial", given, f"{shape[0]} finite numbers: a set-point")
    if point.shape != shape:
        raise TaskError(f"initial has shape {point.shape}; a set-point has {shape}.")
    if not np.isfinite(point).all():
        raise TaskError(f"initial is {point.tolist()}; it must be {shape[0]} finite numbers.")
    return point
