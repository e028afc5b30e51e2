"""The protocols: where a run takes place, what it is shown, and how it is evaluated."""

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

from benchmark_envs import Task, TrajectoryVecEnv, extrapolation, leave_one_out, make_task
from results.evaluation import Evaluation, GreedyEvaluation
from results.exceptions import BenchmarkError
from results.stream_evaluation import StreamEvaluation
from sb3_nmp.common.demonstrations import Demonstrations

if TYPE_CHECKING:
    from results.specification import RunSpecification

FloatArray = NDArray[np.float64]
OnRollouts = Callable[[int], None]

# Second words of the seeds of generators that must differ from the environment's, which has the
# run's seed alone: equal seeds would show the contexts of the stream beforehand.
DEMONSTRATION_CONTEXTS = 1
TEST_CONTEXTS = (0, 2)  # the same for all runs, whatever their seed


@dataclass(frozen=True)
class Scene:
    """All that a run needs besides its algorithm.

    :param env: where it collects rollouts
    :param evaluation: the callback that writes its curve
    :param demonstrations: what it is shown; None where it begins without
    """

    env: VecEnv
    evaluation: Evaluation
    demonstrations: Demonstrations | None = None


class Protocol(ABC):
    """How runs of one kind are done; a subclass is a frozen dataclass."""

    #: how result files name it
    name: ClassVar[str]

    @property
    def settings(self) -> dict[str, Any]:
        """What runs must share to be compared, as JSON values."""
        return {}

    @property
    def identity(self) -> dict[str, Any]:
        """What tells runs of one label, task and seed apart, as JSON values."""
        return {}

    @abstractmethod
    def prepare(self, run: "RunSpecification", on_rollouts: OnRollouts | None = None) -> Scene:
        """Build a run's environments, demonstrations and evaluation.

        :param run: the run
        :param on_rollouts: told the number of rollouts so far
        """

    @abstractmethod
    def headline(self, curve: Mapping[str, list[Any]]) -> str:
        """Say in a few words how a run ended.

        :param curve: of its record
        """


@dataclass(frozen=True)
class OneContext(Protocol):
    """Search a trajectory for one context, which the run's seed draws; nothing is shown."""

    name: ClassVar[str] = "one-context"

    def prepare(self, run: "RunSpecification", on_rollouts: OnRollouts | None = None) -> Scene:
        """See `Protocol.prepare`."""
        task, settings = single_threaded(run)
        context = task.sample_context(np.random.default_rng(run.seed))
        evaluation = GreedyEvaluation(task, context, on_rollouts)
        return Scene(_environments(run, settings, context), evaluation)

    def headline(self, curve: Mapping[str, list[Any]]) -> str:
        """See `Protocol.headline`."""
        solved = "solved" if curve["greedy_success"][-1] else "not solved"
        return f"{solved}, greedy reward {curve['greedy_reward'][-1]:.4f}"


class Adaptation(Protocol):
    """Adapt to one numbered context after demonstrations of others."""

    target: int

    @abstractmethod
    def split(self, task_id: str) -> tuple[FloatArray, FloatArray]:
        """Return the contexts to demonstrate, shape (K, C), and the one to adapt to, shape (C,).

        :param task_id: of the task
        """

    def prepare(self, run: "RunSpecification", on_rollouts: OnRollouts | None = None) -> Scene:
        """See `Protocol.prepare`."""
        task, settings = single_threaded(run)
        contexts, held_out = self.split(run.task)
        evaluation = GreedyEvaluation(
            task, held_out, on_rollouts, from_start=run.algorithm.pretrained, changes_only=True
        )
        demonstrations = demonstrated(run.task, plain_text(settings), contexts.tobytes())
        return Scene(_environments(run, settings, held_out), evaluation, demonstrations)

    def headline(self, curve: Mapping[str, list[Any]]) -> str:
        """See `Protocol.headline`."""
        solved = "solved" if curve["greedy_success"][-1] else "not solved"
        return f"{solved}, greedy error {0.0 - curve['greedy_reward'][-1]:.4f}"


@dataclass(frozen=True)
class LeaveOneOut(Adaptation):
    """Adapt to one of a task's numbered targets after demonstrations at all others (thesis 5.2.2).

    :param target: the number of the target that is held out
    :param extrapolation: whether it lies beyond the others, which tables keep apart
    """

    target: int
    extrapolation: bool

    name: ClassVar[str] = "leave-one-out"

    @property
    def identity(self) -> dict[str, Any]:
        """The target."""
        return {"target": self.target, "extrapolation": self.extrapolation}

    def split(self, task_id: str) -> tuple[FloatArray, FloatArray]:
        """See `Adaptation.split`."""
        return leave_one_out(task_id, self.target)


@dataclass(frozen=True)
class Extrapolation(Adaptation):
    """Adapt to a context far from a task's set of demonstrations (thesis 5.2.4).

    :param target: the number of the context
    """

    target: int

    name: ClassVar[str] = "extrapolation"

    @property
    def identity(self) -> dict[str, Any]:
        """The context's number."""
        return {"target": self.target}

    def split(self, task_id: str) -> tuple[FloatArray, FloatArray]:
        """See `Adaptation.split`."""
        return extrapolation(task_id, self.target)


@dataclass(frozen=True)
class Stream(Protocol):
    """Learn a policy for all contexts from a stream of new ones (thesis 5.2.2).

    :param n_demonstrations: contexts that are shown solved beforehand, drawn by the run's seed
    :param n_contexts: distinct contexts that the run may try; it ends where it asks for more
    :param n_test: held-out contexts on which the greedy policy is tried, the same for all runs
    :raises BenchmarkError: a number below 1
    """

    n_demonstrations: int = 30
    n_contexts: int = 1000
    n_test: int = 1000

    name: ClassVar[str] = "stream"

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, value in self.settings.items():
            if value < 1:
                raise BenchmarkError(f"{name} is {value}; a stream needs at least 1.")

    @property
    def settings(self) -> dict[str, Any]:
        """The three numbers."""
        return {
            "n_demonstrations": self.n_demonstrations,
            "n_contexts": self.n_contexts,
            "n_test": self.n_test,
        }

    def prepare(self, run: "RunSpecification", on_rollouts: OnRollouts | None = None) -> Scene:
        """See `Protocol.prepare`."""
        task, settings = single_threaded(run)
        drawn_by = np.random.default_rng([run.seed, DEMONSTRATION_CONTEXTS])
        demonstrations = Demonstrations.from_task(task, self.n_demonstrations, drawn_by)
        evaluation = StreamEvaluation(
            task,
            self.test_contexts(task),
            self.n_contexts,
            run.budget,
            on_rollouts,
            from_start=run.algorithm.pretrained,
        )
        return Scene(_environments(run, settings, None), evaluation, demonstrations)

    def test_contexts(self, task: Task) -> FloatArray:
        """Return the held-out contexts, shape (n_test, C).

        :param task: that draws them
        """
        rng = np.random.default_rng(TEST_CONTEXTS)
        return np.stack([task.sample_context(rng) for _ in range(self.n_test)])

    def headline(self, curve: Mapping[str, list[Any]]) -> str:
        """See `Protocol.headline`."""
        return (
            f"{100 * curve['failure_rate'][-1]:.1f} % fail after {curve['rollouts'][-1]} rollouts "
            f"in {curve['contexts'][-1]} contexts"
        )


def plain_text(settings: Mapping[str, Any]) -> str:
    """Return a task's settings as text that tells them apart.

    :param settings: the task's constructor arguments
    """
    return json.dumps(settings, sort_keys=True)


@lru_cache(maxsize=16)
def demonstrated(task_id: str, settings: str, contexts: bytes) -> Demonstrations:
    """Return a task's demonstrations; a process that does many runs makes them once.

    :param task_id: of the task
    :param settings: of the task, as `plain_text` gives them
    :param contexts: the bytes of float64 contexts, shape (K, C)
    """
    task = make_task(task_id, **json.loads(settings))
    shape = (-1, *cast(tuple[int, ...], task.context_space.shape))
    return Demonstrations.from_task(task, np.frombuffer(contexts).reshape(shape))


def single_threaded(run: "RunSpecification") -> tuple[Task, dict[str, Any]]:
    """Return a run's task and its settings, with a single simulator thread.

    :param run: the run
    :return: the task, and its constructor arguments
    """
    settings = {**run.task_settings, "n_threads": 1}
    return make_task(run.task, **settings), settings


def _environments(
    run: "RunSpecification", settings: Mapping[str, Any], context: FloatArray | None
) -> VecEnv:
    """Build a run's environments, pinned to a context (C,) unless it is None.

    They are not seeded here: an algorithm seeds them with the run's seed.
    """
    pinned = {} if context is None else {"context": context}
    return make_vec_env(
        run.task,
        n_envs=run.n_envs,
        vec_env_cls=TrajectoryVecEnv,
        env_kwargs={**settings, **pinned},
    )
