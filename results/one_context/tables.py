"""Tables of runs in one context."""

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import pandas as pd

from results.one_context.summary import OWN, VIEWS, compare, compare_in_contexts, summarise
from results.report.footnotes import (
    EXPECTED_NOTE,
    VERDICT_NOTE,
    expected_cell,
    page,
    rollouts_cell,
    verdict_text,
)
from results.report.own_answer import OWN_NOTE, SEES_NOTE, own_solved_cell, sees_cell
from results.report.text_table import NOT_APPLICABLE, Cell, Page, Section, TextTable, row_cells

COLUMNS = ("solved", "rollouts", "expected", "reward", "IQM")  # of each view
LAST = ("own answer\nsolved", "own answer\nreward", "sees", "time\n[s]")
HEADER = (*(f"{view}\n{column}" for view in VIEWS for column in COLUMNS), *LAST)
NOTES = (
    "greedy: the policy that the rollouts so far gave, predict(context, deterministic=True), run "
    "in a task of its own and not counted. best: the rollout of largest reward so far.",
    "solved: runs that succeed at the end of the budget, with the 95 % Wilson interval. rollouts: "
    "the count from which on they do, median (quartiles), unsolved runs beyond the budget. "
    f"{EXPECTED_NOTE} reward: "
    "at the end of the budget, median. IQM: interquartile mean of the same, with its 95 % "
    "bootstrap interval over seeds. time: median seconds per run on one thread, rollouts included, "
    "greedy evaluations not.",
    VERDICT_NOTE,
    OWN_NOTE,
    SEES_NOTE,
)


def tables(runs: pd.DataFrame, labels: Sequence[str] | None = None) -> Page:
    """Return a table for each task, comparisons with the first algorithm, and notes.

    :param runs: of `results.one_context.summary.frame`
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    made = []
    for task, summary in summarise(runs, labels).groupby("task"):
        on_task = runs.loc[runs["task"] == task]
        rows = tuple(_row(row) for row in summary.loc[summary["variant"] == ""].to_dict("records"))
        header, breaks = (*_head(on_task), *HEADER), (2 + len(COLUMNS),)
        made.append(TextTable(_title(str(task), on_task), header, rows, breaks))
        units = set(on_task["unit"].dropna()) - {""}
        made += [error_table(str(task), summary, _head(on_task), unit) for unit in units]
    reference = (list(labels or []) or sorted(set(runs["label"])))[0]
    return page(made, runs, NOTES, Section("Comparisons", comparisons(runs, reference)))


def error_table(task: str, summary: pd.DataFrame, head: tuple[str, str], unit: str) -> TextTable:
    """Return the mean errors at the end of the budget: of all runs, and of each variant.

    :param task: its id
    :param summary: of the task's runs
    :param head: of the first two columns
    :param unit: of minus the reward
    """
    variants = [str(variant) for variant in dict.fromkeys(summary["variant"])]
    views = (*VIEWS, OWN) if any(n > 0 for n in summary["own_runs"]) else VIEWS
    columns = [(view, variant) for view in views for variant in variants]
    cells = {
        (row["label"], row["variant"]): {view: _error(row, view) for view in views}
        for row in summary.to_dict("records")
    }
    rows = tuple(
        (
            *row_cells(row["label"], str(row["seeds"]), row["failed"]),
            *(cells[row["label"], variant][view] for view, variant in columns),
        )
        for row in summary.loc[summary["variant"] == ""].to_dict("records")
    )
    header = (*head, *(f"{view}\n{variant or 'all'}" for view, variant in columns))
    breaks = tuple(2 + i * len(variants) for i in range(1, len(views)))
    title = f"{task}, mean error at the end of the budget [{unit}], 95 % bootstrap interval"
    return TextTable(title, header, rows, breaks)


def _error(row: Mapping[Hashable, Any], view: str) -> Cell:
    """Return a mean error, and its interval."""
    if row["reason"]:
        return row["reason"], ""
    if view == OWN and not row["own_runs"]:
        return NOT_APPLICABLE, ""
    low, high = (0.0 - row[f"{view}_mean_{end}"] for end in ("high", "low"))  # -0 would show
    return f"{0.0 - row[f'{view}_mean']:.4f}", _interval(low, high)


def _interval(low: float, high: float) -> str:
    return "one seed" if math.isnan(low) else f"[{low:.4f},{high:.4f}]"


def _head(runs: pd.DataFrame) -> tuple[str, str]:
    """Return the header of the first two columns; with variants, a seed has several runs."""
    return "algorithm", "runs" if set(runs["variant"]) != {""} else "seeds"


def comparisons(runs: pd.DataFrame, reference: str) -> list[str]:
    """Return a line for each algorithm that the reference is compared with.

    :param runs: one row per run
    :param reference: the label of the algorithm that is compared with the others
    """
    return [
        f"{row['reference']} beats {row['label']} with probability "
        f"{_probability(row, 'reward')} in final greedy reward, "
        f"{_probability(row, 'rollouts')} in rollouts to success: "
        f"{verdict_text(row, 'reward')}, {verdict_text(row, 'rollouts')}."
        for row in compare(runs, reference).to_dict("records")
    ] + [
        f"{row['reference']}'s mean error minus {row['label']}'s in the {row['pairs']} contexts "
        f"that both were given: {_difference(row, 'greedy')} with the greedy policy, "
        f"{_difference(row, 'best')} with the best rollout."
        for row in compare_in_contexts(runs, reference).to_dict("records")
    ]


def _difference(row: Mapping[Hashable, Any], view: str) -> str:
    low, high = row[f"{view}_difference_low"], row[f"{view}_difference_high"]
    interval = "one seed" if math.isnan(low) else f"{low:+.4f} to {high:+.4f}"
    return f"{row[f'{view}_difference']:+.4f} {row['unit']} ({interval})"


def _row(row: Mapping[Hashable, Any]) -> tuple[Cell, ...]:
    head = row_cells(row["label"], str(row["seeds"]), row["failed"])
    if row["reason"]:
        n_cells = len(VIEWS) * len(COLUMNS)
        nothing = ((NOT_APPLICABLE, ""),) * len(LAST)
        return (*head, *(((row["reason"], ""),) * n_cells), *nothing)
    cells = (cell for view in VIEWS for cell in _cells(row, view))
    own = f"{row['own_reward_median']:.4f}" if row["own_runs"] else NOT_APPLICABLE
    seconds = f"{row['training_seconds']:.1f}".replace("nan", NOT_APPLICABLE)
    return (*head, *cells, own_solved_cell(row), (own, ""), sees_cell(row), (seconds, ""))


def _cells(row: Mapping[Hashable, Any], view: str) -> tuple[Cell, ...]:
    """Return the cells of `COLUMNS`, each as its main line and its spread."""
    percent = f"{100 * row[f'{view}_solved_low']:.0f}–{100 * row[f'{view}_solved_high']:.0f} %"
    counts = {end: row[f"{view}_rollouts_{end}"] for end in ("median", "q25", "q75")}
    low, high = row[f"{view}_iqm_low"], row[f"{view}_iqm_high"]
    interval = _interval(low, high)
    reward, mean = (f"{row[f'{view}_{name}']:.4f}" for name in ("reward_median", "iqm"))
    return (
        (f"{row[f'{view}_solved']:.0f}/{row['seeds']}", percent),
        rollouts_cell(counts, row["budget"]),
        expected_cell(row, f"{view}_expected"),
        (reward, ""),
        (mean, interval),
    )


def _probability(row: Mapping[Hashable, Any], name: str) -> str:
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    interval = "one seed" if math.isnan(low) else f"{low:.2f}–{high:.2f}"
    return f"{row[f'{name}_p']:.2f} ({interval})"


def _title(task: str, runs: pd.DataFrame) -> str:
    budgets = ", ".join(str(b) for b in sorted(set(runs["budget"])))
    return f"{task}, budget {budgets} rollouts"
