"""Numbers of runs in one context: the greedy policy and the best rollout, side by side."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from results.harness.records import RunRecord
from results.report.frames import OUTCOME_COLUMNS, outcome_row, rollouts_to_success, summarise_by
from results.report.own_answer import own_numbers, own_row
from results.report.statistics import (
    expected_rollouts,
    holm,
    improvement_within,
    interquartile_mean,
    interquartile_mean_interval,
    mean_interval,
    named,
    permutation_p,
    quantile,
    quartiles,
    success_interval,
    verdict,
)

VIEWS = ("greedy", "best")  # what is measured: the greedy policy, the best rollout so far
OWN = "own"  # and, at the end of the budget alone, the model's own answer
#: what runs are compared by: a column, and 1 where more is better, -1 where less is
MEASURES = {"reward": ("greedy_reward", 1.0), "rollouts": ("greedy_rollouts", -1.0)}
COLUMNS = (
    *OUTCOME_COLUMNS,
    "unit",
    *(f"{view}_{what}" for view in VIEWS for what in ("solved", "rollouts", "reward")),
    "any_rollouts",
    "own_solved",
    "own_reward",
)


def frame(records: Sequence[RunRecord]) -> pd.DataFrame:
    """Return one row per run: identity, outcome, and where its curve ends.

    For each of `VIEWS`, ``<view>_solved`` tells whether it succeeds at the budget's end,
    ``<view>_rollouts`` after how many rollouts it did for good (infinity if not), and
    ``<view>_reward`` its last reward; ``any_rollouts`` counts the rollouts to the first success of
    any rollout. ``unit`` is that of minus the reward, where that is an error. ``own_solved`` and
    ``own_reward`` are those of the model's own answer, NaN where there is none.

    :param records: of finished and failed runs
    """
    return pd.DataFrame([_run_row(record) for record in records], columns=list(COLUMNS))


def summarise(runs: pd.DataFrame, labels: Iterable[str] | None = None) -> pd.DataFrame:
    """Return one row per task and algorithm: how well its runs ended, after how many rollouts.

    Where a task has variants, rows for each of them follow; ``variant`` is empty in the rows about
    all of them together.

    :param runs: of `frame`
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    shown = None if labels is None else list(labels)
    together = summarise_by(runs, ["task"], shown, _numbers)
    together.insert(1, "variant", "")
    varied = runs.loc[runs["variant"] != ""]
    if varied.empty:
        return together
    each = summarise_by(varied, ["task", "variant"], shown, _numbers)
    return pd.concat([together, each], ignore_index=True)


def compare_in_contexts(runs: pd.DataFrame, reference: str) -> pd.DataFrame:
    """Return the reference's error minus each other algorithm's, context by context.

    The mean difference over pairs of runs with the same task, variant and seed, and so the same
    context, with its 95 % bootstrap interval over these pairs. A column for each of `VIEWS`;
    ``pairs`` counts.

    :param runs: of `frame`
    :param reference: the label of the algorithm that is compared with the others
    """
    done = runs.loc[(runs["outcome"] == "finished") & (runs["unit"] != "")]
    rows = []
    for (task, unit), on_task in done.groupby(["task", "unit"]):
        ours = on_task.loc[on_task["label"] == reference]
        for label in sorted(set(on_task["label"]) - {reference}):
            theirs = on_task.loc[on_task["label"] == label]
            pairs = ours.merge(theirs, on=["variant", "seed"])
            if pairs.empty:
                continue
            row = {"task": task, "unit": unit, "reference": reference, "label": label}
            for view in VIEWS:
                differences = pairs[f"{view}_reward_y"] - pairs[f"{view}_reward_x"]
                row |= _mean(f"{view}_difference", differences.to_numpy(float))
            rows.append(row | {"pairs": len(pairs)})
    return pd.DataFrame(rows)


def compare(runs: pd.DataFrame, reference: str) -> pd.DataFrame:
    """Return the probabilities that the reference's runs are better than each other algorithm's.

    Two of them: ``reward`` of the final greedy policy, and ``rollouts`` until it succeeds. Each has
    a p-value, ``<name>_p_value``, corrected for all comparisons on the task by `holm`, and the
    ``<name>_verdict`` that follows. A variant is a stratum: seeds are dealt anew within it.

    :param runs: of `frame`
    :param reference: the label of the algorithm that is compared with the others
    """
    done = runs.loc[runs["outcome"] == "finished"]
    rows = []
    for task, on_task in sorted(done.groupby("task"), key=lambda group: str(group[0])):
        ours = on_task.loc[on_task["label"] == reference]
        others = sorted(set(on_task["label"]) - {reference})
        compared = [
            {"task": task, "reference": reference, "label": label}
            | _better(ours, on_task.loc[on_task["label"] == label])
            for label in (others if len(ours) else [])
        ]
        rows += _with_verdicts(compared)
    return pd.DataFrame(rows)


def _better(ours: pd.DataFrame, theirs: pd.DataFrame) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for name, (column, sign) in MEASURES.items():
        strata = [
            (_sorted(sign * mine[column]), _sorted(sign * yours[column]))
            for variant, mine in ours.groupby("variant")
            if len(yours := theirs.loc[theirs["variant"] == variant])
        ]
        row |= named(name, ("p", "low", "high"), improvement_within(strata))
        row[f"{name}_p_value"] = permutation_p(strata)
    return row


def _sorted(values: ArrayLike) -> NDArray[np.float64]:
    """Return values in an order of their own: that of the runs does not matter."""
    return np.sort(np.asarray(values, float))


def _with_verdicts(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a table's comparisons, their p-values corrected for each other, with verdicts."""
    keys = [(row, name) for row in rows for name in MEASURES]
    corrected = holm([row[f"{name}_p_value"] for row, name in keys])
    for (row, name), p in zip(keys, corrected, strict=True):
        row[f"{name}_p_value"] = float(p)
        row[f"{name}_verdict"] = verdict(row[f"{name}_p"], float(p))
    return rows


def _run_row(record: RunRecord) -> dict[str, Any]:
    row = outcome_row(record)
    if not record.finished:
        return row
    curve = record.curve
    row["unit"] = record.task.error_unit
    for view in VIEWS:
        rollouts = rollouts_to_success(curve["rollouts"], curve[f"{view}_success"])
        row[f"{view}_rollouts"] = rollouts
        row[f"{view}_solved"] = math.isfinite(rollouts)
        row[f"{view}_reward"] = curve[f"{view}_reward"][-1]
    row["any_rollouts"] = rollouts_to_success(curve["rollouts"], curve["any_success"])
    return row | own_row(record)


def _mean(name: str, values: NDArray[np.float64]) -> dict[str, float]:
    """Return the mean, and the ends of its 95 % bootstrap interval as ``<name>_low`` and so on."""
    interval = (float(end) for end in mean_interval(values))
    return {name: float(values.mean()), **named(name, ("low", "high"), interval)}


def _numbers(done: pd.DataFrame) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for view in VIEWS:
        solved = int(done[f"{view}_solved"].to_numpy(bool).sum())
        rewards = done[f"{view}_reward"].to_numpy(float)
        row |= named(f"{view}_solved", ("low", "high"), success_interval(solved, len(done)))
        row |= quartiles(f"{view}_rollouts", done[f"{view}_rollouts"])
        expected = expected_rollouts(done[f"{view}_rollouts"], done["budget"], done["seed"])
        row |= named(f"{view}_expected", ("rollouts", "low", "high"), expected)
        row |= named(f"{view}_iqm", ("low", "high"), interquartile_mean_interval(rewards))
        row |= _mean(f"{view}_mean", rewards)
        row |= {
            f"{view}_solved": solved,
            f"{view}_reward_median": quantile(rewards, 0.5),
            f"{view}_iqm": interquartile_mean(rewards),
        }
    row |= quartiles("any_rollouts", done["any_rollouts"])
    row |= own_numbers(done) | quartiles("own_reward", done["own_reward"])
    if row["own_runs"]:
        row |= _mean("own_mean", done["own_reward"].dropna().to_numpy(float))
    return row | {"training_seconds": quantile(done["training_seconds"], 0.5)}
