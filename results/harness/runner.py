"""Runs a plan: in parallel processes, one result file per run, resumable."""

import tempfile
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import torch as th
from joblib import delayed

from results.harness.environments import RunTask
from results.harness.plugins import bring_in
from results.harness.processes import in_processes
from results.harness.protocol import OnRollouts
from results.harness.provenance import provenance
from results.harness.record_files import write_record
from results.harness.records import ErrorRecord, Provenance, Result, RunRecord, Seconds
from results.harness.resume import Plan, alone_in, clear, failed_path, finished_path
from results.harness.specification import RunSpecification


@dataclass(frozen=True)
class Outcome:
    """A run that has ended.

    :param run: its specification
    :param record: what its file holds
    """

    run: RunSpecification
    record: RunRecord


class RolloutCounters:
    """How many rollouts each run has done, in a file that the worker processes write to.

    Use it as a context manager, which removes the file in the end.

    :param n_runs: how many runs
    """

    def __init__(self, n_runs: int) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="nmp-bench-")
        self.path = Path(self._folder.name) / "rollouts"
        np.zeros(n_runs, np.int64).tofile(self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def total(self) -> int:
        """Return the rollouts of all runs together."""
        return int(np.fromfile(self.path, np.int64).sum())

    def writer(self, index: int) -> "CounterWriter":
        """Return what tells this object about one run's rollouts.

        :param index: of the run
        """
        return CounterWriter(self.path, index)


@dataclass(frozen=True)
class CounterWriter:
    """Picklable end of `RolloutCounters`.

    :param path: of the counters' file
    :param index: of the run
    """

    path: Path
    index: int

    def __call__(self, n_rollouts: int) -> None:
        """Store the run's number of rollouts so far.

        :param n_rollouts: since its start
        """
        with self.path.open("r+b") as file:
            file.seek(8 * self.index)
            file.write(np.int64(n_rollouts).tobytes())


def execute(run: RunSpecification, on_rollouts: OnRollouts | None = None) -> Result:
    """Do one run in this process.

    The times of the greedy evaluations and of the expert are not counted as training; those of
    the rollouts and of training on demonstrations are.

    :param run: what to run
    :param on_rollouts: told the number of rollouts so far
    """
    th.set_num_threads(1)
    bring_in(run.imports, run.task)
    algorithm = run.algorithm.load()
    setting = RunTask(
        run.task,
        run.seed,
        run.budget,
        run.algorithm.pretrained,
        run.task_settings,
        run.algorithm.shown_initial,
    )
    prepared = run.protocol.prepare(setting, on_rollouts)
    arguments = run.algorithm.arguments(prepared.demonstrations)
    start = time.perf_counter()
    model = algorithm("MlpPolicy", prepared.env, seed=run.seed, **arguments)
    model.learn(run.budget, callback=prepared.evaluation, progress_bar=False)
    total = time.perf_counter() - start
    prepared.env.close()
    evaluating = prepared.evaluation.seconds
    return Result(
        prepared.task,
        Seconds(total - evaluating, evaluating),
        prepared.evaluation.measured(),
        sees(model),
    )


def sees(model: object) -> tuple[str, ...] | None:
    """Return what an algorithm learns from, None where it does not say so.

    :param model: after its run
    """
    information = getattr(model, "information", None)
    return None if information is None else tuple(sorted(str(each) for each in information))


def run_and_write(
    run: RunSpecification,
    folder: Path,
    origin: Provenance,
    on_rollouts: OnRollouts | None = None,
) -> Outcome:
    """Do one run and write its file; an error is written down too and does not spread.

    :param run: what to run
    :param folder: of the runs
    :param origin: where the runs come from
    :param on_rollouts: told the number of rollouts so far
    """
    try:
        record = RunRecord(run.record, origin, "finished", execute(run, on_rollouts))
        write_record(finished_path(folder, run), record)
    except Exception as error:  # whatever an algorithm raises is this run's result
        why = ErrorRecord(type(error).__name__, str(error), traceback.format_exc())
        record = RunRecord(run.record, origin, "failed", error=why)
        write_record(failed_path(folder, run), record)
    if on_rollouts is not None:  # a run that failed or stopped early leaves nothing to wait for
        on_rollouts(run.budget)
    return Outcome(run, record)


def run_plan(
    plan: Plan, n_workers: int | None = None, counters: RolloutCounters | None = None
) -> Iterator[Outcome]:
    """Do the runs of a plan and yield each as soon as it has ended and its file is written.

    :param plan: what is to be done; earlier results of these runs are removed first
    :param n_workers: processes; one per core by default
    :param counters: told how many rollouts each run has done
    :raises BenchmarkError: another process does runs in the folder
    """
    plan.folder.mkdir(parents=True, exist_ok=True)
    with alone_in(plan.folder):
        clear(plan)
        origin = provenance()
        jobs = (
            delayed(run_and_write)(run, plan.folder, origin, counters and counters.writer(index))
            for index, run in enumerate(plan.todo)
        )
        yield from in_processes(jobs, len(plan.todo), n_workers)
