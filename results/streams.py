"""Learning on a stream of contexts: numbers and tables of `results.protocols.Stream` runs."""

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from results.aggregate import CONFIDENCE, N_RESAMPLES, quantile
from results.notes import descriptions, failures, origins, rollouts_cell
from results.records import OUTCOME_COLUMNS, Record, outcome_row, rollouts_to_success
from results.text_table import NOT_APPLICABLE, Cell, Section, TextTable

# Failure rates whose price in rollouts is reported; the second is that of the network that the
# original code's author stored, tried by its criterion on 5000 new environments.
THRESHOLDS = {"0.02": 0.02, "0.0906": 0.0906}
MEASURES = (
    "first_failure_rate",
    "failure_rate",
    "mean_reward",
    "rollouts",
    "contexts",
    "retried",
    "most_rollouts",
    *(f"rollouts_to_{name}" for name in THRESHOLDS),
)


def stream_frame(records: Iterable[Record]) -> pd.DataFrame:
    """Return one row a run: identity, outcome and `MEASURES`.

    ``first_failure_rate`` and ``failure_rate`` are the curve's ends (the former is that of the
    demonstrations alone where the algorithm learns from them beforehand), ``mean_reward`` its last,
    ``rollouts`` and ``contexts`` what was spent, ``retried`` the contexts that took more than one
    rollout, ``most_rollouts`` the rollouts in the one that took most, and ``rollouts_to_<rate>``
    those from which on the failure rate stays at or below a threshold (infinity if it does not).

    :param records: of finished and failed runs
    """
    columns = [*OUTCOME_COLUMNS, *MEASURES]
    return pd.DataFrame([_run_row(record) for record in records], columns=columns)


def mean_interval(values: ArrayLike, seed: int = 0) -> tuple[NDArray[np.float64], ...]:
    """Return the ends of the 95 % percentile-bootstrap interval of the mean over the first axis.

    :param values: one row a run, shape (N, ...)
    :param seed: of the resampling
    :return: low and high of the shape of a row; NaN for a single run
    """
    rows = np.asarray(values, float)
    if len(rows) < 2:
        nothing = np.full(rows.shape[1:], np.nan)
        return nothing, nothing
    drawn = np.random.default_rng(seed).multinomial(
        len(rows), np.full(len(rows), 1 / len(rows)), N_RESAMPLES
    )
    means = np.tensordot(drawn / len(rows), rows, axes=1)
    tail = (1 - CONFIDENCE) / 2
    return np.quantile(means, tail, axis=0), np.quantile(means, 1 - tail, axis=0)


def summarise_stream(runs: pd.DataFrame, labels: Iterable[str] | None = None) -> pd.DataFrame:
    """Return one row a task and algorithm, over its seeds.

    Failed runs are counted in ``failed`` and in nothing else. An algorithm without a finished run
    has a ``reason`` and no numbers.

    :param runs: of `stream_frame`
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    labels = sorted(set(runs["label"])) if labels is None else list(labels)
    labels += sorted(set(runs["label"]) - set(labels))
    rows = []
    for task in sorted(set(runs["task"])):
        for label in labels:
            chosen = runs.loc[(runs["task"] == task) & (runs["label"] == label)]
            rows.append({"task": task, "label": label} | _summary(chosen))
    return pd.DataFrame(rows)


def stream_tables(
    runs: pd.DataFrame, labels: Sequence[str] | None = None
) -> tuple[list[TextTable], list[Section]]:
    """Return a table for each task, and the notes below.

    :param runs: of `stream_frame`
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    header = (
        "algorithm",
        "seeds",
        "fail first",
        "fail at the end",
        *(f"rollouts to\n{100 * rate:g} %" for rate in reversed(THRESHOLDS.values())),
        "rollouts\nin all",
        "contexts\n(retried)",
        "most in one\ncontext",
        "reward",
        "time\n[s]",
    )
    tables = [
        TextTable(
            f"{task}: share of unseen contexts that fail",
            header,
            tuple(_row(row) for row in summary.to_dict("records")),
        )
        for task, summary in summarise_stream(runs, labels).groupby("task")
    ]
    return tables, [
        ("Failed runs", failures(runs), "red"),
        ("Notes", [*NOTES, *descriptions(runs), *origins(runs)], "dim"),
    ]


NOTES = (
    "A run: some contexts shown solved, then rollouts in a stream of new ones, until the budget "
    "or the contexts allowed are spent. fail: share of held-out contexts, the same for all runs, "
    "in which the greedy policy, predict(context, deterministic=True), fails: mean over seeds with "
    "its 95 % bootstrap interval. first: before the first rollout, where the algorithm has a "
    "policy by then, else at the first evaluation.",
    "rollouts to a rate: the evaluation from which on the failure rate stays at or below it, "
    "median (quartiles), runs that do not get there beyond the longest run. 9.06 % is the rate of "
    "the network that the original code's author stored.",
    "rollouts in all, contexts and those that took more than one rollout: medians. most in one "
    "context: the largest of all runs. reward: of the held-out contexts at the end, mean. time: "
    "median seconds a run on one thread, training on demonstrations and rollouts included, "
    "evaluations not.",
)


def _run_row(record: Record) -> dict[str, Any]:
    row = outcome_row(record)
    if record["outcome"] != "finished":
        return row
    curve, in_contexts = record["curve"], record["contexts"]["rollouts"]
    row |= {
        "first_failure_rate": curve["failure_rate"][0],
        "failure_rate": curve["failure_rate"][-1],
        "mean_reward": curve["mean_reward"][-1],
        "rollouts": curve["rollouts"][-1],
        "contexts": curve["contexts"][-1],
        "retried": sum(count > 1 for count in in_contexts),
        "most_rollouts": max(in_contexts),
    }
    for name, rate in THRESHOLDS.items():
        reached = [failing <= rate for failing in curve["failure_rate"]]
        row[f"rollouts_to_{name}"] = rollouts_to_success(curve["rollouts"], reached)
    return row


def _summary(runs: pd.DataFrame) -> dict[str, Any]:
    finished = runs.loc[runs["outcome"] == "finished"]
    row: dict[str, Any] = {"seeds": len(finished), "failed": len(runs) - len(finished)}
    if finished.empty:
        return row | {"reason": "not run" if runs.empty else "failed"}
    row |= {"reason": "", "budget": int(finished["budget"].max())}
    for name in ("first_failure_rate", "failure_rate", "mean_reward"):
        values = np.sort(finished[name].to_numpy(float))  # their order does not matter
        low, high = mean_interval(values)
        row |= {
            f"{name}_mean": values.mean(),
            f"{name}_low": float(low),
            f"{name}_high": float(high),
        }
    for name in ("rollouts", "contexts", "retried", "training_seconds"):
        row[name] = quantile(finished[name], 0.5)
    row["rollouts_max"] = int(finished["rollouts"].max())
    row["most_rollouts"] = int(finished["most_rollouts"].max())
    for name in THRESHOLDS:
        for end, q in (("median", 0.5), ("q25", 0.25), ("q75", 0.75)):
            row[f"rollouts_to_{name}_{end}"] = quantile(finished[f"rollouts_to_{name}"], q)
    return row


def _row(row: Mapping[Hashable, Any]) -> tuple[Cell, ...]:
    failed = f"{row['failed']} failed" if row["failed"] else ""
    head: tuple[Cell, ...] = ((row["label"], ""), (str(row["seeds"]), failed))
    if row["reason"]:
        return (*head, *((row["reason"], "") for _ in range(8)), (NOT_APPLICABLE, ""))
    return (
        *head,
        failure_text(row, "first_failure_rate"),
        failure_text(row, "failure_rate"),
        *(_price(row, name) for name in reversed(THRESHOLDS)),
        (f"{row['rollouts']:.0f}", ""),
        (f"{row['contexts']:.0f}", f"({row['retried']:.0f})"),
        (f"{row['most_rollouts']:.0f}", ""),
        (f"{row['mean_reward_mean']:.3f}", ""),
        (f"{row['training_seconds']:.0f}", ""),
    )


def failure_text(row: Mapping[Hashable, Any], name: str) -> Cell:
    """Return a mean failure rate and its interval, in percent.

    :param row: of `summarise_stream`
    :param name: which of its failure rates
    """
    mean, low, high = (100 * row[f"{name}_{end}"] for end in ("mean", "low", "high"))
    return f"{mean:.1f} %", "one seed" if math.isnan(low) else f"[{low:.1f},{high:.1f}]"


def _price(row: Mapping[Hashable, Any], name: str) -> Cell:
    counts = {end: row[f"rollouts_to_{name}_{end}"] for end in ("median", "q25", "q75")}
    return rollouts_cell(counts, row["rollouts_max"])
