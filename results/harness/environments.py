"""The tasks and environments of runs: one simulator thread each, as runs are done side by side."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

from benchmark_envs import Task, TaskError, TrajectoryVecEnv, make_task
from results.harness.records import TaskRecord
from sb3_nmp import Demonstrations

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class RunTask:
    """The task of a run, and what is made from it.

    :param task_id: of the task
    :param seed: of the run
    :param budget: of the run, in rollouts
    :param pretrained: whether its algorithm can answer before the first rollout
    :param settings: the task's constructor arguments
    :param shown_initial: whether the initial trajectory is all that is shown
    """

    task_id: str
    seed: int
    budget: int
    pretrained: bool = True
    settings: Mapping[str, Any] = field(default_factory=dict)
    shown_initial: bool = False

    @cached_property
    def task(self) -> Task:
        """The task, with one simulator thread."""
        return make_task(self.task_id, **self._single_threaded)

    @property
    def task_record(self) -> TaskRecord:
        """What the task says of itself."""
        task = self.task
        return TaskRecord(
            context_names=tuple(task.context_names),
            trajectory_names=tuple(task.trajectory_names),
            dt=task.dt,
            error_unit=task.error_unit,
            optimum=task.optimum,
        )

    def environments(self, context: FloatArray | None = None) -> VecEnv:
        """Return the run's environment; it is seeded by the algorithm, not here.

        :param context: to which it is pinned, shape (C,); None draws contexts
        """
        pinned = {} if context is None else {"context": context}
        return make_vec_env(
            self.task_id,
            vec_env_cls=TrajectoryVecEnv,
            env_kwargs={**self._single_threaded, **pinned},
        )

    def demonstrated(self, contexts: FloatArray) -> Demonstrations:
        """Return the expert's demonstrations; a process that does many runs makes them once.

        :param contexts: shape (K, C)
        """
        settings = json.dumps(self._single_threaded, sort_keys=True)
        return _demonstrated(self.task_id, settings, np.asarray(contexts, np.float64).tobytes())

    def initial(self, context: FloatArray) -> Demonstrations:
        """Return the initial trajectory, which every algorithm knows, as a demonstration.

        :param context: shape (C,)
        """
        return Demonstrations(context[None], self.task.initial_trajectory(context)[None])

    def expert(self, context: FloatArray) -> FloatArray | None:
        """Return the expert's trajectory, shape (T, D), None where the expert has none.

        :param context: shape (C,)
        """
        try:
            return self.demonstrated(context[None]).trajectories[0]
        except TaskError:
            return None

    @property
    def _single_threaded(self) -> dict[str, Any]:
        return {**self.settings, "n_threads": 1}


@lru_cache(maxsize=64)
def _demonstrated(task_id: str, settings: str, contexts: bytes) -> Demonstrations:
    task = make_task(task_id, **json.loads(settings))
    shape = (-1, *cast(tuple[int, ...], task.context_space.shape))
    return Demonstrations.from_task(task, np.frombuffer(contexts).reshape(shape))
