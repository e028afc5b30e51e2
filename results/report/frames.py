"""From records to data frames, and from frames to one row per algorithm."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, cast

import pandas as pd

from results.harness.records import RunRecord, finished
from results.report.own_answer import information_text, joined_information

OUTCOME_COLUMNS = (
    "task", "variant", "label", "description", "seed", "budget", "outcome", "reason", "commit",
    "dirty", "training_seconds", "sees", "n_together",
)  # fmt: skip


def outcome_row(record: RunRecord) -> dict[str, Any]:
    """Return what a row of any protocol's data frame begins with: `OUTCOME_COLUMNS`.

    :param record: of a finished or failed run; ``reason`` tells why it failed
    """
    asked, origin = record.specification, record.provenance
    asked_for = ("task", "variant", "label", "description", "seed", "budget")
    row = {key: getattr(asked, key) for key in asked_for}
    row |= {"outcome": record.outcome, "commit": origin.commit, "dirty": origin.dirty}
    measured = record.seconds.training if record.finished else None
    training = math.nan if measured is None else measured
    told = record.sees if record.finished else None
    sees = None if told is None else information_text(told)
    row |= {"reason": record.reason, "training_seconds": training, "sees": sees}
    return row | {"n_together": record.n_together if record.finished else 1}


def curves_frame(records: Sequence[RunRecord]) -> pd.DataFrame:
    """Return the curves of the finished runs, one row per step, with what tells runs apart.

    :param records: of finished and failed runs
    """
    frames = [
        pd.DataFrame(record.curve).assign(
            label=record.specification.label,
            task=record.specification.task,
            variant=record.specification.variant,
            seed=record.specification.seed,
            target=record.specification.protocol.number,
            kind=record.specification.protocol.kind,
        )
        for record in finished(records)
    ]
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame()


def rollouts_to_success(rollouts: Iterable[int], successes: Iterable[bool]) -> float:
    """Return the first count of rollouts from which on all entries are successes, else infinity.

    >>> rollouts_to_success([1, 2, 3, 4], [True, False, True, True])
    3.0
    >>> rollouts_to_success([1, 2], [True, False])
    inf

    :param rollouts: ascending counts
    :param successes: whether it succeeded at each
    """
    since = math.inf
    for count, success in zip(rollouts, successes, strict=True):
        since = min(since, float(count)) if success else math.inf
    return since


def summarise_by(
    runs: pd.DataFrame,
    groups: Sequence[str],
    labels: Iterable[str] | None,
    numbers: Callable[[pd.DataFrame], dict[str, Any]],
    count: str = "seeds",
) -> pd.DataFrame:
    """Return one row per group and algorithm.

    Failed runs are counted in ``failed`` and in nothing else. An algorithm without a finished run
    has a ``reason`` and no numbers.

    :param runs: one row per run
    :param groups: columns that tell tables apart, such as ``task``
    :param labels: the algorithms in the order of the rows; those of ``runs`` by default
    :param numbers: of an algorithm's finished runs in a group
    :param count: the column that counts the finished runs
    """
    shown = sorted(set(runs["label"])) if labels is None else list(labels)
    shown += sorted(set(runs["label"]) - set(shown))
    rows = []
    for key, in_group in runs.groupby(list(groups), sort=True):
        where = dict(zip(groups, cast(tuple[str, ...], key), strict=True))
        for label in shown:
            chosen = in_group.loc[in_group["label"] == label]
            done = chosen.loc[chosen["outcome"] == "finished"]
            row = {**where, "label": label, count: len(done), "failed": len(chosen) - len(done)}
            if done.empty:
                row["reason"] = "not run" if chosen.empty else "failed"
            else:
                sees = joined_information(done["sees"])
                row |= {"reason": "", "budget": int(done["budget"].max()), "sees": sees}
                row |= numbers(done)
            rows.append(row)
    return pd.DataFrame(rows)
