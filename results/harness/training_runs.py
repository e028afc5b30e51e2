"""Runs that train networks and count no rollouts: a record each, resumed as those of suites are."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

import torch as th
from joblib import delayed

from results.exceptions import SettingsClashError
from results.harness.processes import in_processes
from results.harness.provenance import provenance
from results.harness.record_files import read_record, write_record
from results.harness.records import (
    Measurements,
    Provenance,
    Result,
    RunRecord,
    Seconds,
    SpecificationRecord,
    TaskRecord,
)


class TrainingRun(Protocol):
    """What is to be trained; a frozen dataclass of plain values."""

    @property
    def record(self) -> SpecificationRecord:
        """The specification as records keep it."""
        ...


T = TypeVar("T", bound=TrainingRun)
#: trains, and returns what was measured as JSON values
Measure = Callable[[T], dict[str, Any]]


def done(folder: Path, run: TrainingRun) -> bool:
    """Tell whether a folder holds a run.

    :param folder: of the runs
    :param run: which
    :raises SettingsClashError: it holds the run with other settings
    """
    path = folder / f"{run.record.stem}.json"
    if not path.exists():
        return False
    if read_record(path).specification != run.record:
        raise SettingsClashError(
            f"'{path}' was made with other settings than are asked for; name another folder "
            "(--out) or remove the file."
        )
    return True


def train_and_write(
    run: T, measure: Measure[T], task: TaskRecord, folder: Path, origin: Provenance
) -> str:
    """Do a run, write its record and return its name.

    :param run: which
    :param measure: does it
    :param task: what the record says of the task
    :param folder: of the runs
    :param origin: where the runs come from
    """
    th.set_num_threads(1)
    start = time.perf_counter()
    measured = Measurements({"rollouts": [0]}, more=measure(run))
    result = Result(task, Seconds(time.perf_counter() - start, 0.0), measured)
    path = folder / f"{run.record.stem}.json"
    write_record(path, RunRecord(run.record, origin, "finished", result))
    return run.record.name


def train_missing(
    folder: Path,
    runs: Sequence[T],
    measure: Measure[T],
    task: TaskRecord,
    n_workers: int | None,
    tell: Callable[[str], None],
) -> None:
    """Do the runs that a folder does not hold yet, in parallel processes.

    :param folder: of the runs
    :param runs: those wanted
    :param measure: does one
    :param task: what the records say of the task
    :param n_workers: processes; one per core by default
    :param tell: is told the name of each run that has ended
    :raises SettingsClashError: the folder holds one of them with other settings
    """
    todo = [run for run in runs if not done(folder, run)]
    folder.mkdir(parents=True, exist_ok=True)
    origin = provenance()
    jobs = (delayed(train_and_write)(run, measure, task, folder, origin) for run in todo)
    for name in in_processes(jobs, len(todo), n_workers):
        tell(name)
