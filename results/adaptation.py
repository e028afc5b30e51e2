"""Adaptation to held-out contexts: numbers and tables of `results.protocols.Adaptation` runs.

A run is one numbered context and one seed. Targets between the demonstrated ones (interpolation)
and beyond them (extrapolation) are never mixed; contexts far from a set of demonstrations have a
table each.
"""

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from benchmark_envs import extrapolation, make_task
from results.aggregate import quantile
from results.notes import descriptions, failures, origins, rollouts_cell
from results.records import OUTCOME_COLUMNS, Record, outcome_row, rollouts_to_success
from results.text_table import NOT_APPLICABLE, Cell, Section, TextTable


@dataclass(frozen=True)
class Yardstick:
    """What adaptation on a task is measured by.

    :param checkpoints: rollouts at which the greedy error is reported
    :param published: rollouts that ACNMP needed in the thesis, or that it is given here
    :param unit: of the error, minus the reward
    """

    checkpoints: tuple[int, ...] = (0, 40, 80, 200)
    published: int = 130
    unit: str = ""


YARDSTICKS = {
    "nmp/Push-v0": Yardstick(unit="m²"),  # Table 5.1 of the thesis
    "nmp/Pouring-v0": Yardstick((0, 6, 12, 18), 18, "g"),  # Table 5.2
    "nmp/PickAndPlace-v0": Yardstick((0, 20, 50, 100), 100, "m"),
}
KINDS = ("extrapolation", "interpolation")  # of targets that are left out
COUNTS = tuple(sorted({n for y in [Yardstick(), *YARDSTICKS.values()] for n in y.checkpoints}))


def yardstick(task: str) -> Yardstick:
    """Return what adaptation on a task is measured by.

    :param task: its id
    """
    return YARDSTICKS.get(task, Yardstick())


def kind_of(target: int, extrapolation: bool | float) -> str:
    """Return the kind of a run's context: one of `KINDS`, or the context's number.

    >>> kind_of(9, True), kind_of(2, float("nan"))
    ('extrapolation', 'context 2')

    :param target: its number
    :param extrapolation: whether a left-out target lies beyond the others; NaN where contexts far
        from a set of demonstrations are numbered
    """
    if isinstance(extrapolation, float) and math.isnan(extrapolation):
        return f"context {target}"
    return KINDS[0] if extrapolation else KINDS[1]


def adaptation_frame(records: Iterable[Record]) -> pd.DataFrame:
    """Return one row a run: identity, outcome, rollouts to success and errors.

    ``greedy_rollouts`` counts the rollouts from which on the greedy trajectory succeeds (0 where
    the demonstrations are enough, infinity where it does not in the end), ``best_rollouts`` those
    to the first success of any rollout; ``error_<n>`` is minus the greedy reward after n rollouts,
    NaN where the run ends before or had no policy yet.

    :param records: of finished and failed runs
    """
    columns = [*OUTCOME_COLUMNS, "target", "kind", "greedy_rollouts", "best_rollouts"]
    names = [f"error_{count}" for count in COUNTS]
    return pd.DataFrame([_run_row(record) for record in records], columns=[*columns, *names])


def error_after(
    curve: Mapping[str, Sequence[Any]], rollouts: int, budget: int, column: str = "greedy_reward"
) -> float:
    """Return minus the reward that a run's first rollouts gave, NaN where there is none.

    >>> error_after({"rollouts": [0, 5, 20], "greedy_reward": [-3.0, -2.0, -1.0]}, 10, 20)
    2.0

    :param curve: of the run; a row holds until the next one
    :param rollouts: how many
    :param budget: of the run
    :param column: the greedy policy's reward, or ``"best_reward"``, the best rollout's
    """
    row = int(np.searchsorted(curve["rollouts"], rollouts, side="right")) - 1
    if row < 0 or rollouts > budget:
        return math.nan
    return -float(curve[column][row])


def summarise_adaptation(runs: pd.DataFrame, labels: Iterable[str] | None = None) -> pd.DataFrame:
    """Return one row a task, kind of context and algorithm, over all its contexts and seeds.

    Failed runs are counted in ``failed`` and in nothing else. An algorithm without a finished run
    has a ``reason`` and no numbers.

    :param runs: of `adaptation_frame`
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    labels = sorted(set(runs["label"])) if labels is None else list(labels)
    labels += sorted(set(runs["label"]) - set(labels))
    rows = []
    for task in sorted(set(runs["task"])):
        on_task = runs.loc[runs["task"] == task]
        for kind in sorted(set(on_task["kind"])):
            of_kind = on_task.loc[on_task["kind"] == kind]
            for label in labels:
                chosen = of_kind.loc[of_kind["label"] == label]
                rows.append({"task": task, "kind": kind, "label": label} | _summary(chosen, task))
    return pd.DataFrame(rows)


def adaptation_tables(
    runs: pd.DataFrame, labels: Sequence[str] | None = None
) -> tuple[list[TextTable], list[Section]]:
    """Return a table for each kind of context, and the notes below them.

    :param runs: of `adaptation_frame`
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    tables = []
    summary = summarise_adaptation(runs, labels)
    for task, kind in dict.fromkeys(zip(summary["task"], summary["kind"], strict=True)):
        measured = yardstick(task)
        unit = f" [{measured.unit}]" if measured.unit else ""
        header = (
            "algorithm",
            "runs",
            "rollouts",
            "solved",
            f"within {measured.published}",
            *(f"error{unit}\nat {count}" for count in measured.checkpoints),
            f"worst\nat {measured.checkpoints[-1]}",
            "time\n[s]",
        )
        chosen = runs.loc[(runs["task"] == task) & (runs["kind"] == kind)]
        shown = summary.loc[(summary["task"] == task) & (summary["kind"] == kind)]
        rows = tuple(_row(row, measured) for row in shown.to_dict("records"))
        tables.append(TextTable(_title(task, kind, chosen), header, rows))
    return tables, [
        ("Failed runs", failures(runs), "red"),
        ("Notes", [*NOTES, *descriptions(runs), *origins(runs)], "dim"),
    ]


NOTES = (
    "A run: demonstrations in other contexts, then rollouts in this one. Medians, with quartiles "
    "in parentheses, over contexts and seeds.",
    "rollouts: the count from which on the greedy policy, predict(context, deterministic=True), "
    "succeeds; 0 where the demonstrations are enough; a run that does not in the end counts as "
    "more than its budget. solved: runs that succeed at the end of their budget. within n: after "
    "at most that many rollouts, for good.",
    "error at n: minus the greedy policy's reward after n rollouts; runs whose budget is smaller, "
    "and algorithms that have no policy yet, are left out. worst: the largest of them. time: "
    "median seconds a run on one thread, training on demonstrations and rollouts included, greedy "
    "evaluations not.",
)


def _title(task: str, kind: str, runs: pd.DataFrame) -> str:
    """Return a table's title: which contexts it is about."""
    if kind in KINDS:
        targets = ", ".join(str(target) for target in sorted(set(runs["target"])))
        return f"{task}, {kind}: held-out targets {targets}"
    _, context = extrapolation(task, int(runs["target"].iloc[0]))
    names = make_task(task).context_names
    values = ", ".join(f"{name} {value:g}" for name, value in zip(names, context, strict=True))
    return f"{task}, {kind}: {values}"


def _run_row(record: Record) -> dict[str, Any]:
    specification = record["specification"]
    target = specification["target"]
    kind = kind_of(target, specification.get("extrapolation", math.nan))
    row = outcome_row(record) | {"target": target, "kind": kind}
    if record["outcome"] != "finished":
        return row
    curve = record["curve"]
    row["greedy_rollouts"] = rollouts_to_success(curve["rollouts"], curve["greedy_success"])
    row["best_rollouts"] = rollouts_to_success(curve["rollouts"], curve["any_success"])
    return row | {
        f"error_{count}": error_after(curve, count, row["budget"])
        for count in yardstick(specification["task"]).checkpoints
    }


def _summary(runs: pd.DataFrame, task: str) -> dict[str, Any]:
    finished = runs.loc[runs["outcome"] == "finished"]
    row: dict[str, Any] = {"runs": len(finished), "failed": len(runs) - len(finished)}
    if finished.empty:
        return row | {"reason": "not run" if runs.empty else "failed"}
    measured = yardstick(task)
    rollouts = finished["greedy_rollouts"].to_numpy(float)
    row |= {
        "reason": "",
        "budget": int(finished["budget"].max()),
        "solved": int(np.isfinite(rollouts).sum()),
        "solved_within_published": int((rollouts <= measured.published).sum()),
        "rollouts_worst": float(rollouts.max()),
        "training_seconds": quantile(finished["training_seconds"], 0.5),
    }
    errors = [f"error_{count}" for count in measured.checkpoints]
    for name in ("greedy_rollouts", "best_rollouts", *errors):
        values = finished[name].to_numpy(float)
        values = values[~np.isnan(values)]
        for end, q in (("median", 0.5), ("q25", 0.25), ("q75", 0.75)):
            row[f"{name}_{end}"] = quantile(values, q) if len(values) else math.nan
    last = finished[errors[-1]].to_numpy(float)
    row["error_worst"] = math.nan if np.isnan(last).all() else float(np.nanmax(last))
    return row


def _row(row: Mapping[Hashable, Any], measured: Yardstick) -> tuple[Cell, ...]:
    failed = f"{row['failed']} failed" if row["failed"] else ""
    head: tuple[Cell, ...] = ((row["label"], ""), (str(row["runs"]), failed))
    n_errors = len(measured.checkpoints) + 1
    if row["reason"]:
        return (*head, *((row["reason"], "") for _ in range(3 + n_errors)), (NOT_APPLICABLE, ""))
    counts = {end: row[f"greedy_rollouts_{end}"] for end in ("median", "q25", "q75")}
    return (
        *head,
        rollouts_cell(counts, row["budget"]),
        (f"{row['solved']:.0f}/{row['runs']}", ""),
        (f"{row['solved_within_published']:.0f}/{row['runs']}", ""),
        *(_error(row, f"error_{count}") for count in measured.checkpoints),
        (error_text(row["error_worst"]), ""),
        (f"{row['training_seconds']:.1f}", ""),
    )


def _error(row: Mapping[Hashable, Any], name: str) -> Cell:
    median, low, high = (row[f"{name}_{end}"] for end in ("median", "q25", "q75"))
    if math.isnan(median):
        return NOT_APPLICABLE, ""
    return error_text(median), f"({error_text(low)}–{error_text(high)})"


def error_text(error: float) -> str:
    """Return an error with two digits, or the whole ones of a large one.

    >>> error_text(0.01234), error_text(842.0), error_text(-0.0)
    ('0.012', '842', '0')

    :param error: at least 0
    """
    if math.isnan(error):
        return NOT_APPLICABLE
    return f"{abs(error):.0f}" if error >= 100 else f"{abs(error):.2g}"
