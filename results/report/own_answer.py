"""What an algorithm's model answers by itself, and what it was told: two columns of every table."""

import math
from collections.abc import Hashable, Iterable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from results.harness.records import RunRecord
from results.report.text_table import NOT_APPLICABLE, Cell

#: signs of what an algorithm may learn from (`sb3_nmp.TrajectoryAlgorithm.information`)
SIGNS = {
    "reward": "R",
    "success": "S",
    "terms": "T",
    "step rewards": "P",
    "achieved contexts": "A",
    "demonstrations": "D",
}
OWN_NOTE = (
    "own answer: what the model alone answers at the end of the budget, with no rollout "
    "remembered; – where there is no model, or where the record is from before this column."
)
SEES_NOTE = (
    "sees: what the algorithm learns from, where the task tells it: R reward, S success, T the "
    "reward's terms, P the reward step by step, A the context that a rollout achieved, D "
    "demonstrations (the initial trajectory where nothing else is shown)."
)


def own_row(record: RunRecord) -> dict[str, float]:
    """Return ``own_solved`` (0 or 1) and ``own_reward`` of a run, NaN where it has no own answer.

    :param record: of a finished run in one context
    """
    own = record.measured.rollouts.get("own")
    if own is None or own.reward is None:
        return {"own_solved": math.nan, "own_reward": math.nan}
    return {"own_solved": float(bool(own.success)), "own_reward": own.reward}


def own_numbers(done: pd.DataFrame) -> dict[str, int]:
    """Return in how many runs there is an own answer, and in how many of these it succeeds.

    :param done: finished runs, with the column ``own_solved``
    """
    solved = done["own_solved"].to_numpy(float)
    return {"own_runs": int(np.isfinite(solved).sum()), "own_solved": int(np.nansum(solved))}


def own_solved_cell(row: Mapping[Hashable, Any]) -> Cell:
    """Return n of N runs whose own answer succeeds.

    :param row: with `own_numbers`
    """
    if not row["own_runs"]:
        return NOT_APPLICABLE, ""
    return f"{row['own_solved']:.0f}/{row['own_runs']:.0f}", ""


def joined_information(told: Iterable[object]) -> str | None:
    """Return all that some runs' algorithm learns from, None where no record tells.

    >>> joined_information(["reward, success", "reward, terms", None])
    'reward, success, terms'

    :param told: of each run, as `information_text` gives it
    """
    known = {name for text in told if isinstance(text, str) for name in text.split(", ")}
    return information_text(known) if known else None


def information_text(names: Iterable[str]) -> str:
    """Return what an algorithm learns from in words, in the order of `SIGNS`.

    :param names: of `SIGNS`
    """
    order = list(SIGNS)
    return ", ".join(sorted(names, key=order.index))


def sees_cell(row: Mapping[Hashable, Any]) -> Cell:
    """Return what a row's algorithm learns from, as signs.

    >>> sees_cell({"sees": "reward, terms"})
    ('R T', '')

    :param row: of a summary
    """
    if not isinstance(row["sees"], str):
        return NOT_APPLICABLE, ""
    return " ".join(SIGNS[name] for name in row["sees"].split(", ")), ""
