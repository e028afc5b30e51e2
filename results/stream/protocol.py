"""`Stream`: learn a policy for all contexts from a stream of new ones."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from benchmark_envs import Task
from results.exceptions import BenchmarkError
from results.harness.environments import FloatArray, RunTask
from results.harness.protocol import OnRollouts, PreparedRun, Protocol
from results.harness.records import Curve
from results.stream.evaluation import N_BY_ROLLOUTS, StreamEvaluation
from sb3_nmp import Demonstrations

# Second words of the seeds of generators that must differ from the environment's, which has the
# run's seed alone: equal seeds would show the contexts of the stream beforehand.
DEMONSTRATION_CONTEXTS = 1
TEST_CONTEXTS = (0, 2)  # the same for all runs, whatever their seed

#: which of the expert's modes are shown: its first one, or all of them in turn
Modes = Literal["first", "mixed"]


@dataclass(frozen=True)
class Stream(Protocol):
    """Learn a policy for all contexts from a stream of new ones (thesis 5.2.2).

    >>> Stream(n_demonstrations=0, n_test=100).settings["n_contexts"]
    1000

    :param n_demonstrations: contexts that are shown solved beforehand, drawn by the run's seed; 0
        shows nothing
    :param n_contexts: distinct contexts that the run may try; it ends where it asks for more
    :param n_test: held-out contexts on which the greedy policy is tried, the same for all runs
    :param n_evaluations: how often that is done, evenly on a logarithmic scale of rollouts: fewer
        where a rollout is slow, or trying the policy would take longer than training it
    :param modes: which of the expert's ways to solve the task are shown: ``"first"``, or
        ``"mixed"``, all of them in turn, untold which is which
    :raises BenchmarkError: a number that is too small, or other modes
    """

    n_demonstrations: int = 30
    n_contexts: int = 1000
    n_test: int = 1000
    n_evaluations: int = N_BY_ROLLOUTS
    modes: Modes = "first"

    name: ClassVar[str] = "stream"
    #: of the generator that draws the held-out contexts
    held_out_by: ClassVar[tuple[int, int]] = TEST_CONTEXTS

    def __post_init__(self) -> None:
        """Check the numbers and the modes."""
        if self.modes not in get_args(Modes):
            raise BenchmarkError(
                f"modes is {self.modes!r}; a stream shows {' or '.join(get_args(Modes))}."
            )
        for name, value in self._numbers.items():
            least = 0 if name == "n_demonstrations" else 1
            if value < least:
                raise BenchmarkError(f"{name} is {value}; a stream needs at least {least}.")

    @property
    def settings(self) -> Mapping[str, Any]:
        """The numbers, and what is not as it was in runs that did not have it yet."""
        settings: dict[str, Any] = dict(self._numbers)
        if self.n_evaluations == N_BY_ROLLOUTS:
            del settings["n_evaluations"]
        return settings | ({} if self.modes == "first" else {"modes": self.modes})

    @property
    def _numbers(self) -> dict[str, int]:
        return {
            "n_demonstrations": self.n_demonstrations,
            "n_contexts": self.n_contexts,
            "n_test": self.n_test,
            "n_evaluations": self.n_evaluations,
        }

    def prepare(self, run: RunTask, on_rollouts: OnRollouts | None = None) -> PreparedRun:
        """Demonstrate drawn contexts; the environment draws others.

        :param run: its task, seed and budget
        :param on_rollouts: told the number of rollouts so far
        """
        shown = self.demonstrations(run)
        evaluation = StreamEvaluation(
            run.task,
            self.test_contexts(run.task),
            self.n_contexts,
            run.budget,
            on_rollouts,
            from_start=run.pretrained and shown is not None,
            n_evaluations=self.n_evaluations,
        )
        return PreparedRun(run.environments(), evaluation, run.task_record, shown)

    def demonstrations(self, run: RunTask) -> Demonstrations | None:
        """Return what is shown beforehand; None where nothing is.

        :param run: its task and seed
        """
        if self.n_demonstrations == 0:
            return None
        drawn_by = np.random.default_rng([run.seed, DEMONSTRATION_CONTEXTS])
        modes = run.task.modes if self.modes == "mixed" else None
        return Demonstrations.from_task(run.task, self.n_demonstrations, drawn_by, modes)

    def test_contexts(self, task: Task) -> FloatArray:
        """Return the held-out contexts, shape (n_test, C).

        :param task: that draws them
        """
        rng = np.random.default_rng(self.held_out_by)
        return np.stack([task.sample_context(rng) for _ in range(self.n_test)])

    def headline(self, curve: Curve) -> str:
        """Say how many unseen contexts fail in the end, and what that took.

        :param curve: of its record
        """
        return (
            f"{100 * curve['failure_rate'][-1]:.1f} % fail after {curve['rollouts'][-1]} rollouts "
            f"in {curve['contexts'][-1]} contexts"
        )
