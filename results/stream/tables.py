"""Tables of learning on a stream of contexts."""

import math
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import pandas as pd

from results.report.footnotes import page, rollouts_cell
from results.report.own_answer import OWN_NOTE, SEES_NOTE, sees_cell
from results.report.text_table import NOT_APPLICABLE, Cell, Page, TextTable, row_cells
from results.stream.summary import THRESHOLDS, summarise

HEADER = (
    "algorithm",
    "seeds",
    "fail first",
    "fail at the end",
    *(f"rollouts to\n{100 * rate:g} %" for rate in reversed(THRESHOLDS.values())),
    "rollouts\nin all",
    "contexts\n(retried)",
    "most in one\ncontext",
    "reward",
    "own answer\nfails",
    "sees",
    "time\n[s]",
)
N_LAST = 3  # columns of which a row without runs says nothing: own answer, sees, time
NOTES = (
    "A run: some contexts shown solved, then rollouts in a stream of new ones, until the budget "
    "or the contexts allowed are spent. fail: share of held-out contexts, the same for all runs, "
    "in which the greedy policy, predict(context, deterministic=True), fails: mean over seeds with "
    "its 95 % bootstrap interval. first: before the first rollout, where the algorithm has a "
    "policy by then, else at the first evaluation.",
    "rollouts to a rate: the evaluation from which on the failure rate stays at or below it, "
    "median (quartiles), runs that do not get there beyond the longest run. 9.06 % is the rate of "
    "the network that the original code's author stored, on apertures.",
    "rollouts in all, contexts and those that took more than one rollout: medians. most in one "
    "context: the largest of all runs. reward: of the held-out contexts at the end, mean. time: "
    "median seconds per run on one thread, training on demonstrations and rollouts included, "
    "evaluations not.",
    f"{OWN_NOTE} fails: the failure rate of these answers, mean; in parentheses, in how many of "
    "the held-out contexts the greedy policy answers with a remembered rollout instead. No rollout "
    "was made in these contexts, so 0 % is the rule; but where the task tells what rollouts "
    "achieved, a policy may repeat one that achieved what is asked.",
    SEES_NOTE,
)


def tables(runs: pd.DataFrame, labels: Sequence[str] | None = None) -> Page:
    """Return a table for each task, and the notes below.

    :param runs: of `results.stream.summary.frame`
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    made = [
        TextTable(
            f"{task}: share of unseen contexts that fail",
            HEADER,
            tuple(_row(row) for row in summary.to_dict("records")),
        )
        for task, summary in summarise(runs, labels).groupby("task")
    ]
    return page(made, runs, NOTES)


def _row(row: Mapping[Hashable, Any]) -> tuple[Cell, ...]:
    head = row_cells(row["label"], str(row["seeds"]), row["failed"])
    if row["reason"]:
        nothing = ((NOT_APPLICABLE, ""),) * N_LAST
        return (*head, *(((row["reason"], ""),) * (len(HEADER) - 2 - N_LAST)), *nothing)
    return (
        *head,
        failure_text(row, "first_failure_rate"),
        failure_text(row, "failure_rate"),
        *(_price(row, name) for name in reversed(THRESHOLDS)),
        (f"{row['rollouts']:.0f}", ""),
        (f"{row['contexts']:.0f}", f"({row['retried']:.0f})"),
        (f"{row['most_rollouts']:.0f}", ""),
        (f"{row['mean_reward_mean']:.3f}", ""),
        _own(row),
        sees_cell(row),
        (f"{row['training_seconds']:.0f}", ""),
    )


def _own(row: Mapping[Hashable, Any]) -> Cell:
    """Return how often the model's own answers fail, and how often memory answered instead."""
    failing, remembered = 100 * row["own_failure_rate_mean"], 100 * row["remembered_mean"]
    if math.isnan(failing):
        return NOT_APPLICABLE, ""
    return f"{failing:.1f} %", f"({remembered:.0f} %)"


def failure_text(row: Mapping[Hashable, Any], name: str) -> Cell:
    """Return a mean failure rate and its interval, in percent.

    :param row: of `results.stream.summary.summarise`
    :param name: which of its failure rates
    """
    mean, low, high = (100 * row[f"{name}_{end}"] for end in ("mean", "low", "high"))
    return f"{mean:.1f} %", "one seed" if math.isnan(low) else f"[{low:.1f},{high:.1f}]"


def _price(row: Mapping[Hashable, Any], name: str) -> Cell:
    counts = {end: row[f"rollouts_to_{name}_{end}"] for end in ("median", "q25", "q75")}
    return rollouts_cell(counts, row["rollouts_max"])
