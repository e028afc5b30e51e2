"""Numbers of runs in one context: the greedy policy and the best rollout, side by side."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import pandas as pd

from results.harness.records import RunRecord
from results.report.frames import OUTCOME_COLUMNS, outcome_row, rollouts_to_success, summarise_by
from results.report.statistics import (
    interquartile_mean,
    interquartile_mean_interval,
    named,
    probability_of_improvement,
    quantile,
    quartiles,
    success_interval,
)

VIEWS = ("greedy", "best")  # what is measured: the greedy policy, the best rollout so far
COLUMNS = (
    *OUTCOME_COLUMNS,
    *(f"{view}_{what}" for view in VIEWS for what in ("solved", "rollouts", "reward")),
    "any_rollouts",
)


def frame(records: Sequence[RunRecord]) -> pd.DataFrame:
    """Return one row per run: identity, outcome, and where its curve ends.

    For each of `VIEWS`, ``<view>_solved`` tells whether it succeeds at the budget's end,
    ``<view>_rollouts`` after how many rollouts it did for good (infinity if not), and
    ``<view>_reward`` its last reward; ``any_rollouts`` counts the rollouts to the first success of
    any rollout.

    :param records: of finished and failed runs
    """
    return pd.DataFrame([_run_row(record) for record in records], columns=list(COLUMNS))


def summarise(runs: pd.DataFrame, labels: Iterable[str] | None = None) -> pd.DataFrame:
    """Return one row per task and algorithm: how well its runs ended, after how many rollouts.

    :param runs: of `frame`
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    return summarise_by(runs, ["task"], labels, _numbers)


def compare(runs: pd.DataFrame, reference: str) -> pd.DataFrame:
    """Return the probabilities that the reference's runs are better than each other algorithm's.

    Two of them: ``reward`` of the final greedy policy, and ``rollouts`` until it succeeds.

    :param runs: of `frame`
    :param reference: the label of the algorithm that is compared with the others
    """
    done = runs.loc[runs["outcome"] == "finished"]
    rows = []
    for task, on_task in sorted(done.groupby("task"), key=lambda group: str(group[0])):
        ours = on_task.loc[on_task["label"] == reference]
        others = sorted(set(on_task["label"]) - {reference})
        for label in others if len(ours) else []:
            theirs = on_task.loc[on_task["label"] == label]
            rows.append({"task": task, "reference": reference, "label": label}
                        | _better(ours, theirs))  # fmt: skip
    return pd.DataFrame(rows)


def _better(ours: pd.DataFrame, theirs: pd.DataFrame) -> dict[str, float]:
    row: dict[str, float] = {}
    for name, column, sign in (
        ("reward", "greedy_reward", 1.0),
        ("rollouts", "greedy_rollouts", -1.0),
    ):
        better = probability_of_improvement(sign * ours[column], sign * theirs[column])
        row |= named(name, ("p", "low", "high"), better)
    return row


def _run_row(record: RunRecord) -> dict[str, Any]:
    row = outcome_row(record)
    if not record.finished:
        return row
    curve = record.curve
    for view in VIEWS:
        rollouts = rollouts_to_success(curve["rollouts"], curve[f"{view}_success"])
        row[f"{view}_rollouts"] = rollouts
        row[f"{view}_solved"] = math.isfinite(rollouts)
        row[f"{view}_reward"] = curve[f"{view}_reward"][-1]
    return row | {"any_rollouts": rollouts_to_success(curve["rollouts"], curve["any_success"])}


def _numbers(done: pd.DataFrame) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for view in VIEWS:
        solved = int(done[f"{view}_solved"].to_numpy(bool).sum())
        rewards = done[f"{view}_reward"].to_numpy(float)
        row |= named(f"{view}_solved", ("low", "high"), success_interval(solved, len(done)))
        row |= quartiles(f"{view}_rollouts", done[f"{view}_rollouts"])
        row |= named(f"{view}_iqm", ("low", "high"), interquartile_mean_interval(rewards))
        row |= {
            f"{view}_solved": solved,
            f"{view}_reward_median": quantile(rewards, 0.5),
            f"{view}_iqm": interquartile_mean(rewards),
        }
    row |= quartiles("any_rollouts", done["any_rollouts"])
    return row | {"training_seconds": quantile(done["training_seconds"], 0.5)}
