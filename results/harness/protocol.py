"""`Protocol`: where a run takes place, what it is shown, and how it is evaluated."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from stable_baselines3.common.vec_env import VecEnv

from results.harness.environments import FloatArray, RunTask
from results.harness.evaluation import Evaluation
from results.harness.records import Curve, TaskRecord
from sb3_nmp import Demonstrations

OnRollouts = Callable[[int], None]


@dataclass(frozen=True)
class PreparedRun:
    """All that a run needs besides its algorithm.

    :param env: where it collects rollouts
    :param evaluation: the callback that writes its curve
    :param task: what the task says of itself
    :param demonstrations: what it is shown; None where it begins without
    """

    env: VecEnv
    evaluation: Evaluation
    task: TaskRecord
    demonstrations: Demonstrations | None = None


class Protocol(ABC):
    """How runs of one kind are done; a subclass is a frozen dataclass."""

    #: how records name it
    name: ClassVar[str]

    @property
    def settings(self) -> Mapping[str, Any]:
        """What runs must share to be compared."""
        return {}

    @property
    def number(self) -> int | None:
        """The number of the run's context, where the protocol numbers them."""
        return None

    @property
    def kind(self) -> str:
        """The kind of that context; tables keep kinds apart."""
        return ""

    def context(self, run: RunTask) -> FloatArray | None:
        """Return the one context that a run takes place in, shape (C,); None where there are many.

        :param run: its task and seed
        """
        return None

    @abstractmethod
    def prepare(self, run: RunTask, on_rollouts: OnRollouts | None = None) -> PreparedRun:
        """Build a run's environments, demonstrations and evaluation.

        :param run: its task, seed and budget
        :param on_rollouts: told the number of rollouts so far
        """

    @abstractmethod
    def headline(self, curve: Curve) -> str:
        """Say in a few words how a run ended.

        :param curve: of its record
        """
