"""Runs a plan: in parallel processes, one result file per run, resumable."""

import traceback
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch as th
from joblib import cpu_count, delayed

from results.exceptions import BenchmarkError
from results.harness.cluster import connected, on_cluster
from results.harness.counters import RolloutCounters
from results.harness.environments import RunTask
from results.harness.memory import return_memory
from results.harness.plugins import bring_in
from results.harness.processes import in_processes
from results.harness.protocol import OnRollouts
from results.harness.provenance import provenance
from results.harness.record_files import write_record
from results.harness.records import ErrorRecord, Provenance, Result, RunRecord, Seconds
from results.harness.resume import Plan, alone_in, clear, failed_path, finished_path
from results.harness.specification import RunSpecification
from sb3_nmp.common.lockstep import clock, n_met, together

Backend = Literal["processes", "ray"]


@dataclass(frozen=True)
class Outcome:
    """A run that has ended.

    :param run: its specification
    :param record: what its file holds
    """

    run: RunSpecification
    record: RunRecord


def setting_of(run: RunSpecification) -> RunTask:
    """Return what a run's protocol prepares it from.

    :param run: what to run
    """
    return RunTask(
        run.task,
        run.seed,
        run.budget,
        run.algorithm.pretrained,
        run.task_settings,
        run.algorithm.shown_initial,
    )


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
    prepared = run.protocol.prepare(setting_of(run), on_rollouts)
    arguments = run.algorithm.arguments(prepared.demonstrations)
    start = clock()
    model = algorithm("MlpPolicy", prepared.env, seed=run.seed, **arguments)
    model.learn(run.budget, callback=prepared.evaluation, progress_bar=False)
    total = clock() - start
    prepared.env.close()
    _check_spent(model, run)
    evaluating = prepared.evaluation.seconds
    return Result(
        prepared.task,
        Seconds(total - evaluating, evaluating),
        prepared.evaluation.measured(),
        sees(model),
        n_met(),
    )


def _check_spent(model: object, run: RunSpecification) -> None:
    """Raise if an algorithm took more rollouts than it was given: its curve would be no run's.

    :raises BenchmarkError: it did
    """
    spent = getattr(model, "num_timesteps", 0)
    if spent > run.budget:
        raise BenchmarkError(
            f"{run.algorithm.name} spent {spent} rollouts of {run.budget}: learn(total_timesteps) "
            "must never take more. sb3_nmp.check_algorithm tells what else learn must keep; "
            "results.agents shows how algorithms of Stable-Baselines3 are run."
        )


def sees(model: object) -> tuple[str, ...] | None:
    """Return what an algorithm learns from, None where it does not say so.

    :param model: after its run
    """
    information = getattr(model, "information", None)
    return None if information is None else tuple(sorted(str(each) for each in information))


def record_of(
    run: RunSpecification, origin: Provenance, on_rollouts: OnRollouts | None = None
) -> RunRecord:
    """Do one run; an error is recorded and does not spread.

    :param run: what to run
    :param origin: where the runs come from
    :param on_rollouts: told the number of rollouts so far
    """
    try:
        return RunRecord(run.record, origin, "finished", execute(run, on_rollouts))
    except Exception as error:  # whatever an algorithm raises is this run's result
        return _failed(run, origin, error)
    finally:
        return_memory()


def _failed(run: RunSpecification, origin: Provenance, error: BaseException) -> RunRecord:
    told = "".join(traceback.format_exception(error))
    why = ErrorRecord(type(error).__name__, str(error), told)
    return RunRecord(run.record, origin, "failed", error=why)


def written(run: RunSpecification, folder: Path, record: RunRecord) -> Outcome:
    """Write a run's file; one whose results are no JSON has failed.

    :param run: what was run
    :param folder: of the runs
    :param record: what came of it
    """
    path = finished_path(folder, run) if record.finished else failed_path(folder, run)
    try:
        write_record(path, record)
    except (TypeError, ValueError) as error:  # such as a reward that is not finite
        record = _failed(run, record.provenance, error)
        write_record(failed_path(folder, run), record)
    return Outcome(run, record)


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
    outcome = written(run, folder, record_of(run, origin, on_rollouts))
    if on_rollouts is not None:  # a run that failed or stopped early leaves nothing to wait for
        on_rollouts(run.budget)
    return outcome


def run_side_by_side(
    runs: Sequence[RunSpecification],
    folder: Path,
    origin: Provenance,
    on_rollouts: Sequence[OnRollouts | None],
) -> list[Outcome]:
    """Do runs of one algorithm in this process, their networks trained as one; write their files.

    :param runs: what to run
    :param folder: of the runs
    :param origin: where the runs come from
    :param on_rollouts: of each run, told its number of rollouts so far
    """
    th.set_num_threads(1)
    each = [
        partial(run_and_write, run, folder, origin, told)
        for run, told in zip(runs, on_rollouts, strict=True)
    ]
    return together(each) if len(each) > 1 else [each[0]()]


def groups(todo: Sequence[RunSpecification], most: int, n_workers: int) -> list[list[int]]:
    """Return the places of the runs that are done side by side, each in one group.

    They are of one algorithm on one task. There are as many groups as keep all workers busy, as
    equal as can be.

    :param todo: the runs
    :param most: how many runs a group has, at most
    :param n_workers: processes
    """
    alike: dict[object, list[int]] = defaultdict(list)
    for index, run in enumerate(todo):
        alike[run.label, run.task, run.variant, run.budget].append(index)
    found = []
    for places in alike.values():
        n_rounds = -(-len(places) // (most * n_workers))
        n_groups = min(len(places), n_rounds * n_workers)
        found += [part.tolist() for part in np.array_split(places, n_groups)]
    return sorted(found)


def record_on_node(asked: tuple[RunSpecification, Provenance]) -> RunRecord:
    """Do one run on a node of a cluster; versions and machine are the node's.

    :param asked: what to run, and where the runs come from
    """
    run, origin = asked
    here = provenance()
    if here.commit is None:  # the package is installed there, outside a repository
        here = replace(here, commit=origin.commit, dirty=origin.dirty)
    if (here.commit, here.dirty) != (origin.commit, origin.dirty):
        told = f"{here.commit}{' with changes' if here.dirty else ''}"
        return _failed(
            run,
            here,
            BenchmarkError(
                f"a node of the cluster has the commit {told}, and {origin.commit} was asked for: "
                "install that one there."
            ),
        )
    return record_of(run, here)


def run_plan(
    plan: Plan,
    n_workers: int | None = None,
    counters: RolloutCounters | None = None,
    backend: Backend = "processes",
    n_together: int = 1,
) -> Iterator[Outcome]:
    """Do the runs of a plan and yield each as soon as it has ended and its file is written.

    :param plan: what is to be done; earlier results of these runs are removed first
    :param n_workers: processes; one per core by default
    :param counters: told how many rollouts each run has done
    :param backend: where: in processes of this machine, or on a Ray cluster
    :param n_together: so many runs of one algorithm, at most, are done side by side in one
        process, where their networks are trained as one (`sb3_nmp.common.lockstep`)
    :raises BenchmarkError: another process does runs in the folder, there is no cluster, or runs
        are to be done side by side on one
    """
    if n_together > 1 and backend != "processes":
        raise BenchmarkError(
            f"--together is {n_together}, and --backend '{backend}' does each run by itself: leave "
            "one of them out."
        )
    plan.folder.mkdir(parents=True, exist_ok=True)
    with alone_in(plan.folder):
        if backend == "ray":
            with connected() as ray:  # before anything is removed
                clear(plan)
                yield from _on_cluster(ray, plan, n_workers, counters)
            return
        clear(plan)
        origin = provenance()
        beside = groups(plan.todo, n_together, n_workers or cpu_count())
        jobs = (
            delayed(run_side_by_side)(
                [plan.todo[index] for index in group],
                plan.folder,
                origin,
                [counters and counters.writer(index) for index in group],
            )
            for group in beside
        )
        for outcomes in in_processes(jobs, len(beside), n_workers):
            yield from outcomes


def _on_cluster(
    ray: Any,  # noqa: ANN401
    plan: Plan,
    n_workers: int | None,
    counters: RolloutCounters | None,
) -> Iterator[Outcome]:
    origin = provenance()
    asked = [(run, origin) for run in plan.todo]
    for index, found in on_cluster(ray, record_on_node, asked, n_workers):
        run = plan.todo[index]
        record = found if isinstance(found, RunRecord) else _failed(run, origin, found)
        if counters is not None:
            counters.writer(index)(run.budget)
        yield written(run, plan.folder, record)
