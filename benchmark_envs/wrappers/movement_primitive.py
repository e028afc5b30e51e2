"""`MovementPrimitiveWrapper`: the weights of a movement primitive as the action.

Shape letters: T time points, D dimensions, C context, K weights per dimension.
"""

from collections.abc import Callable
from numbers import Real
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from benchmark_envs.arguments import as_numbers, check_flag
from benchmark_envs.exceptions import InvalidTrajectoryError, TaskError
from benchmark_envs.rollouts import FloatArray
from benchmark_envs.wrappers import trajectory_arguments

Array = NDArray[Any]


class MovementPrimitive(Protocol):
    """What is asked of a primitive: trajectories that are linear in weights, start and goal.

    `baselines.ProMP` and `baselines.DMP` are of this kind, and so is every class with these three
    members: this package knows none of them.
    """

    @property
    def n_bases(self) -> int:
        """K."""
        ...

    @property
    def n_time_points(self) -> int:
        """T."""
        ...

    def trajectories(self, weights: ArrayLike, start: ArrayLike, goal: ArrayLike) -> FloatArray:
        """Return the trajectories of a batch of weights, shape (N, T, D).

        :param weights: shape (N, K, D)
        :param start: where the movement starts, shape (D,)
        :param goal: where it ends, shape (D,)
        """
        ...


class MovementPrimitiveWrapper(
    gym.ActionWrapper[Array, Array, Array], gym.utils.RecordConstructorArgs
):
    """Trajectory bandit whose action is the K x D weights of a primitive, as one flat vector.

    So PPO, SAC and ARS, which answer with a vector, run on tasks that ask for a trajectory. The
    weights bend a mean trajectory::

        trajectory = mean + scale sum_k weight_k basis_k

    Weights of 0 are the mean. ``scale`` is such that independent weights of standard deviation 1,
    which is how a Gaussian policy of SB3 begins, move the trajectory by the ``exploration_scale``
    (as root mean square over time). Policies that squash their actions, as SAC's does, begin with
    nearly uniform weights within ``reach``.

    >>> import benchmark_envs
    >>> from baselines import ProMP
    >>> env = gym.make("nmp/ViaPoints-v0")
    >>> env = MovementPrimitiveWrapper(env, ProMP(n_bases=8, n_time_points=200))
    >>> context, _ = env.reset(seed=0)
    >>> _, reward, terminated, _, _ = env.step(np.zeros(8, np.float32))
    >>> env.action_space.shape, terminated
    ((8,), True)

    :param env: a trajectory bandit: its action is a trajectory of shape (T, D)
    :param primitive: of T time points, such as ``ProMP(n_bases=10, n_time_points=T)``
    :param mean: the trajectory that weights of 0 stand for, shape (T, D), or a function of the
        context that returns it; None: the environment's ``initial_trajectory``, or the middle of
        its action space
    :param exploration_scale: in the trajectory's unit, one value or one for each dimension; None:
        the environment's, or a tenth of its action space
    :param reach: the largest weight. Solutions that lie farther from the mean ask for more; what
        squashes its actions explores the farther, too
    :param moves_goal: one further weight for each dimension moves the primitive's goal; for a DMP,
        which otherwise ends near the mean's end
    :raises TaskError: spaces, a primitive or values that do not fit
    """

    def __init__(
        self,
        env: gym.Env[Array, Array],
        primitive: MovementPrimitive,
        *,
        mean: ArrayLike | Callable[[Array], ArrayLike] | None = None,
        exploration_scale: ArrayLike | None = None,
        reach: float = 5.0,
        moves_goal: bool = False,
    ) -> None:
        gym.utils.RecordConstructorArgs.__init__(
            self,
            primitive=primitive,
            mean=mean,
            exploration_scale=exploration_scale,
            reach=reach,
            moves_goal=moves_goal,
        )
        gym.ActionWrapper.__init__(self, trajectory_arguments.check_env(env))
        self.trajectory_space = _trajectory_space(env.action_space)
        n_time_points, n_dimensions = self.trajectory_space.shape
        _check_primitive(primitive, n_time_points)
        check_flag("moves_goal", moves_goal)
        if primitive.n_time_points != n_time_points:
            raise TaskError(
                f"the primitive has {primitive.n_time_points} time points, but a trajectory of "
                f"this environment has {n_time_points}: build it with "
                f"n_time_points={n_time_points}."
            )
        number = isinstance(reach, Real) and not isinstance(reach, bool)
        if not (number and 0 < reach < np.inf):
            raise TaskError(f"reach is {reach!r}; it must be a finite number > 0, such as 5.")
        self.reach = reach
        self._mean = mean if mean is None or callable(mean) else self._check_mean(mean)
        self._bases = _bases(primitive, moves_goal)
        self._scale = self._exploration_scale(exploration_scale)
        self._context: Array | None = None
        n_weights = self._bases.shape[1] * n_dimensions
        self.action_space = spaces.Box(-reach, reach, (n_weights,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start an episode; see the environment.

        :param seed: of its generator
        :param options: as it takes them, such as ``{"context": c}``
        """
        observation, info = super().reset(seed=seed, options=options)
        self._context = observation
        return observation, info

    def action(self, action: Array) -> Array:
        """Return the trajectory that some weights stand for in the current context, shape (T, D).

        It keeps to the space of trajectories: what would leave it is clipped.

        :param action: the weights, shape (K D,)
        :raises InvalidTrajectoryError: wrong shape or non-finite value
        """
        rule = f"{self.action_space.shape} finite numbers"
        weights = as_numbers("the action", action, rule, InvalidTrajectoryError)
        if weights.shape != self.action_space.shape or not np.isfinite(weights).all():
            raise InvalidTrajectoryError(
                f"the weights have shape {weights.shape} or are not finite; this environment takes "
                f"{self.action_space.shape}: {self._bases.shape[1]} for each of "
                f"{self.trajectory_space.shape[1]} dimensions, all finite numbers."
            )
        space = self.trajectory_space
        bent = self.mean_trajectory() + self._bases @ (
            weights.reshape(self._bases.shape[1], -1) * self._scale
        )
        return np.clip(bent, space.low, space.high).astype(space.dtype)

    def weights(self, trajectory: ArrayLike) -> Array:
        """Return the action whose trajectory is nearest to a given one, shape (K D,).

        Least squares within the bounds of the weights: a way to begin from a demonstration.

        :param trajectory: shape (T, D), in the current context
        :raises TaskError: wrong shape or non-finite value
        """
        from scipy.optimize import lsq_linear

        bend = (self._check_mean(trajectory) - self.mean_trajectory()) / self._scale
        fits = [lsq_linear(self._bases, each, (-self.reach, self.reach)).x for each in bend.T]
        return np.stack(fits, axis=1).ravel().astype(np.float32)

    def mean_trajectory(self) -> FloatArray:
        """Return what weights of 0 stand for in the current context, shape (T, D)."""
        if callable(self._mean):
            if self._context is None:
                raise TaskError("there is no context yet: call reset() before step().")
            return self._check_mean(self._mean(self._context))
        if self._mean is not None:
            return np.asarray(self._mean)
        if self.env.has_wrapper_attr("initial_trajectory"):
            return np.asarray(self.env.get_wrapper_attr("initial_trajectory")(), np.float64)
        return (self.trajectory_space.low.astype(np.float64) + self.trajectory_space.high) / 2

    def _check_mean(self, trajectory: ArrayLike) -> FloatArray:
        rule = f"finite numbers, of shape (T, D) = {self.trajectory_space.shape}"
        checked = as_numbers("the trajectory", trajectory, rule)
        if checked.shape != self.trajectory_space.shape or not np.isfinite(checked).all():
            raise TaskError(
                f"the trajectory has shape {checked.shape} or is not finite; it must be finite "
                f"and of shape (T, D) = {self.trajectory_space.shape}."
            )
        return checked

    def _exploration_scale(self, given: ArrayLike | None) -> FloatArray:
        """Return the scale for each dimension, shape (D,)."""
        space = self.trajectory_space
        if given is None and self.env.has_wrapper_attr("exploration_scale"):
            given = self.env.get_wrapper_attr("exploration_scale")
        tenth = (space.high.astype(np.float64) - space.low).mean(axis=0) / 10
        return trajectory_arguments.scale(given, tenth, "the trajectory")


def _trajectory_space(space: gym.Space[Any]) -> spaces.Box:
    """Return an action space, if it is one of trajectories.

    :raises TaskError: it is not
    """
    if not isinstance(space, spaces.Box) or len(space.shape) != 2:
        raise TaskError(
            f"the action space is {space}; a movement primitive makes trajectories, for which it "
            "must be a finite Box of shape (T, D). For a step-based environment, put "
            "TrajectoryActionWrapper around it first."
        )
    if not np.isfinite([space.low, space.high]).all():
        raise TaskError(
            f"the action space, {space}, has no finite bounds; give it some, as "
            "gymnasium.wrappers.RescaleAction does."
        )
    return space


def _check_primitive(primitive: object, n_time_points: int) -> None:
    """Raise unless an object, rather than its name or class, has what is asked of a primitive.

    :raises TaskError: it has not
    """
    members = ("n_bases", "n_time_points", "trajectories")
    missing = [name for name in members if not hasattr(primitive, name)]
    if missing or isinstance(primitive, type):
        raise TaskError(
            f"primitive is {primitive!r}; it must be an object with {', '.join(members)}, such as "
            f"baselines.ProMP(n_bases=8, n_time_points={n_time_points})."
        )


def _bases(primitive: MovementPrimitive, moves_goal: bool) -> FloatArray:
    """Return what weights of 1 do to a dimension, shape (T, K) or (T, K + 1).

    The sum of the squares is 1 on average over time; the goal, where it moves, has half of it.

    :raises TaskError: the primitive does nothing with its weights or its goal
    """
    k = primitive.n_bases
    start, goal = np.zeros(1), np.ones(1)
    made = np.asarray(primitive.trajectories(np.eye(k)[:, :, None], start, 0 * goal))
    if made.shape != (k, primitive.n_time_points, 1):
        raise TaskError(
            f"{type(primitive).__name__}.trajectories returned shape {made.shape} for weights of "
            f"shape (N, K, D) = {(k, k, 1)}; it must be (N, T, D) = "
            f"{(k, primitive.n_time_points, 1)}."
        )
    columns = made[..., 0].T
    parts = [("weights", columns)]
    if moves_goal:
        parts.append(("goal", primitive.trajectories(np.zeros((1, k, 1)), start, goal)[0]))
    sizes = [np.sqrt(len(parts) * np.mean(np.sum(part**2, axis=1))) for _, part in parts]
    for (name, _), size in zip(parts, sizes, strict=True):
        if not size > 0:
            raise TaskError(
                f"the {name} of {type(primitive).__name__} move nothing; of a ProMP, start and "
                "goal are part of the weights: leave moves_goal=False there."
            )
    return np.concatenate([part / size for (_, part), size in zip(parts, sizes, strict=True)], 1)
