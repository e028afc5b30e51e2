"""`Task`: physics and reward of a trajectory bandit, without state, a whole batch at a time.

Shape letters used everywhere: N rollouts, T time points, D dimensions of the trajectory,
C context.
"""

import inspect
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from benchmark_envs.arguments import as_numbers
from benchmark_envs.exceptions import (
    InvalidContextError,
    InvalidTrajectoryError,
    RenderingUnavailableError,
    TaskError,
)
from benchmark_envs.rollouts import BoolArray, FloatArray, Measured, Rollouts, assemble

__all__ = ["BoolArray", "FloatArray", "Measured", "Rollouts", "Task", "unit_of"]


def unit_of(name: str) -> str:
    """Return the unit at the end of a name, empty where there is none.

    >>> unit_of("goal x [m]"), unit_of("phase")
    ('m', '')

    :param name: such as ``"goal x [m]"``
    """
    found = re.search(r"\[(.+)\]$", name)
    return found[1] if found else ""


class Task(ABC):
    """One trajectory-bandit task: spaces, physics, reward, expert. It keeps no state.

    A subclass declares names, spaces and time step, and returns from `_execute` what it measured.
    The rest is the same for all tasks and stands here: checks, clipping, divergence and the sum of
    the reward's terms. `MujocoTask` is the base of tasks that MuJoCo simulates.

    An argument of the constructor that changes the task is kept as an attribute of the same name.

    >>> from benchmark_envs import make_task
    >>> task = make_task("nmp/Bottles-v0")
    >>> task.settings, task.context_units, task.duration
    ({'random_bottles': False}, ('m', 'm', 'm', 'm'), 2.0)
    """

    #: what each entry of the context means, with its unit, length C
    context_names: tuple[str, ...]
    #: what each dimension of the trajectory means, with its unit, length D
    trajectory_names: ClassVar[tuple[str, ...]]
    #: the names of the expert's ways to solve the task
    modes: ClassVar[tuple[str, ...]] = ("default",)

    #: standard deviation with which a search may well begin, by dimension, in the trajectory's
    #: unit, length D; every algorithm of a comparison explores at this scale by default
    exploration_scale: ClassVar[tuple[float, ...]]

    #: what each term of the reward means, with its unit; ``diverged`` is added for every task
    reward_terms: Mapping[str, str]
    #: what an entry of `Rollouts.step_rewards` means; empty where the reward is no sum over time
    step_reward: str = ""
    #: unit of minus the reward, empty where it has none
    error_unit: str = ""
    #: name and reward of the best solution that is known, where one is
    optimum: tuple[str, float] | None = None

    #: whether it can say in which context a rollout would have been right
    tells_achievement: bool = False

    context_space: spaces.Box
    trajectory_space: spaces.Box
    #: from one time point to the next, in s
    dt: float

    @classmethod
    def setting_names(cls) -> tuple[str, ...]:
        """Return the names of the constructor's arguments that change the task."""
        names = inspect.signature(cls).parameters
        return tuple(name for name in names if name != "n_threads")

    @property
    def settings(self) -> dict[str, Any]:
        """The settings by name: two tasks of one class with equal settings are the same."""
        return {name: getattr(self, name) for name in self.setting_names()}

    @property
    def times(self) -> FloatArray:
        """When the set-points are reached, shape (T,) in s; the rollout begins at 0."""
        return self.dt * np.arange(1, self.trajectory_space.shape[0] + 1, dtype=np.float64)

    @property
    def duration(self) -> float:
        """How long a trajectory takes, in s."""
        return float(self.times[-1])

    @property
    def frames_per_second(self) -> float:
        """At how many pictures a second the film of `frames` is as fast as the rollout."""
        return 1.0 / self.dt

    @property
    def context_units(self) -> tuple[str, ...]:
        """The units of `context_names`."""
        return tuple(unit_of(name) for name in self.context_names)

    @property
    def trajectory_units(self) -> tuple[str, ...]:
        """The units of `trajectory_names`."""
        return tuple(unit_of(name) for name in self.trajectory_names)

    def metadata(self) -> dict[str, Any]:
        """Return what tables and figures say about the task, as plain JSON values."""
        n_time_points, n_dimensions = self.trajectory_space.shape
        diverged = {"diverged": "the worst reward, where the simulation broke down"}
        return {
            "context_names": list(self.context_names),
            "context_units": list(self.context_units),
            "trajectory_names": list(self.trajectory_names),
            "trajectory_units": list(self.trajectory_units),
            "n_time_points": n_time_points,
            "n_dimensions": n_dimensions,
            "dt": self.dt,
            "duration": self.duration,
            "modes": list(self.modes),
            "reward_terms": {**self.reward_terms, **diverged},
            "step_reward": self.step_reward,
            "error_unit": self.error_unit,
            "optimum": None if self.optimum is None else list(self.optimum),
        }

    def mode_of(self, context: ArrayLike, executed: ArrayLike) -> str:
        """Return which of ``modes`` an executed trajectory is an example of; empty: no telling.

        :param context: shape (C,)
        :param executed: shape (T, D)
        """
        return ""

    def scene(self, context: ArrayLike) -> dict[str, Any] | None:
        """Return what to draw around the paths of a planar task, as plain JSON values.

        Lengths are in m: ``limits`` [[x0, x1], [y0, y1]]; where there are any, ``points``, [x, y]
        by name; ``targets``, each an [x, y] that the path is to meet; ``circles`` with ``center``,
        ``radius``, ``style`` (``"solid"`` or ``"dashed"``) and ``label``; ``ellipses`` with
        ``center`` and ``radii`` along x and y; ``boxes`` with the corners ``low`` and ``high``. A
        trajectory of one dimension is drawn over the coordinate ``along``, of a ``name``, that it
        passes at uniform speed from ``low`` to ``high``.

        :param context: shape (C,)
        :return: None where the trajectory is no path in a plane
        """
        return None

    @property
    @abstractmethod
    def reward_range(self) -> tuple[float, float]:
        """The worst and the best reward that a rollout can give; a diverged one gives the worst."""

    @abstractmethod
    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw a context of the context space, shape (C,).

        :param rng: the generator to draw from
        """

    def sample_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw a context, rounded as `check_context` does.

        :param rng: the generator to draw from
        :return: shape (C,)
        """
        return self.check_context(self._draw_context(rng))

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
    def _execute(self, contexts: FloatArray, trajectories: FloatArray) -> Measured:
        """Execute checked and clipped inputs, and return what was measured.

        :param contexts: shape (N, C)
        :param trajectories: shape (N, T, D)
        """

    def frames(
        self,
        context: ArrayLike,
        trajectory: ArrayLike,
        width: int = 480,
        height: int = 360,
        camera: str | None = None,
    ) -> list[NDArray[np.uint8]]:
        """Run one rollout and draw it.

        ``frames_per_second`` of them are one second of the rollout.

        :param context: shape (C,)
        :param trajectory: shape (T, D)
        :param width: of the picture, in pixels
        :param height: of the picture, in pixels
        :param camera: by name, where the task has several; None takes the usual one
        :return: pictures of shape (height, width, 3)
        :raises RenderingUnavailableError: no off-screen renderer, or a task that cannot be drawn
        """
        raise self._no_pictures()

    def first_frame(
        self, context: ArrayLike, width: int = 480, height: int = 360
    ) -> NDArray[np.uint8]:
        """Draw how a rollout begins, shape (height, width, 3).

        :param context: shape (C,)
        :param width: of the picture, in pixels
        :param height: of the picture, in pixels
        :raises RenderingUnavailableError: no off-screen renderer, or a task that cannot be drawn
        """
        raise self._no_pictures()

    def _no_pictures(self) -> RenderingUnavailableError:
        return RenderingUnavailableError(
            f"{type(self).__name__} draws no pictures of its rollouts: leave out render_mode. "
            "Tasks that MuJoCo simulates draw, such as nmp/Bottles-v0; 'nmp-bench plot' draws the "
            "paths of runs."
        )

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
        rule = "numbers, of shape (N, C) or (C,), for at least one rollout"
        contexts = as_numbers("the context", contexts, rule, InvalidContextError)
        if contexts.ndim == 1:
            contexts = np.broadcast_to(contexts, (len(trajectories), len(contexts)))
        if not contexts.size or len(contexts) != len(trajectories):
            raise InvalidContextError(
                f"{len(contexts)} contexts were given for {len(trajectories)} trajectories: give "
                "one context for each trajectory, or a single one of shape (C,) for all."
            )
        contexts = np.stack([self.check_context(context) for context in contexts])
        low, high = self.trajectory_space.low, self.trajectory_space.high
        inside = np.clip(trajectories, low, high)
        outside = np.any(inside != trajectories, axis=(1, 2))
        measured = self._execute(contexts, inside)
        return assemble(contexts, inside, outside, measured, worst=self.reward_range[0])

    def check_context(self, context: ArrayLike) -> FloatArray:
        """Return the context as it is simulated: float64, but rounded to the nearest float32.

        An observation is float32, so that a context and what is observed of it are the same.

        :param context: shape (C,)
        :raises InvalidContextError: wrong shape, non-finite value, or outside the context space
        """
        names, space = ", ".join(self.context_names), self.context_space
        rule = f"{space.shape[0]} numbers ({names})"
        checked = as_numbers("the context", context, rule, InvalidContextError)
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
        return checked.astype(np.float32).astype(np.float64)

    def within_contexts(self, achieved: FloatArray, known: BoolArray) -> FloatArray:
        """Return achieved contexts, NaN where there is none or it lies outside the context space.

        :param achieved: shape (N, C)
        :param known: where something was achieved, shape (N,)
        """
        low, high = self.context_space.low, self.context_space.high
        inside = ((achieved >= low) & (achieved <= high)).all(axis=1)
        return np.where((known & inside)[:, None], achieved, np.nan)

    def check_trajectories(self, trajectories: ArrayLike) -> FloatArray:
        """Return the trajectories as float64 of shape (N, T, D).

        :param trajectories: shape (N, T, D) or (T, D)
        :raises InvalidTrajectoryError: wrong shape or non-finite value
        """
        shape = self.trajectory_space.shape
        rule = f"numbers, of shape (T, D) = {shape} or (N, *{shape})"
        checked = as_numbers("the trajectory", trajectories, rule, InvalidTrajectoryError)
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
