"""Tables of runs that adapt to one held-out context."""

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import pandas as pd

from results.adaptation.summary import errors_in, summarise
from results.report.footnotes import EXPECTED_NOTE, expected_cell, page, rollouts_cell
from results.report.own_answer import OWN_NOTE, SEES_NOTE, own_solved_cell, sees_cell
from results.report.text_table import NOT_APPLICABLE, Cell, Page, TextTable, row_cells

N_LAST = 4  # columns of which a row without runs says nothing: own answer, sees, time
NOTES = (
    "A run: demonstrations in other contexts, then rollouts in this one. Medians, with quartiles "
    "in parentheses, over contexts and seeds.",
    "rollouts: the count from which on the greedy policy, predict(context, deterministic=True), "
    "succeeds; 0 where the demonstrations are enough; a run that does not in the end counts as "
    "more than its budget. solved: runs that succeed at the end of their budget. within n: after "
    "at most that many rollouts, for good.",
    "error at n: minus the greedy policy's reward after n rollouts; runs whose budget is smaller, "
    "and algorithms that have no policy yet, are left out. worst: the largest of them. time: "
    "median seconds per run on one thread, training on demonstrations and rollouts included, "
    "greedy evaluations not.",
    f"{EXPECTED_NOTE} The contexts of one seed are not drawn apart.",
    OWN_NOTE,
    SEES_NOTE,
)


def tables(runs: pd.DataFrame, labels: Sequence[str] | None = None) -> Page:
    """Return a table for each kind of context, and the notes below them.

    :param runs: of `results.adaptation.summary.frame`
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    summary = summarise(runs, labels)
    made = []
    for task, kind in dict.fromkeys(zip(summary["task"], summary["kind"], strict=True)):
        chosen = runs.loc[(runs["task"] == task) & (runs["kind"] == kind)]
        shown = summary.loc[(summary["task"] == task) & (summary["kind"] == kind)]
        made.append(_table(task, kind, chosen, shown))
    return page(made, runs, NOTES)


def _table(task: str, kind: str, runs: pd.DataFrame, summary: pd.DataFrame) -> TextTable:
    """Return the table of one kind of context.

    :param runs: one row per run
    :param summary: one row per algorithm
    """
    units = [unit for unit in runs["unit"] if unit]
    unit = f" [{units[0]}]" if units else ""
    errors = errors_in(runs)
    counts = [name.removeprefix("error_") for name in errors]
    allowed = runs["budget"].max()
    published = [n for n in runs["published"] if pd.notna(n) and n <= allowed]
    header = (
        "algorithm",
        "runs",
        "rollouts",
        "expected",
        "solved",
        *(f"within {max(published):.0f}" for _ in published[:1]),
        *(f"error{unit}\nat {count}" for count in counts),
        *(f"worst\nat {count}" for count in counts[-1:]),
        "own answer\nsolved",
        f"own answer\nerror{unit}",
        "sees",
        "time\n[s]",
    )
    rows = tuple(
        _row(row, bool(published), errors, len(header)) for row in summary.to_dict("records")
    )
    return TextTable(f"{task}, {title(kind, runs)}", header, rows)


def title(kind: str, runs: pd.DataFrame) -> str:
    """Return which contexts are meant.

    :param kind: of the contexts
    :param runs: one row per run
    """
    contexts = sorted({context for context in runs["context"] if context})
    if len(contexts) == 1:
        return f"{kind}: {contexts[0]}"
    targets = ", ".join(str(target) for target in sorted(set(runs["target"])))
    return f"{kind}: held-out targets {targets}"


def _row(
    row: Mapping[Hashable, Any], published: bool, errors: Sequence[str], n_cells: int
) -> tuple[Cell, ...]:
    head = row_cells(row["label"], str(row["runs"]), row["failed"])
    if row["reason"]:
        nothing = ((NOT_APPLICABLE, ""),) * N_LAST
        return (*head, *(((row["reason"], ""),) * (n_cells - 2 - N_LAST)), *nothing)
    counts = {end: row[f"greedy_rollouts_{end}"] for end in ("median", "q25", "q75")}
    within = (f"{row['solved_within_published']:.0f}/{row['runs']}", "") if published else None
    return (
        *head,
        rollouts_cell(counts, row["budget"]),
        expected_cell(row, "expected"),
        (f"{row['solved']:.0f}/{row['runs']}", ""),
        *([within] if within else []),
        *(_error(row, name) for name in errors),
        *((error_text(row[f"{name}_worst"]), "") for name in errors[-1:]),
        own_solved_cell(row),
        _error(row, "own_error"),
        sees_cell(row),
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
