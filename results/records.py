"""Result files: one JSON file a run, written in one go, and the data frames read from them.

A finished run is ``<stem>.json``, a failed one ``<stem>.failed.json``. Both hold the run's
``specification``, its ``provenance`` and its ``outcome``; a finished one the ``seconds`` spent, the
``curve`` (lists by column) and, by protocol, the last ``greedy`` rollout or the rollouts in each of
its ``contexts``; a failed one the ``error``.
"""

import json
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pandas as pd

from results.exceptions import BenchmarkError
from results.protocols import OneContext
from results.specification import RunSpecification

FORMAT = 1
OUTCOME_COLUMNS = (
    "task", "label", "seed", "budget", "outcome", "reason", "commit", "dirty", "training_seconds",
)  # fmt: skip
IDENTITY = ("label", "task", "seed", "target", "extrapolation")
VIEWS = ("greedy", "best")  # what is measured: the greedy policy, the best rollout so far
FAILED = ".failed.json"
# What a specification means that was written before these keys existed.
EARLIER = {"protocol": {"name": OneContext.name}, "own_budget": False}
Record = dict[str, Any]


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


def write_record(path: Path, record: Record) -> None:
    """Write a record whole or not at all.

    :param path: of the file
    :param record: JSON values
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        text = json.dumps({"format": FORMAT, **record}, allow_nan=False)
        temporary.write_text(text + "\n", encoding="utf-8")
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def read_record(path: Path) -> Record:
    """Read one run.

    :param path: of its file
    :raises BenchmarkError: it is not a run's file of this version
    """
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["format"] == FORMAT:
            return record | {"specification": EARLIER | record["specification"]}
        found = f"it has format {record['format']}"
    except (OSError, ValueError, TypeError, KeyError) as error:
        found = f"{type(error).__name__}: {error}"
    raise BenchmarkError(
        f"'{path}' is not a run of this version ({found}); a folder of runs holds JSON files of "
        f"format {FORMAT} that 'nmp-bench run' wrote. Remove it or name another folder."
    )


def read_records(folder: Path) -> list[Record]:
    """Read all runs of a folder, finished and failed, in the order of their files' names.

    :param folder: of the runs; none are found where it does not exist
    :raises BenchmarkError: a file is not a run's
    """
    return [read_record(path) for path in sorted(folder.glob("*.json"))]


def runs_frame(records: Iterable[Record]) -> pd.DataFrame:
    """Return one row a run: identity, outcome, and where its curve ends.

    For each of `VIEWS`, ``<view>_solved`` tells whether it succeeds at the budget's end,
    ``<view>_rollouts`` after how many rollouts it did for good (infinity if not), and
    ``<view>_reward`` its last reward; ``any_rollouts`` counts the rollouts to the first success of
    any rollout.

    :param records: of finished and failed runs
    """
    rows = [_run_row(record) for record in records]
    return pd.DataFrame(rows, columns=list(_run_columns()))


def curves_frame(records: Iterable[Record]) -> pd.DataFrame:
    """Return the curves of the finished runs, one row a step: `IDENTITY`, where it is, and curve.

    :param records: of finished and failed runs
    """
    frames = [
        pd.DataFrame(record["curve"]).assign(
            **{
                key: record["specification"][key]
                for key in IDENTITY
                if key in record["specification"]
            }
        )
        for record in records
        if record["outcome"] == "finished"
    ]
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame()


def rollouts_to_success(rollouts: Iterable[int], successes: Iterable[bool]) -> float:
    """Return the first count of rollouts from which on all entries are successes, else infinity.

    >>> rollouts_to_success([1, 2, 3, 4], [True, False, True, True])
    3.0
    >>> rollouts_to_success([1, 2], [True, False])
    inf

    :param rollouts: ascending counts
    :param successes: whether it succeeded at each
    """
    since = math.inf
    for count, success in zip(rollouts, successes, strict=True):
        since = min(since, float(count)) if success else math.inf
    return since


def outcome_row(record: Record) -> dict[str, Any]:
    """Return what a row of any protocol's data frame begins with.

    :param record: of a finished or failed run
    :return: `OUTCOME_COLUMNS`; ``reason`` tells why a run failed
    """
    specification, origin = record["specification"], record["provenance"]
    row = {key: specification[key] for key in ("task", "label", "seed", "budget")}
    row |= {"outcome": record["outcome"], "commit": origin["commit"], "dirty": origin["dirty"]}
    if record["outcome"] == "finished":
        return row | {"reason": "", "training_seconds": record["seconds"]["training"]}
    error = record["error"]
    reason = f"{error['type']}: {error['message']}"
    return row | {"reason": reason, "training_seconds": math.nan}


def _run_columns() -> Iterable[str]:
    yield from OUTCOME_COLUMNS
    yield from (f"{view}_{what}" for view in VIEWS for what in ("solved", "rollouts", "reward"))
    yield "any_rollouts"


def _run_row(record: Record) -> dict[str, Any]:
    row = outcome_row(record)
    if record["outcome"] != "finished":
        return row
    curve = record["curve"]
    for view in VIEWS:
        rollouts = rollouts_to_success(curve["rollouts"], curve[f"{view}_success"])
        row[f"{view}_rollouts"] = rollouts
        row[f"{view}_solved"] = math.isfinite(rollouts)
        row[f"{view}_reward"] = curve[f"{view}_reward"][-1]
    return row | {"any_rollouts": rollouts_to_success(curve["rollouts"], curve["any_success"])}
