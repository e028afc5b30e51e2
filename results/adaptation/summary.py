"""Numbers of runs that adapt to one held-out context.

A run is one numbered context and one seed. Contexts between the demonstrated ones (interpolation)
and beyond them (extrapolation) are never mixed.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from results.harness.records import RunRecord
from results.report.frames import OUTCOME_COLUMNS, outcome_row, rollouts_to_success, summarise_by
from results.report.own_answer import own_numbers, own_row
from results.report.statistics import expected_rollouts, named, quantile, quartiles

#: where a suite tells none
DEFAULT_CHECKPOINTS = (0, 40, 80, 200)
COLUMNS = ("target", "kind", "context", "unit", "published", "greedy_rollouts", "best_rollouts",
           "own_solved", "own_error")  # fmt: skip


def frame(records: Sequence[RunRecord]) -> pd.DataFrame:
    """Return one row per run: identity, outcome, rollouts to success and errors.

    ``greedy_rollouts`` counts the rollouts from which on the greedy trajectory succeeds (0 where
    the demonstrations are enough, infinity where it does not in the end), ``best_rollouts`` those
    to the first success of any rollout; ``error_<n>`` is minus the greedy reward after n rollouts,
    NaN where the run ends before or had no policy yet, for each checkpoint n of the suite.
    ``own_solved`` and ``own_error`` are those of the model's own answer in the end, NaN where there
    is none.

    :param records: of finished and failed runs
    """
    counts = sorted({count for record in records for count in checkpoints(record)})
    names = [f"error_{count}" for count in counts]
    columns = [*OUTCOME_COLUMNS, *COLUMNS, *names]
    return pd.DataFrame([_run_row(record) for record in records], columns=columns)


def checkpoints(record: RunRecord) -> tuple[int, ...]:
    """Return the rollouts at which a run's suite reports the greedy error.

    :param record: of the run
    """
    return record.specification.suite.checkpoints or DEFAULT_CHECKPOINTS


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


def summarise(runs: pd.DataFrame, labels: Iterable[str] | None = None) -> pd.DataFrame:
    """Return one row per task, kind of context and algorithm, over its contexts and seeds.

    :param runs: of `frame`
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    """
    return summarise_by(runs, ["task", "kind"], labels, _numbers, count="runs")


def errors_in(runs: pd.DataFrame) -> list[str]:
    """Return the columns of the errors that some of the runs tell, by count of rollouts.

    :param runs: of `frame`
    """
    names = [str(name) for name in runs if str(name).startswith("error_")]
    return [name for name in names if not np.isnan(runs[name].to_numpy(float)).all()]


def context_text(record: RunRecord) -> str:
    """Return a run's context in words, such as ``object height [m] 0.08``.

    :param record: of the run; a failed one says nothing
    """
    if not record.finished or record.measured.context is None:
        return ""
    pairs = zip(record.task.context_names, record.measured.context.values, strict=True)
    return ", ".join(f"{name} {value:g}" for name, value in pairs)


def _run_row(record: RunRecord) -> dict[str, Any]:
    asked = record.specification
    row = outcome_row(record) | {
        "target": asked.protocol.number,
        "kind": asked.protocol.kind,
        "context": context_text(record),
        "published": asked.suite.published,
        "unit": "",
    }
    if not record.finished:
        return row
    curve = record.curve
    row["unit"] = record.task.error_unit
    row["greedy_rollouts"] = rollouts_to_success(curve["rollouts"], curve["greedy_success"])
    row["best_rollouts"] = rollouts_to_success(curve["rollouts"], curve["any_success"])
    own = own_row(record)
    row |= {"own_solved": own["own_solved"], "own_error": -own["own_reward"]}
    return row | {
        f"error_{count}": error_after(curve, count, asked.budget) for count in checkpoints(record)
    }


def _numbers(done: pd.DataFrame) -> dict[str, Any]:
    rollouts = done["greedy_rollouts"].to_numpy(float)
    row: dict[str, Any] = {
        "solved": int(np.isfinite(rollouts).sum()),
        "rollouts_worst": float(rollouts.max()),
        "training_seconds": quantile(done["training_seconds"], 0.5),
    }
    expected = expected_rollouts(rollouts, done["budget"], done["seed"])
    row |= named("expected", ("rollouts", "low", "high"), expected)
    published = [count for count in done["published"] if pd.notna(count)]
    if published:
        row["solved_within_published"] = int((rollouts <= max(published)).sum())
    errors = [str(name) for name in done if str(name).startswith("error_")]
    row |= own_numbers(done)
    for name in ("greedy_rollouts", "best_rollouts", "own_error", *errors):
        row |= quartiles(name, done[name].to_numpy(float))
    for name in errors:
        known = done[name].to_numpy(float)
        row[f"{name}_worst"] = math.nan if np.isnan(known).all() else float(np.nanmax(known))
    return row
