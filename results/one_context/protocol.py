"""`OneContext`: search a trajectory for one context."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from results.harness.environments import FloatArray, RunTask
from results.harness.greedy import GreedyEvaluation
from results.harness.protocol import OnRollouts, PreparedRun, Protocol
from results.harness.records import Curve


@dataclass(frozen=True)
class OneContext(Protocol):
    """Search a trajectory for one context, which the run's seed draws.

    Nothing is shown, or the initial trajectory to an algorithm that needs a demonstration.
    """

    name: ClassVar[str] = "one-context"

    def context(self, run: RunTask) -> FloatArray:
        """Return what the run's seed draws, shape (C,).

        :param run: its task and seed
        """
        return run.task.sample_context(np.random.default_rng(run.seed))

    def prepare(self, run: RunTask, on_rollouts: OnRollouts | None = None) -> PreparedRun:
        """Draw the context, and pin the environment to it.

        :param run: its task, seed and budget
        :param on_rollouts: told the number of rollouts so far
        """
        context = self.context(run)
        evaluation = GreedyEvaluation(run.task, context, on_rollouts)
        shown = run.initial(context) if run.shown_initial else None
        return PreparedRun(run.environments(context), evaluation, run.task_record, shown)

    def headline(self, curve: Curve) -> str:
        """Say whether the run solved its context, and its last greedy reward.

        :param curve: of its record
        """
        solved = "solved" if curve["greedy_success"][-1] else "not solved"
        return f"{solved}, greedy reward {curve['greedy_reward'][-1]:.4f}"
