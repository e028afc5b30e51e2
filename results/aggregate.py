"""From runs to numbers: pure functions of the data frame that `results.records.runs_frame` gives.

The seed is the unit of replication: every interval is over seeds.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.stats import norm, trim_mean

from results.records import VIEWS

CONFIDENCE = 0.95
N_RESAMPLES = 5000
NO_INTERVAL = (float("nan"), float("nan"))


def wilson_interval(successes: int, n: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of a success rate.

    :param successes: how many of n
    :param n: at least 1
    """
    z = norm.ppf((1 + CONFIDENCE) / 2)
    rate, scale = successes / n, 1 / (1 + z**2 / n)
    middle = (rate + z**2 / (2 * n)) * scale
    half = z * np.sqrt(rate * (1 - rate) / n + z**2 / (4 * n**2)) * scale
    low = 0.0 if successes == 0 else middle - half
    high = 1.0 if successes == n else middle + half
    return float(low), float(high)


def quantile(values: ArrayLike, q: float) -> float:
    """Return a quantile of values that may be infinite, by linear interpolation.

    >>> quantile([30, 10, np.inf, 20], 0.5), quantile([10, np.inf], 0.5)
    (25.0, inf)

    :param values: shape (N,), N at least 1
    :param q: in [0, 1]
    """
    ordered = np.sort(np.asarray(values, float))
    position = q * (len(ordered) - 1)
    below = int(position)
    part = position - below
    if part == 0:
        return float(ordered[below])
    if np.isinf(ordered[below + 1]):
        return float(ordered[below + 1])
    return float(ordered[below] + part * (ordered[below + 1] - ordered[below]))


def interquartile_mean(values: ArrayLike) -> float:
    """Return the mean without the lowest and the highest quarter.

    :param values: shape (N,), N at least 1
    """
    return float(trim_mean(np.sort(np.asarray(values, float)), 0.25))


def interquartile_mean_interval(values: ArrayLike, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % percentile-bootstrap interval of the interquartile mean; NaN for one value.

    :param values: shape (N,)
    :param seed: of the resampling
    """
    ordered = np.sort(np.asarray(values, float))
    if len(ordered) < 2:
        return NO_INTERVAL
    draws = np.random.default_rng(seed).integers(0, len(ordered), (N_RESAMPLES, len(ordered)))
    return _central(trim_mean(ordered[draws], 0.25, axis=1))


def probability_of_improvement(
    values: ArrayLike, others: ArrayLike, seed: int = 0
) -> tuple[float, float, float]:
    """Return how often a run is better (larger) than another's, ties half; and a 95 % interval.

    The interval comes from a bootstrap over the runs of both; it is NaN where one has but one run.

    :param values: of one algorithm's runs, shape (N,)
    :param others: of the other's, shape (M,)
    :param seed: of the resampling
    """
    ours, theirs = np.sort(np.asarray(values, float)), np.sort(np.asarray(others, float))
    wins = (ours[:, None] > theirs) + 0.5 * (ours[:, None] == theirs)
    if min(wins.shape) < 2:
        return float(wins.mean()), *NO_INTERVAL
    rng = np.random.default_rng(seed)
    n_drawn = [rng.multinomial(n, np.full(n, 1 / n), N_RESAMPLES) for n in wins.shape]
    means = (n_drawn[0] @ wins * n_drawn[1]).sum(axis=1) / wins.size
    return float(wins.mean()), *_central(means)


def summarise(runs: pd.DataFrame, labels: Iterable[str] | None = None) -> pd.DataFrame:
    """Return one row a task and algorithm: how well its runs ended, and after how many rollouts.

    Failed runs are counted in ``failed`` and in nothing else. An algorithm without a finished run
    has a ``reason`` and no numbers.

    :param runs: one row a run
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


def compare(runs: pd.DataFrame, reference: str) -> pd.DataFrame:
    """Return the probabilities that the reference's runs are better than each other algorithm's.

    Two of them: ``reward`` of the final greedy policy, and ``rollouts`` until it succeeds.

    :param runs: one row a run
    :param reference: the label of the algorithm that is compared with the others
    """
    finished = runs.loc[runs["outcome"] == "finished"]
    rows = []
    for task, on_task in sorted(finished.groupby("task"), key=lambda group: str(group[0])):
        ours = on_task.loc[on_task["label"] == reference]
        for label in sorted(set(on_task["label"]) - {reference}):
            theirs = on_task.loc[on_task["label"] == label]
            if ours.empty:
                continue
            row: dict[str, Any] = {"task": task, "reference": reference, "label": label}
            for name, column, sign in (
                ("reward", "greedy_reward", 1.0),
                ("rollouts", "greedy_rollouts", -1.0),
            ):
                better = probability_of_improvement(sign * ours[column], sign * theirs[column])
                row |= {
                    f"{name}_{end}": p for end, p in zip(("p", "low", "high"), better, strict=True)
                }
            rows.append(row)
    return pd.DataFrame(rows)


def _central(samples: np.ndarray) -> tuple[float, float]:
    """Return the ends of the samples' central 95 %."""
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(samples, [tail, 1 - tail])
    return float(low), float(high)


def _summary(runs: pd.DataFrame) -> dict[str, Any]:
    finished = runs.loc[runs["outcome"] == "finished"]
    row: dict[str, Any] = {"seeds": len(finished), "failed": len(runs) - len(finished)}
    if finished.empty:
        return row | {"reason": "not run" if runs.empty else "failed"}
    row |= {"reason": "", "budget": int(finished["budget"].max())}
    for view in VIEWS:
        solved, rewards = int(finished[f"{view}_solved"].sum()), finished[f"{view}_reward"]
        row |= _named(f"{view}_solved", ("low", "high"), wilson_interval(solved, len(finished)))
        row |= _quartiles(f"{view}_rollouts", finished[f"{view}_rollouts"])
        row |= _named(f"{view}_iqm", ("low", "high"), interquartile_mean_interval(rewards))
        row |= {
            f"{view}_solved": solved,
            f"{view}_reward_median": quantile(rewards, 0.5),
            f"{view}_iqm": interquartile_mean(rewards),
        }
    row |= _quartiles("any_rollouts", finished["any_rollouts"])
    return row | {"training_seconds": quantile(finished["training_seconds"], 0.5)}


def _quartiles(name: str, values: pd.Series) -> dict[str, float]:
    quartiles = (quantile(values, 0.5), quantile(values, 0.25), quantile(values, 0.75))
    return _named(name, ("median", "q25", "q75"), quartiles)


def _named(name: str, ends: Iterable[str], values: Iterable[float]) -> dict[str, float]:
    return {f"{name}_{end}": value for end, value in zip(ends, values, strict=True)}
