"""`Examined`: a task under examination, and what it is tried with.

Shape letters: N rollouts, T time points, D dimensions of the trajectory, C context.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from benchmark_envs.arguments import as_numbers
from benchmark_envs.exceptions import TaskContractError, TaskError
from benchmark_envs.rollouts import FloatArray, Rollouts
from benchmark_envs.task import Task


@dataclass(frozen=True)
class Examined:
    """A task, and contexts and trajectories to try it with.

    :param task: that is checked
    :param n_contexts: N
    :param seed: of contexts and trajectories
    """

    task: Task
    n_contexts: int
    seed: int

    @property
    def name(self) -> str:
        """The task's, in messages."""
        return type(self.task).__name__

    @cached_property
    def contexts(self) -> FloatArray:
        """As the task draws them, shape (N, C)."""
        rng = np.random.default_rng(self.seed)
        return np.stack([self.task.sample_context(rng) for _ in range(self.n_contexts)])

    @cached_property
    def trajectories(self) -> FloatArray:
        """Naive ones, bent at random, inside the space, shape (N, T, D)."""
        naive = np.stack([self.task.initial_trajectory(c.copy()) for c in self.contexts])
        rng, space = np.random.default_rng(self.seed), self.task.trajectory_space
        bends = rng.normal(0.0, self.task.exploration_scale, (len(naive), 1, naive.shape[2]))
        bump = np.sin(np.linspace(0.0, 2.0 * np.pi, naive.shape[1]))[:, None]
        return np.clip(naive + bump * bends, space.low, space.high)

    @cached_property
    def rollouts(self) -> Rollouts:
        """What comes of the trajectories, each in its context."""
        made = self.task.simulate(self.contexts, self.trajectories)
        require(
            isinstance(made, Rollouts),
            f"{self.name}.simulate returned a {type(made).__name__}; it must be Rollouts: override "
            "_execute rather than simulate.",
        )
        return made


def require(holds: object, sentence: str) -> None:
    """Raise unless a rule is kept.

    :param holds: whether it is
    :param sentence: the value, the rule, and the way out
    :raises TaskContractError: it is not
    """
    if not holds:
        raise TaskContractError(sentence)


def apply(rule: Callable[[Examined], None], it: Examined) -> None:
    """Ask a rule of a task; whatever else the task raises is told in a sentence.

    :param rule: one of `TASK_RULES`
    :param it: the task
    :raises TaskContractError: it breaks the rule, or raises another error
    """
    try:
        rule(it)
    except TaskContractError:
        raise
    except Exception as error:
        asked = (rule.__doc__ or rule.__name__).splitlines()[0]
        raise TaskContractError(
            f"{it.name} raised {type(error).__name__} ({error}) where this was asked of it: "
            f"{asked} Mend what raises it; the traceback above shows the line."
        ) from error


def numbers(value: object) -> FloatArray:
    """Return what a task declares as float64; nan where it is no array of numbers.

    :param value: of any kind
    """
    try:
        return as_numbers("it", cast(ArrayLike, value), "numbers")
    except TaskError:
        return np.array(np.nan)


def built_again(it: Examined, **threads: int) -> Task:
    """Return another task with the same settings.

    :param it: the task
    :param threads: ``n_threads``, or nothing
    """
    return type(it.task)(**it.task.settings, **threads)
