"""Controllers: which action follows a set-point of the trajectory.

Shape letters: T time points, D dimensions of a set-point, A of an action.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from benchmark_envs.exceptions import TaskError
from benchmark_envs.rollouts import FloatArray


class Controller(Protocol):
    """What turns a set-point into an action, step by step."""

    def action(self, set_point: FloatArray, observation: Any) -> FloatArray:  # noqa: ANN401
        """Return the action, shape (A,); what leaves the action space is clipped.

        :param set_point: shape (D,)
        :param observation: the environment's latest
        """
        ...

    def executed(self, set_point: FloatArray, action: FloatArray, observation: Any) -> FloatArray:  # noqa: ANN401
        """Return what came of a set-point, shape (D,).

        :param set_point: shape (D,)
        :param action: as it was sent to the environment, shape (A,)
        :param observation: that the environment then gave
        """
        ...


@dataclass(frozen=True)
class ActionController:
    """The set-points are the actions themselves.

    >>> ActionController().action(np.array([0.5]), observation=None).tolist()
    [0.5]
    """

    def action(self, set_point: FloatArray, observation: Any) -> FloatArray:  # noqa: ANN401
        """Return the set-point."""
        return set_point

    def executed(self, set_point: FloatArray, action: FloatArray, observation: Any) -> FloatArray:  # noqa: ANN401
        """Return the action, which was clipped to the action space."""
        return action


@dataclass(frozen=True)
class PositionController:
    """Proportional control towards set-points of a position that the observation holds.

    ``action = gain (set-point - position)``. Where a set-point has more entries than the position,
    the others are passed on as they are, such as the opening of a gripper.

    >>> controller = PositionController(position=lambda observation: observation[:2], gain=20.0)
    >>> controller.action(np.array([0.1, 0.0, -1.0]), np.array([0.05, 0.0, 9.0])).tolist()
    [1.0, 0.0, -1.0]

    :param position: returns it from an observation, shape (P,), P <= D
    :param gain: of the control, in units of the action per unit of the position
    :param fill: entries that every action ends with, such as those of a blocked gripper
    """

    position: Callable[[Any], ArrayLike]
    gain: float
    fill: tuple[float, ...] = ()

    def action(self, set_point: FloatArray, observation: Any) -> FloatArray:  # noqa: ANN401
        """Return the action that moves towards the set-point."""
        position = np.asarray(self.position(observation), np.float64)
        moved = self.gain * (set_point[: len(position)] - position)
        return np.concatenate([moved, set_point[len(position) :], self.fill])

    def executed(self, set_point: FloatArray, action: FloatArray, observation: Any) -> FloatArray:  # noqa: ANN401
        """Return the position that was reached, and what was passed on."""
        position = np.asarray(self.position(observation), np.float64)
        return np.concatenate([position, set_point[len(position) :]])


@dataclass(frozen=True)
class FunctionController:
    """A user's own control law, such as a PD controller.

    :param law: of set-point and observation; returns the action
    """

    law: Callable[[FloatArray, Any], ArrayLike]

    def action(self, set_point: FloatArray, observation: Any) -> FloatArray:  # noqa: ANN401
        """Return what the law says."""
        return np.asarray(self.law(set_point, observation), np.float64)

    def executed(self, set_point: FloatArray, action: FloatArray, observation: Any) -> FloatArray:  # noqa: ANN401
        """Return the set-point, since nothing is known of what came of it."""
        return set_point


def as_controller(given: Controller | Callable[[FloatArray, Any], ArrayLike] | None) -> Controller:
    """Return a controller: the given one, one of a function, or the actions themselves.

    :param given: a controller, a function of set-point and observation, or None
    :raises TaskError: none of these
    """
    if given is None:
        return ActionController()
    if hasattr(given, "action") and hasattr(given, "executed"):
        return given  # pyright: ignore[reportReturnType]
    if callable(given):
        return FunctionController(given)
    raise TaskError(
        f"controller is {given!r}; give ActionController(), PositionController(position, gain), or "
        "a function of set-point and observation that returns an action."
    )


def check_action_space(space: spaces.Space[Any]) -> spaces.Box:
    """Return an action space, if it is one that a trajectory can be followed in.

    :param space: of a step-based environment
    :raises TaskError: it is not a finite Box of shape (A,)
    """
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise TaskError(
            f"the action space is {space}; a trajectory of set-points needs continuous actions, a "
            "Box of shape (A,). For discrete actions there is no such wrapper."
        )
    if not np.isfinite([space.low, space.high]).all():
        raise TaskError(
            f"the action space, {space}, has no finite bounds; put "
            "gymnasium.wrappers.RescaleAction or ClipAction with bounds around the environment."
        )
    return space
