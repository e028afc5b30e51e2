"""`Task`: physics and reward of a trajectory bandit, without state, a whole batch at a time.

Shape letters used everywhere: N rollouts, T time points, D dimensions of the trajectory,
C context.
"""

import inspect
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from benchmark_envs.exceptions import InvalidContextError, InvalidTrajectoryError, TaskError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Rollouts:
    """The outcome of a batch of N rollouts.

    :param contexts: task parameters, shape (N, C)
    :param trajectories: the set-points that were commanded, after clipping, shape (N, T, D)
    :param executed: what the robot really did at the same time points, shape (N, T, D)
    :param rewards: one reward a rollout, always finite, shape (N,)
    :param successes: whether the task was solved, shape (N,)
    :param diverged: whether the simulation broke down (the reward is then the worst), shape (N,)
    :param clipped: whether a set-point lay outside the trajectory space, or was not followed
        because the task limits the robot's speed, shape (N,)
    :param terms: the reward's terms by name, each of shape (N,); they add up to the reward
    :param paths: positions of moved objects by name, each of shape (N, T, 2 or 3) in m
    :param step_rewards: where the reward is a sum over time, its summands, shape (N, T)
    :param outcomes: what else happened, by name, such as 1.0 for an object that was dropped and
        0.0 for one that was not, each of shape (N,); they are no part of the reward
    """

    contexts: FloatArray
    trajectories: FloatArray
    executed: FloatArray
    rewards: FloatArray
    successes: BoolArray
    diverged: BoolArray
    clipped: BoolArray
    terms: dict[str, FloatArray] = field(default_factory=dict)
    paths: dict[str, FloatArray] = field(default_factory=dict)
    step_rewards: FloatArray | None = None
    outcomes: dict[str, FloatArray] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of rollouts, N."""
        return len(self.rewards)

    def __getitem__(self, index: int | slice | NDArray[Any]) -> "Rollouts":
        """Return the chosen rollouts; an integer gives a batch of one.

        :param index: an integer, a slice, or an array of indices or booleans
        """
        rows = [index] if isinstance(index, int | np.integer) else index
        return Rollouts(
            contexts=self.contexts[rows],
            trajectories=self.trajectories[rows],
            executed=self.executed[rows],
            rewards=self.rewards[rows],
            successes=self.successes[rows],
            diverged=self.diverged[rows],
            clipped=self.clipped[rows],
            terms={name: term[rows] for name, term in self.terms.items()},
            paths={name: path[rows] for name, path in self.paths.items()},
            step_rewards=None if self.step_rewards is None else self.step_rewards[rows],
            outcomes={name: outcome[rows] for name, outcome in self.outcomes.items()},
        )

    def info(self, index: int) -> dict[str, Any]:
        """Return one rollout as a Gymnasium ``info`` dictionary.

        :param index: which of the N rollouts
        :return: scalars ``is_success``, ``diverged``, ``clipped``, ``reward_<term>`` and the
            task's outcomes by their names, and the arrays ``executed_trajectory`` (T, D),
            ``path_<object>`` (T, 2 or 3) and, where the reward is a sum over time,
            ``step_rewards`` (T,)
        """
        info: dict[str, Any] = {
            "is_success": bool(self.successes[index]),
            "diverged": bool(self.diverged[index]),
            "clipped": bool(self.clipped[index]),
            "executed_trajectory": self.executed[index],
        }
        info |= {f"reward_{name}": float(term[index]) for name, term in self.terms.items()}
        info |= {name: float(outcome[index]) for name, outcome in self.outcomes.items()}
        if self.step_rewards is not None:
            info["step_rewards"] = self.step_rewards[index]
        return info | {f"path_{name}": path[index] for name, path in self.paths.items()}


class Task(ABC):
    """One trajectory-bandit task: spaces, physics, reward, expert. It keeps no state.

    A subclass sets the spaces in its constructor and implements the abstract methods; the checks
    of contexts and trajectories are made here, once for all.
    """

    #: what each entry of the context means, with its unit, length C
    context_names: ClassVar[tuple[str, ...]]
    #: what each dimension of the trajectory means, with its unit, length D
    trajectory_names: ClassVar[tuple[str, ...]]
    #: the names of the expert's ways to solve the task
    modes: ClassVar[tuple[str, ...]] = ("default",)

    #: standard deviation with which a search may well begin, by dimension, in the trajectory's
    #: unit, length D; every algorithm of a comparison explores at this scale by default
    exploration_scale: ClassVar[tuple[float, ...]]

    context_space: spaces.Box
    trajectory_space: spaces.Box

    @property
    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """The constructor's arguments: two tasks of one class with equal settings are the same."""

    @property
    @abstractmethod
    def reward_range(self) -> tuple[float, float]:
        """The worst and the best reward that a rollout can give; a diverged one gives the worst."""

    @abstractmethod
    def sample_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw a context.

        :param rng: the generator to draw from
        :return: shape (C,)
        """

    @abstractmethod
    def initial_trajectory(self, context: ArrayLike) -> FloatArray:
        """Return the naive trajectory from which a search starts.

        :param context: shape (C,)
        :return: shape (T, D)
        """

    @abstractmethod
    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Solve the task with the scripted expert.

        :param context: shape (C,)
        :param mode: one of ``modes``; the first one by default
        :return: shape (T, D)
        """

    @abstractmethod
    def _simulate(self, contexts: FloatArray, trajectories: FloatArray) -> Rollouts:
        """Run checked inputs of shapes (N, C) and (N, T, D)."""

    @abstractmethod
    def frames(
        self, context: ArrayLike, trajectory: ArrayLike, width: int = 480, height: int = 360
    ) -> list[NDArray[np.uint8]]:
        """Run one rollout and draw it.

        :param context: shape (C,)
        :param trajectory: shape (T, D)
        :param width: of the picture, in pixels
        :param height: of the picture, in pixels
        :return: pictures of shape (height, width, 3), 25 for each second of the rollout
        """

    def simulate(self, contexts: ArrayLike, trajectories: ArrayLike) -> Rollouts:
        """Execute a batch of trajectories, each in its context.

        Set-points outside ``trajectory_space`` are clipped to it, which ``clipped`` reports. So it
        does where a task limits the speed; ``executed`` shows what came of it.

        :param contexts: shape (N, C), or (C,) for one context shared by all
        :param trajectories: shape (N, T, D), or (T, D) for one rollout
        :return: the N rollouts
        :raises InvalidContextError: wrong shape, non-finite value, or outside the context space
        :raises InvalidTrajectoryError: wrong shape or non-finite value
        """
        trajectories = self.check_trajectories(trajectories)
        contexts = np.asarray(contexts, dtype=np.float64)
        if contexts.ndim == 1:
            contexts = np.broadcast_to(contexts, (len(trajectories), len(contexts)))
        if len(contexts) != len(trajectories):
            raise InvalidContextError(
                f"{len(contexts)} contexts were given for {len(trajectories)} trajectories: give "
                "one context for each trajectory, or a single one of shape (C,) for all."
            )
        contexts = np.stack([self.check_context(context) for context in contexts])
        low, high = self.trajectory_space.low, self.trajectory_space.high
        inside = np.clip(trajectories, low, high)
        rollouts = self._simulate(contexts, inside)
        rollouts.clipped[:] |= np.any(inside != trajectories, axis=(1, 2))
        return rollouts

    def check_context(self, context: ArrayLike) -> FloatArray:
        """Return the context as float64.

        :param context: shape (C,)
        :raises InvalidContextError: wrong shape, non-finite value, or outside the context space
        """
        checked = np.asarray(context, dtype=np.float64)
        names, space = ", ".join(self.context_names), self.context_space
        if checked.shape != space.shape:
            raise InvalidContextError(
                f"a context of {type(self).__name__} has shape {space.shape} ({names}), "
                f"not {checked.shape}."
            )
        outside = ~((checked >= space.low - 1e-6) & (checked <= space.high + 1e-6))
        if outside.any():
            i = int(np.argmax(outside))
            raise InvalidContextError(
                f"the context's entry {i} ({self.context_names[i]}) is {checked[i]:.6g}, but must "
                f"lie in [{space.low[i]:.6g}, {space.high[i]:.6g}]. The whole space: {names} in "
                f"{space.low.tolist()} to {space.high.tolist()}."
            )
        return checked

    def check_trajectories(self, trajectories: ArrayLike) -> FloatArray:
        """Return the trajectories as float64 of shape (N, T, D).

        :param trajectories: shape (N, T, D) or (T, D)
        :raises InvalidTrajectoryError: wrong shape or non-finite value
        """
        checked = np.asarray(trajectories, dtype=np.float64)
        shape = self.trajectory_space.shape
        if checked.ndim == 2:
            checked = checked[None]
        if checked.shape[1:] != shape:
            raise InvalidTrajectoryError(
                f"a trajectory of {type(self).__name__} has shape (T, D) = {shape} "
                f"({', '.join(self.trajectory_names)}) and a batch has (N, *{shape}), "
                f"not {np.shape(trajectories)}."
            )
        if not np.isfinite(checked).all():
            n, t, d = (int(i) for i in np.argwhere(~np.isfinite(checked))[0])
            raise InvalidTrajectoryError(
                f"trajectory {n} holds {checked[n, t, d]} at time point {t}, dimension {d} "
                f"({self.trajectory_names[d]}); every set-point must be a finite number."
            )
        return checked

    def check_mode(self, mode: str | None) -> str:
        """Return the expert's mode, the first one where none is named.

        :param mode: one of ``modes``
        :raises TaskError: no such mode
        """
        if mode is None:
            return self.modes[0]
        if mode not in self.modes:
            raise TaskError(f"no mode '{mode}' of the expert; there are {', '.join(self.modes)}.")
        return mode

    @classmethod
    def setting_names(cls) -> list[str]:
        """Return the names of the constructor's arguments."""
        return [name for name in inspect.signature(cls).parameters if name != "self"]
