"""`TrajectoryActionWrapper`: a step-based environment as a trajectory bandit.

Shape letters: T time points, D dimensions of a set-point, C context, A of an action.
"""

from collections.abc import Callable, Mapping
from typing import Any, Literal, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import ArrayLike, NDArray

from benchmark_envs.arguments import as_numbers
from benchmark_envs.exceptions import InvalidContextError, InvalidTrajectoryError, TaskError
from benchmark_envs.rollouts import FloatArray
from benchmark_envs.wrappers import trajectory_arguments
from benchmark_envs.wrappers.context_source import ContextSource, first_observation
from benchmark_envs.wrappers.controllers import (
    ActionController,
    Controller,
    as_controller,
    check_action_space,
)

Array = NDArray[Any]
Return = Literal["sum", "last"]
N_SEEDS = 2**31


class TrajectoryActionWrapper(gym.Env[Array, Array]):
    """Contextual bandit whose one step follows a whole trajectory in a step-based environment.

    ``reset`` returns the context; ``step`` takes set-points, lets the controller follow them until
    they or the episode end, and terminates. ``info`` holds ``is_success``, ``executed_trajectory``,
    ``n_steps``, ``clipped`` (whether an action was), ``step_rewards`` where the return is the sum,
    the terms ``reward_<name>`` where the environment tells some that add up to its reward, and
    ``achieved_context`` where the context's source tells one.

    >>> env = TrajectoryActionWrapper(gym.make("Pendulum-v1"), exploration_scale=0.5)
    >>> context, _ = env.reset(seed=0)
    >>> _, reward, terminated, _, info = env.step(env.initial_trajectory())
    >>> env.action_space.shape, context.shape, terminated, info["n_steps"]
    ((200, 1), (3,), True, 200)

    It is an environment of its own, where ``unwrapped`` ends: what the step-based one promises,
    such as ``compute_reward`` of a goal, does not hold of it. That one is ``env``.

    ``reset(options={"context": c})`` sets the context. Without a ``place`` function in the
    context's source, that can be done for contexts that this environment has drawn before: it
    resets to the seed that gave them.

    :param env: with continuous, bounded actions of shape (A,)
    :param n_time_points: T; None: the environment's ``max_episode_steps``
    :param context: where the context is read; None: the desired goal, or the whole first
        observation
    :param controller: which action follows a set-point: a controller, or a function of set-point
        and observation; None: the set-points are the actions
    :param low: lowest set-point, shape (D,); None: the lowest action
    :param high: highest set-point, shape (D,); None: the highest action
    :param returns: the reward is the ``"sum"`` of the steps', or the ``"last"`` one
    :param success_reward: the reward from which on a rollout succeeds; None: the last step's
        ``info["is_success"]``, or no rollout does
    :param initial: set-point at which the naive trajectory rests, shape (D,), or a function of the
        first observation that returns it; None: the middle
    :param exploration_scale: standard deviation at which a search may begin, one value or one for
        each dimension; None: a tenth of the set-points' range
    :raises TaskError: spaces without bounds, discrete actions, values that do not fit
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        *,
        n_time_points: int | None = None,
        context: ContextSource | None = None,
        controller: Controller | Callable[[FloatArray, Any], ArrayLike] | None = None,
        low: ArrayLike | None = None,
        high: ArrayLike | None = None,
        returns: Return = "sum",
        success_reward: float | None = None,
        initial: ArrayLike | Callable[[Any], ArrayLike] | None = None,
        exploration_scale: ArrayLike | None = None,
    ) -> None:
        self.env = trajectory_arguments.check_env(env)
        self.metadata, self.render_mode = env.metadata, env.render_mode
        self._actions = check_action_space(env.action_space)
        self.source = first_observation(env) if context is None else context
        self.controller = as_controller(controller)
        if returns not in ("sum", "last"):
            raise TaskError(f"returns is {returns!r}; it must be 'sum' or 'last'.")
        self.returns, self.success_reward = returns, success_reward
        self.observation_space = self.source.space
        self.action_space = self._trajectory_space(
            trajectory_arguments.length(env, n_time_points), low, high
        )
        self._initial = initial
        if initial is not None and not callable(initial):
            self._initial = trajectory_arguments.rest(initial, self._space)
        tenth = (self._space.high.astype(np.float64) - self._space.low)[0] / 10
        self.exploration_scale = trajectory_arguments.scale(exploration_scale, tenth, "a set-point")
        self.context: Array | None = None
        self._first: Any = None  # observation of the episode that has not been stepped yet
        self._seeds: dict[bytes, int] = {}

    # -- what algorithms read --------------------------------------------------------------------

    @property
    def tells_achievement(self) -> bool:
        """Whether ``info`` may hold ``achieved_context``."""
        return self.source.achieved is not None

    @property
    def dt(self) -> float:
        """From one time point to the next, in s; 1 where the environment tells none."""
        return float(getattr(self.env.unwrapped, "dt", 1.0))

    def initial_trajectory(self) -> FloatArray:
        """Return the naive trajectory of the current episode, which rests, shape (T, D).

        :raises TaskError: there was no reset before, or the set-point does not fit
        """
        space = self._space
        rest = self._initial
        if callable(rest):
            if self._first is None:
                raise TaskError("there is no context yet: call reset() before step().")
            rest = rest(self._first)
        if rest is None:
            return (space.low.astype(np.float64) + space.high) / 2
        point = trajectory_arguments.rest(rest, space)
        return np.repeat(point[None], space.shape[0], axis=0)

    # -- episodes --------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start an episode: draw a context, or set it.

        :param seed: of the contexts that are drawn from now on
        :param options: ``{"context": c}`` sets this episode's context, shape (C,); all others are
            the environment's own
        :return: the context, shape (C,), and the environment's info
        :raises InvalidContextError: a context outside the context space, or one that cannot be set
        """
        options = dict(options or {})
        wanted = options.pop("context", None)
        super().reset(seed=seed)
        if wanted is not None:
            context = self.source.check(wanted)
            drawn = self._seed_of(context)
        else:
            context, drawn = None, int(self.np_random.integers(N_SEEDS))
        observation, info = self.env.reset(seed=drawn, options=options or None)
        if context is None:
            context = self.source.context(observation)
            self._seeds[context.tobytes()] = drawn
        if self.source.place is not None:  # drawn ones too: what is run is rounded as is observed
            observation = self.source.place(self.env, context.astype(np.float64))
            self._check_placed(context, observation)
        self.context, self._first = context, observation
        return context.copy(), info

    def _seed_of(self, context: Array) -> int:
        """Return the seed that leads to a context, or any, where it can be placed.

        :raises InvalidContextError: it cannot be set
        """
        if self.source.place is not None:
            return int(self.np_random.integers(N_SEEDS))
        if context.tobytes() not in self._seeds:
            raise InvalidContextError(
                f"the context {context.round(4).tolist()} cannot be set, since this environment "
                "has not drawn it before: give ContextSource(..., place=function) that puts the "
                "environment into a context."
            )
        return self._seeds[context.tobytes()]

    def _check_placed(self, context: Array, observation: Any) -> None:  # noqa: ANN401
        seen = np.asarray(self.source.read(observation), np.float64)
        if not np.allclose(seen, context, atol=1e-3):
            raise TaskError(
                f"place was asked for the context {context.round(4).tolist()}, but its observation "
                f"shows {seen.round(4).tolist()}: place must return the observation in the new "
                "state, of which read is to return the same context."
            )

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Follow a trajectory.

        :param action: shape (T, D); set-points outside the space are clipped
        :return: the context, the reward, True, False, and the rollout's info
        :raises InvalidTrajectoryError: wrong shape or non-finite value
        :raises TaskError: there was no reset since the last step
        """
        trajectory = self._check_trajectory(action)
        if self.context is None or self._first is None:
            raise TaskError("the episode has not begun: call reset() before each step().")
        observation, rewards, infos, executed, clipped = self._first, [], [], [], False
        for set_point in trajectory:
            wanted = np.asarray(self.controller.action(set_point, observation), np.float64)
            sent = self._send(wanted)
            clipped |= bool(np.any(sent != wanted.astype(sent.dtype)))
            observation, reward, terminated, truncated, info = self.env.step(sent)
            rewards.append(float(reward))
            infos.append(info)
            executed.append(self.controller.executed(set_point, sent, observation))
            if terminated or truncated:
                break
        told: dict[str, Any] = dict(infos[-1])
        told = {key: value for key, value in told.items() if not key.startswith("reward")}
        told |= self._told(rewards, infos, np.array(executed, np.float64), len(trajectory))
        achieved = self.source.achieved_context(self.context, observation)
        told |= {"clipped": clipped} | ({} if achieved is None else {"achieved_context": achieved})
        context, self._first = self.context, None
        return context.copy(), self._return(rewards), True, False, told

    def _send(self, wanted: FloatArray) -> Array:
        """Return the action as it is sent, inside the action space.

        :raises TaskError: the controller's action does not fit
        """
        space = self._actions
        if wanted.shape != space.shape or not np.isfinite(wanted).all():
            raise TaskError(
                f"the controller answered {wanted.tolist()}; an action is {space.shape[0]} finite "
                "numbers."
            )
        return np.clip(wanted, space.low, space.high).astype(space.dtype)

    def _told(
        self, rewards: list[float], infos: list[Mapping[str, Any]], executed: FloatArray, n: int
    ) -> dict[str, Any]:
        """Return what the rollout's info says of itself."""
        reward = self._return(rewards)
        rest = n - len(rewards)
        told: dict[str, Any] = self._terms(infos, reward)
        told["is_success"] = self._is_success(reward, infos[-1])
        told["n_steps"] = len(rewards)
        told["executed_trajectory"] = np.concatenate([executed, np.repeat(executed[-1:], rest, 0)])
        if self.returns == "sum":
            told["step_rewards"] = np.pad(np.array(rewards, np.float64), (0, rest))
        return told

    def _terms(self, infos: list[Mapping[str, Any]], reward: float) -> dict[str, Any]:
        """Return the reward's terms, if the environment tells some that add up to it."""
        names = [name for name in infos[-1] if name.startswith("reward_")]
        told = [{name: info.get(name, 0.0) for name in names} for info in infos]
        if not all(np.ndim(term) == 0 for terms in told for term in terms.values()):
            return {}
        terms = {name: self._return([float(each[name]) for each in told]) for name in names}
        return terms if np.isclose(sum(terms.values()), reward, atol=1e-6) else {}

    def _return(self, rewards: list[float]) -> float:
        return float(np.sum(rewards)) if self.returns == "sum" else rewards[-1]

    def _is_success(self, reward: float, info: Mapping[str, Any]) -> bool:
        if self.success_reward is not None:
            return reward >= self.success_reward
        return bool(info.get("is_success", False))

    def render(self) -> Any:  # noqa: ANN401
        """Return what the step-based environment draws; see there.

        With ``render_mode="rgb_array_list"`` these are the frames of the last rollout.
        """
        return self.env.render()

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process or a copy needs.

        Where EzPickle makes the step-based environment anew, the episode is not in the copy.
        """
        anew = isinstance(self.env.unwrapped, EzPickle)
        return self.__dict__ | ({"context": None, "_first": None} if anew else {})

    def close(self) -> None:
        """Close the step-based environment."""
        self.env.close()

    # -- checks ----------------------------------------------------------------------------------

    @property
    def _space(self) -> spaces.Box:
        return cast(spaces.Box, self.action_space)

    def _trajectory_space(
        self, n_time_points: int, low: ArrayLike | None, high: ArrayLike | None
    ) -> spaces.Box:
        if low is None and high is None and isinstance(self.controller, ActionController):
            low, high = self._actions.low, self._actions.high
        if low is None or high is None:
            raise TaskError(
                "low and high are missing: a controller's set-points are no actions, so say "
                "between which bounds, of shape (D,), they lie."
            )
        lows, highs = (
            np.repeat(each[None], n_time_points, axis=0).astype(np.float32)
            for each in trajectory_arguments.bounds(low, high)
        )
        return spaces.Box(lows, highs, dtype=np.float32)

    def _check_trajectory(self, trajectory: ArrayLike) -> FloatArray:
        space = self._space
        rule = f"finite numbers, of shape (T, D) = {space.shape}"
        checked = as_numbers("the trajectory", trajectory, rule, InvalidTrajectoryError)
        if checked.shape != space.shape or not np.isfinite(checked).all():
            raise InvalidTrajectoryError(
                f"the trajectory has shape {checked.shape} or holds a value that is not finite; it "
                f"must be of shape (T, D) = {space.shape}, all finite numbers."
            )
        return np.clip(checked, space.low, space.high)
