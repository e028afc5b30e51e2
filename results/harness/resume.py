"""Which runs of a suite are still to be done, and whether a folder can take them."""

import fcntl
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from results.exceptions import BenchmarkError, SettingsClashError
from results.harness.record_files import FAILED, read_records
from results.harness.records import RunRecord, SpecificationRecord
from results.harness.specification import RunSpecification

SAME_IN_A_FOLDER = ("protocol",)
SAME_ON_A_TASK = ("budget",)
SAME_IN_A_VARIANT = ("task_settings",)
SAME_FOR_AN_ALGORITHM = ("algorithm", "settings", "own_budget")


@dataclass(frozen=True)
class Plan:
    """What is left to do in a folder.

    :param folder: of the runs
    :param todo: the runs to do
    :param kept: the runs that are finished already
    :param overwrite: whether finished runs are done again too
    :param unreadable: a sentence for each file of the folder that is no readable run
    :param missing: the runs that should be in these files; they are not done
    """

    folder: Path
    todo: tuple[RunSpecification, ...]
    kept: tuple[RunSpecification, ...]
    overwrite: bool = False
    unreadable: tuple[str, ...] = ()
    missing: tuple[RunSpecification, ...] = ()

    @property
    def n_asked(self) -> int:
        """All runs that were asked for."""
        return len(self.kept) + len(self.todo) + len(self.missing)


def finished_path(folder: Path, run: RunSpecification) -> Path:
    """Return where a finished run's record lies.

    :param folder: of the runs
    :param run: the run
    """
    return folder / f"{run.stem}.json"


def failed_path(folder: Path, run: RunSpecification) -> Path:
    """Return where a failed run's record lies.

    :param folder: of the runs
    :param run: the run
    """
    return folder / f"{run.stem}{FAILED}"


def plan_runs(folder: Path, runs: Iterable[RunSpecification], overwrite: bool = False) -> Plan:
    """Split runs into those to do and those that the folder holds; failed ones are tried again.

    :param folder: of the runs
    :param runs: those asked for
    :param overwrite: do finished ones again too
    :raises SettingsClashError: what would stay in the folder does not compare with these runs
    """
    runs = tuple(runs)
    stems = {run.stem for run in runs}
    held = read_records(folder)
    for record in held.records:
        replaced = overwrite or not record.finished
        if not (replaced and record.specification.stem in stems):
            check_comparable(folder, record, runs)
    kept, todo, missing = [], [], []
    for run in runs:
        damaged = {finished_path(folder, run), failed_path(folder, run)} & set(held.unreadable)
        if not overwrite and damaged:
            missing.append(run)
            continue
        done = not overwrite and finished_path(folder, run).exists()
        (kept if done else todo).append(run)
    why = tuple(held.unreadable.values())
    return Plan(folder, tuple(todo), tuple(kept), overwrite, why, tuple(missing))


def clear(plan: Plan) -> None:
    """Remove failed runs that are to be done again, and finished ones where these are, too.

    :param plan: what is to be done
    """
    for run in plan.todo:
        failed_path(plan.folder, run).unlink(missing_ok=True)
        if plan.overwrite:  # else it was not there when the plan was made
            finished_path(plan.folder, run).unlink(missing_ok=True)


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a folder of runs for this process alone; it is free again when the process ends.

    :param folder: of the runs; it must exist
    :raises BenchmarkError: another process does runs in it
    """
    held = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BenchmarkError(
                f"another process does runs in '{folder}' already; wait until it has ended, or "
                "name another folder (--out)."
            ) from error
        yield
    finally:
        os.close(held)


def check_comparable(folder: Path, record: RunRecord, runs: Iterable[RunSpecification]) -> None:
    """Check that a run that stays in the folder was made with the settings of those asked for.

    :param folder: of the runs
    :param record: a run that it holds
    :param runs: those asked for
    :raises SettingsClashError: a setting differs
    """
    held = record.specification
    for run in runs:
        wanted = run.record
        for key in _shared_keys(held, wanted):
            before, now = _compared(held, key), _compared(wanted, key)
            if before != now:
                name, before, now = _difference(key, before, now)
                raise SettingsClashError(
                    f"'{folder}' holds {held.name}, with {name} = {before}, but the run asked "
                    f"for ({run.name}) has {name} = {now}; a folder holds runs of one setting "
                    "only. Name another folder (--out), ask for the same value, or replace the "
                    "runs asked for (--overwrite)."
                )


def _shared_keys(held: SpecificationRecord, wanted: SpecificationRecord) -> tuple[str, ...]:
    """Return the settings in which two runs of a folder must agree."""
    if wanted.task != held.task:
        return SAME_IN_A_FOLDER
    shared = SAME_IN_A_FOLDER
    if wanted.variant == held.variant:
        shared += SAME_IN_A_VARIANT
    if wanted.label == held.label:
        return shared + SAME_ON_A_TASK + SAME_FOR_AN_ALGORITHM
    own_budget = wanted.own_budget or held.own_budget
    return shared if own_budget else shared + SAME_ON_A_TASK


def _compared(specification: SpecificationRecord, key: str) -> Any:  # noqa: ANN401
    """Return a setting as it is compared: of a protocol, its name and settings."""
    if key != "protocol":
        return getattr(specification, key)
    protocol = asdict(specification.protocol)
    return {"name": protocol["name"], **protocol["settings"]}


def _difference(key: str, held: Any, wanted: Any) -> tuple[str, Any, Any]:  # noqa: ANN401
    """Return what differs, as deep inside dictionaries as it can be named."""
    if isinstance(held, dict) and isinstance(wanted, dict):
        for inner in sorted({*held, *wanted}):
            before, now = held.get(inner, "its default"), wanted.get(inner, "its default")
            if before != now:
                return _difference(f"{key}.{inner}", before, now)
    return key, held, wanted
