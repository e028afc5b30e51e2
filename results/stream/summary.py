"""Numbers of learning on a stream of contexts."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from results.harness.records import RunRecord
from results.report.frames import OUTCOME_COLUMNS, outcome_row, rollouts_to_success, summarise_by
from results.report.statistics import mean_interval, quantile, quartiles

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
    "own_failure_rate",
    "remembered",
)


def frame(records: Sequence[RunRecord]) -> pd.DataFrame:
    """Return one row per run: identity, outcome and `MEASURES`.

    ``first_failure_rate`` and ``failure_rate`` are the curve's ends (the former is that of the
    demonstrations alone where the algorithm learns from them beforehand), ``mean_reward`` its last,
    ``rollouts`` and ``contexts`` what was spent, ``retried`` the contexts that took more than one
    rollout, ``most_rollouts`` the rollouts in the one that took most, and ``rollouts_to_<rate>``
    those from which on the failure rate stays at or below a threshold (infinity if it does not).
    ``own_failure_rate`` is that of the model's own answers in the end, ``remembered`` the share of
    held-out contexts where the greedy answer is another one; NaN where there is no model.

    :param records: of finished and failed runs
    """
    columns = [*OUTCOME_COLUMNS, *MEASURES]
    return pd.DataFrame([_run_row(record) for record in records], columns=columns)


def summarise(runs: pd.DataFrame, labels: Iterable[str] | None = None) -> pd.DataFrame:
    """Return one row per task and algorithm, over its seeds.

    :param runs: of `frame`
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    return summarise_by(runs, ["task"], labels, _numbers)


def _run_row(record: RunRecord) -> dict[str, Any]:
    row = outcome_row(record)
    if not record.finished:
        return row
    curve, in_contexts = record.curve, record.measured.more["contexts"]["rollouts"]
    row |= {
        "first_failure_rate": curve["failure_rate"][0],
        "failure_rate": curve["failure_rate"][-1],
        "mean_reward": curve["mean_reward"][-1],
        "rollouts": curve["rollouts"][-1],
        "contexts": curve["contexts"][-1],
        "retried": sum(count > 1 for count in in_contexts),
        "most_rollouts": max(in_contexts),
    }
    own = record.measured.more.get("own")
    if own is not None:
        row |= {"own_failure_rate": own["failure_rate"], "remembered": own["remembered"]}
    for name, rate in THRESHOLDS.items():
        reached = [failing <= rate for failing in curve["failure_rate"]]
        row[f"rollouts_to_{name}"] = rollouts_to_success(curve["rollouts"], reached)
    return row


def _numbers(done: pd.DataFrame) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for name in ("first_failure_rate", "failure_rate", "mean_reward"):
        values = np.sort(done[name].to_numpy(float))  # their order does not matter
        low, high = mean_interval(values)
        row |= {
            f"{name}_mean": values.mean(),
            f"{name}_low": float(low),
            f"{name}_high": float(high),
        }
    for name in ("own_failure_rate", "remembered"):
        row[f"{name}_mean"] = done[name].astype(float).mean()  # NaN where no run has one
    for name in ("rollouts", "contexts", "retried", "training_seconds"):
        row[name] = quantile(done[name], 0.5)
    row["rollouts_max"] = int(done["rollouts"].to_numpy().max())
    row["most_rollouts"] = int(done["most_rollouts"].to_numpy().max())
    for name in THRESHOLDS:
        row |= quartiles(f"rollouts_to_{name}", done[f"rollouts_to_{name}"])
    return row
