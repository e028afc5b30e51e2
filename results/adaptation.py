"""Adaptation to held-out targets: numbers and tables of `results.protocols.LeaveOneOut` runs.

A run is one target and one seed. Targets between the demonstrated ones (interpolation) and beyond
them (extrapolation) are never mixed.
"""

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from results.aggregate import quantile
from results.notes import descriptions, failures, origins, rollouts_cell
from results.records import OUTCOME_COLUMNS, Record, outcome_row, rollouts_to_success
from results.text_table import NOT_APPLICABLE, Cell, Section, TextTable

CHECKPOINTS = (0, 40, 80, 200)  # rollouts at which the greedy error is reported
PUBLISHED_ROLLOUTS = 130  # that ACNMP needed for extrapolation (thesis, Table 5.1)
KINDS = {"extrapolation": True, "interpolation": False}
ERRORS = tuple(f"error_{count}" for count in CHECKPOINTS)
UNITS = {"nmp/Push-v0": "m²"}  # of the error, by task


def adaptation_frame(records: Iterable[Record]) -> pd.DataFrame:
    """Return one row a run: identity, outcome, rollouts to success and errors.

    ``greedy_rollouts`` counts the rollouts from which on the greedy trajectory succeeds (0 where
    the demonstrations are enough, infinity where it does not in the end), ``best_rollouts`` those
    to the first success of any rollout; ``error_<n>`` is minus the greedy reward after n rollouts,
    NaN where the run ends before or had no policy yet.

    :param records: of finished and failed runs
    """
    columns = [*OUTCOME_COLUMNS, "target", "extrapolation", "greedy_rollouts", "best_rollouts"]
    return pd.DataFrame([_run_row(record) for record in records], columns=[*columns, *ERRORS])


def error_after(curve: Mapping[str, Sequence[Any]], rollouts: int, budget: int) -> float:
    """Return minus the greedy reward that a run's first rollouts gave, NaN where there is none.

    >>> error_after({"rollouts": [0, 5, 20], "greedy_reward": [-3.0, -2.0, -1.0]}, 10, 20)
    2.0

    :param curve: of the run; a row holds until the next one
    :param rollouts: how many
    :param budget: of the run
    """
    row = int(np.searchsorted(curve["rollouts"], rollouts, side="right")) - 1
    if row < 0 or rollouts > budget:
        return math.nan
    return -float(curve["greedy_reward"][row])


def summarise_adaptation(runs: pd.DataFrame, labels: Iterable[str] | None = None) -> pd.DataFrame:
    """Return one row a task, kind of target and algorithm, over all its targets and seeds.

    Failed runs are counted in ``failed`` and in nothing else. An algorithm without a finished run
    has a ``reason`` and no numbers.

    :param runs: of `adaptation_frame`
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    labels = sorted(set(runs["label"])) if labels is None else list(labels)
    labels += sorted(set(runs["label"]) - set(labels))
    rows = []
    for task in sorted(set(runs["task"])):
        for kind, extrapolation in KINDS.items():
            of_kind = runs.loc[(runs["task"] == task) & (runs["extrapolation"] == extrapolation)]
            for label in labels:
                chosen = of_kind.loc[of_kind["label"] == label]
                rows.append({"task": task, "kind": kind, "label": label} | _summary(chosen))
    return pd.DataFrame(rows)


def adaptation_tables(
    runs: pd.DataFrame, labels: Sequence[str] | None = None
) -> tuple[list[TextTable], list[Section]]:
    """Return a table for each kind of target, and the notes below them.

    :param runs: of `adaptation_frame`
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    tables = []
    summary = summarise_adaptation(runs, labels)
    for task, kind in dict.fromkeys(zip(summary["task"], summary["kind"], strict=True)):
        unit = f" [{UNITS[task]}]" if task in UNITS else ""
        header = (
            "algorithm",
            "runs",
            "rollouts",
            "solved",
            f"within {PUBLISHED_ROLLOUTS}",
            *(f"error{unit}\nat {count}" for count in CHECKPOINTS),
            "time\n[s]",
        )
        chosen = runs.loc[(runs["task"] == task) & (runs["extrapolation"] == KINDS[kind])]
        targets = ", ".join(str(target) for target in sorted(set(chosen["target"])))
        title = f"{task}, {kind}: held-out targets {targets or 'none'}"
        shown = summary.loc[(summary["task"] == task) & (summary["kind"] == kind)]
        rows = tuple(_row(row) for row in shown.to_dict("records"))
        tables.append(TextTable(title, header, rows))
    return tables, [
        ("Failed runs", failures(runs), "red"),
        ("Notes", [*NOTES, *descriptions(runs), *origins(runs)], "dim"),
    ]


NOTES = (
    "A run: demonstrations at all targets but one, then rollouts at that one. Medians, with "
    "quartiles in parentheses, over targets and seeds.",
    "rollouts: the count from which on the greedy policy, predict(context, deterministic=True), "
    "succeeds; 0 where the demonstrations are enough; a run that does not in the end counts as "
    "more than its budget. solved: runs that succeed at the end of their budget. "
    f"within {PUBLISHED_ROLLOUTS}: after at most that many rollouts, for good.",
    "error at n: minus the greedy policy's reward after n rollouts; runs whose budget is smaller, "
    "and algorithms that have no policy yet, are left out. time: median seconds a run on one "
    "thread, training on demonstrations and rollouts included, greedy evaluations not.",
)


def _run_row(record: Record) -> dict[str, Any]:
    specification = record["specification"]
    row = outcome_row(record) | {key: specification[key] for key in ("target", "extrapolation")}
    if record["outcome"] != "finished":
        return row
    curve = record["curve"]
    row["greedy_rollouts"] = rollouts_to_success(curve["rollouts"], curve["greedy_success"])
    row["best_rollouts"] = rollouts_to_success(curve["rollouts"], curve["any_success"])
    return row | {
        name: error_after(curve, count, row["budget"])
        for name, count in zip(ERRORS, CHECKPOINTS, strict=True)
    }


def _summary(runs: pd.DataFrame) -> dict[str, Any]:
    finished = runs.loc[runs["outcome"] == "finished"]
    row: dict[str, Any] = {"runs": len(finished), "failed": len(runs) - len(finished)}
    if finished.empty:
        return row | {"reason": "not run" if runs.empty else "failed"}
    rollouts = finished["greedy_rollouts"].to_numpy(float)
    row |= {
        "reason": "",
        "budget": int(finished["budget"].max()),
        "solved": int(np.isfinite(rollouts).sum()),
        "solved_within_published": int((rollouts <= PUBLISHED_ROLLOUTS).sum()),
        "rollouts_worst": float(rollouts.max()),
        "training_seconds": quantile(finished["training_seconds"], 0.5),
    }
    for name in ("greedy_rollouts", "best_rollouts", *ERRORS):
        values = finished[name].to_numpy(float)
        values = values[~np.isnan(values)]
        for end, q in (("median", 0.5), ("q25", 0.25), ("q75", 0.75)):
            row[f"{name}_{end}"] = quantile(values, q) if len(values) else math.nan
    return row


def _row(row: Mapping[Hashable, Any]) -> tuple[Cell, ...]:
    failed = f"{row['failed']} failed" if row["failed"] else ""
    head: tuple[Cell, ...] = ((row["label"], ""), (str(row["runs"]), failed))
    if row["reason"]:
        return (*head, *((row["reason"], "") for _ in range(3 + len(ERRORS))), (NOT_APPLICABLE, ""))
    counts = {end: row[f"greedy_rollouts_{end}"] for end in ("median", "q25", "q75")}
    return (
        *head,
        rollouts_cell(counts, row["budget"]),
        (f"{row['solved']:.0f}/{row['runs']}", ""),
        (f"{row['solved_within_published']:.0f}/{row['runs']}", ""),
        *(_error(row, name) for name in ERRORS),
        (f"{row['training_seconds']:.1f}", ""),
    )


def _error(row: Mapping[Hashable, Any], name: str) -> Cell:
    median, low, high = (row[f"{name}_{end}"] for end in ("median", "q25", "q75"))
    if math.isnan(median):
        return NOT_APPLICABLE, ""
    return f"{median:.2g}", f"({low:.2g}–{high:.2g})"
