"""The protocols of adaptation: `LeaveOneOut` and `Extrapolation`."""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from benchmark_envs import Rollouts, extrapolation, leave_one_out
from results.adaptation.shape import distance_from_shapes
from results.harness.environments import FloatArray, RunTask
from results.harness.greedy import DECIMALS, GreedyEvaluation
from results.harness.protocol import OnRollouts, PreparedRun, Protocol
from results.harness.records import Curve, Measurements, RolloutRecord
from sb3_nmp import Demonstrations

THINNED, DECIMALS_SHOWN = 4, 4  # of the demonstrations that records keep


class AdaptationEvaluation(GreedyEvaluation):
    """Keeps the rows that change something, and what there is to compare with demonstrations."""

    expert: FloatArray | None = None
    #: of the other contexts, whatever the algorithm was shown
    demonstrations: Demonstrations | None = None

    def measured(self) -> Measurements:
        """Return the curve, the first and last greedy rollout, and the expert's trajectory.

        ``more`` has ``rewards`` of all rollouts, one by one; what else happened in the greedy
        ones (``outcomes``), and their distance from the demonstrations' shape (``shapes``), by
        name; and ``shown``, the demonstrations at every fourth time point, for figures.
        """
        measured = super().measured()
        measured.more["rewards"] = [round(reward, DECIMALS) for reward in self.rewards]
        if self.expert is not None:
            shown = RolloutRecord(self.expert.round(DECIMALS).tolist())
            measured.rollouts["expert"] = shown
        if self.demonstrations is not None:
            measured.more.update(compared(self.rollouts, self.demonstrations.trajectories))
        return measured


def compared(rollouts: Mapping[str, Rollouts], shown: FloatArray) -> dict[str, Any]:
    """Return what a record holds of rollouts beside demonstrations.

    :param rollouts: batches of one, by name
    :param shown: the demonstrations, shape (N, T, D)
    """
    return {
        "outcomes": {
            name: {what: float(value[0]) for what, value in each.outcomes.items()}
            for name, each in rollouts.items()
        },
        "shapes": {
            name: round(distance_from_shapes(each.trajectories[0], shown), DECIMALS)
            for name, each in rollouts.items()
        },
        "shown": shown[:, ::THINNED].round(DECIMALS_SHOWN).tolist(),
    }


class Adaptation(Protocol):
    """Adapt to one numbered context after demonstrations of others."""

    target: int

    #: how its runs are evaluated
    evaluation: ClassVar[type[AdaptationEvaluation]] = AdaptationEvaluation

    @abstractmethod
    def split(self, task_id: str) -> tuple[FloatArray, FloatArray]:
        """Return the contexts to demonstrate, shape (K, C), and the one to adapt to, shape (C,).

        :param task_id: of the task
        """

    @property
    def number(self) -> int:
        """The number of the context to adapt to."""
        return self.target

    def context(self, run: RunTask) -> FloatArray:
        """Return the one that is held out, shape (C,).

        :param run: its task and seed
        """
        return self.split(run.task_id)[1]

    def prepare(self, run: RunTask, on_rollouts: OnRollouts | None = None) -> PreparedRun:
        """Demonstrate the other contexts, and pin the environment to the one to adapt to.

        To an algorithm that is to begin with the initial trajectory, that is shown instead.

        :param run: its task, seed and budget
        :param on_rollouts: told the number of rollouts so far
        """
        contexts, held_out = self.split(run.task_id)
        evaluation = self.evaluation(
            run.task, held_out, on_rollouts, from_start=run.pretrained, changes_only=True
        )
        evaluation.expert = run.expert(held_out)
        evaluation.demonstrations = run.demonstrated(contexts)
        environments = run.environments(held_out)
        shown = run.initial(held_out) if run.shown_initial else run.demonstrated(contexts)
        return PreparedRun(environments, evaluation, run.task_record, shown)

    def headline(self, curve: Curve) -> str:
        """Say whether the run solved its context, and its last greedy error.

        :param curve: of its record
        """
        solved = "solved" if curve["greedy_success"][-1] else "not solved"
        return f"{solved}, greedy error {0.0 - curve['greedy_reward'][-1]:.4f}"


@dataclass(frozen=True)
class LeaveOneOut(Adaptation):
    """Adapt to one of a task's numbered targets after demonstrations at all others (thesis 5.2.2).

    >>> LeaveOneOut(9, extrapolation=True).kind
    'extrapolation'

    :param target: the number of the target that is held out
    :param extrapolation: whether it lies beyond the others, which tables keep apart
    """

    target: int
    extrapolation: bool

    name: ClassVar[str] = "leave-one-out"

    @property
    def kind(self) -> str:
        """Whether the target lies beyond the others or between them."""
        return "extrapolation" if self.extrapolation else "interpolation"

    def split(self, task_id: str) -> tuple[FloatArray, FloatArray]:
        """Return the contexts of the other targets and of this one.

        :param task_id: of the task
        """
        return leave_one_out(task_id, self.target)


@dataclass(frozen=True)
class Extrapolation(Adaptation):
    """Adapt to a context far from a task's set of demonstrations (thesis 5.2.4).

    >>> shown, held_out = Extrapolation(0).split("nmp/PickAndPlace-v1")
    >>> shown.shape, held_out.shape
    ((8, 2), (2,))

    :param target: the number of the context
    """

    target: int

    name: ClassVar[str] = "extrapolation"

    @property
    def kind(self) -> str:
        """Each context is a kind of its own."""
        return f"context {self.target}"

    def split(self, task_id: str) -> tuple[FloatArray, FloatArray]:
        """Return the demonstrated contexts, and the one of this number.

        :param task_id: of the task
        """
        return extrapolation(task_id, self.target)
