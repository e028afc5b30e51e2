"""`ContextSource`: where the context of a step-based environment is read, and how it is set."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from benchmark_envs.arguments import as_numbers
from benchmark_envs.exceptions import InvalidContextError, TaskError

Array = NDArray[Any]


@dataclass(frozen=True)
class ContextSource:
    """Which part of an environment's first observation is the context.

    >>> source = ContextSource(lambda seen: seen[:1], spaces.Box(-1.0, 1.0, (1,), np.float32))
    >>> source.context(np.array([0.25, 7.0]))
    array([0.25], dtype=float32)

    :param read: returns the context from an observation, shape (C,)
    :param space: of the contexts, with finite bounds, shape (C,)
    :param place: puts a freshly reset environment into a context and returns the observation; None:
        contexts that were drawn before are drawn again by their seed, others cannot be set
    :param achieved: from the context and the last observation, the context in which the rollout
        would have been right; None: it cannot be told
    :raises TaskError: a space without finite bounds
    """

    read: Callable[[Any], ArrayLike]
    space: spaces.Box
    place: Callable[[gym.Env[Any, Any], Array], Any] | None = None
    achieved: Callable[[Array, Any], ArrayLike] | None = None

    def __post_init__(self) -> None:
        """Check the space."""
        check_context_space(self.space)

    def context(self, observation: Any) -> Array:  # noqa: ANN401
        """Return the context that an observation shows, shape (C,), float32.

        :param observation: the environment's first one
        :raises InvalidContextError: it does not lie in the space
        """
        return self.check(self.read(observation))

    def check(self, context: ArrayLike) -> Array:
        """Return a context as float32, shape (C,).

        :param context: shape (C,)
        :raises InvalidContextError: wrong shape, non-finite value, or outside the context space
        """
        space = self.space
        rule = f"{space.shape[0]} numbers"
        checked = as_numbers("the context", context, rule, InvalidContextError)
        if checked.shape != space.shape:
            raise InvalidContextError(
                f"the context has shape {checked.shape}; the context space has {space.shape}."
            )
        outside = ~((checked >= space.low - 1e-6) & (checked <= space.high + 1e-6))
        if outside.any():
            i = int(np.argmax(outside))
            raise InvalidContextError(
                f"the context's entry {i} is {checked[i]:.6g}, but must lie in "
                f"[{space.low[i]:.6g}, {space.high[i]:.6g}]. Give a context inside of it, or a "
                "wider space to the ContextSource."
            )
        return np.clip(checked.astype(np.float32), space.low, space.high)

    def achieved_context(self, context: Array, observation: Any) -> Array | None:  # noqa: ANN401
        """Return what a rollout achieved, or None where that lies outside the context space.

        What lies outside by less than a hundredth of the space counts as its edge, since objects at
        rest sink into a table a little.

        :param context: in which it began, shape (C,)
        :param observation: the last one
        """
        if self.achieved is None:
            return None
        told = np.asarray(self.achieved(context, observation), np.float32)
        edge = (self.space.high - self.space.low) / 100
        if not ((told >= self.space.low - edge) & (told <= self.space.high + edge)).all():
            return None
        return np.clip(told, self.space.low, self.space.high)


def first_observation(env: gym.Env[Any, Any]) -> ContextSource:
    """Return the source that reads the desired goal, or else the whole first observation.

    :param env: with observations of shape (C,), or a dictionary that holds ``desired_goal``
    :raises TaskError: other observations, or unbounded ones
    """
    space = env.observation_space
    if isinstance(space, spaces.Dict) and "desired_goal" in space.spaces:
        return ContextSource(
            lambda observation: observation["desired_goal"],
            check_context_space(space["desired_goal"]),
            achieved=lambda _, observation: observation["achieved_goal"],
        )
    return ContextSource(lambda observation: observation, check_context_space(space))


def check_context_space(space: gym.Space[Any]) -> spaces.Box:
    """Return a space, if it can be one of contexts.

    :param space: of a context, or of an observation that is to be one
    :raises TaskError: it is not a finite Box of shape (C,)
    """
    advice = (
        "give context=ContextSource(read, space=Box(low, high, (C,))): what of the first "
        "observation is the context, and between which bounds"
    )
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise TaskError(f"{space} is no space of contexts, a Box of shape (C,); {advice}.")
    if not np.isfinite([space.low, space.high]).all():
        i = int(np.argmin(np.isfinite(space.low) & np.isfinite(space.high)))
        raise TaskError(
            f"contexts need finite bounds, but entry {i} lies in [{space.low[i]}, "
            f"{space.high[i]}]; {advice}. For the Fetch tasks there is fetch_env(id)."
        )
    return space
