"""Push beyond demonstrations that are drawn at random, so that nothing can have been tuned on them.

``python -m results.experiments.push_splits run FILE.jsonl 0 30`` does a run for each of 30 splits
and each row, and appends a line for each, skipping those that are there; ``show FILE.jsonl`` prints
a Markdown table. The unit of replication is the split, which also seeds the run.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from benchmark_envs.tasks.push import BEARINGS, DISTANCES
from results.adaptation.protocol import Adaptation
from results.experiments.json_lines import append_missing, read_lines
from results.harness.runner import execute
from results.harness.specification import RunSpecification
from results.report.frames import rollouts_to_success
from results.report.statistics import mean_interval
from results.suites import push

TASK, BUDGET, FIRST_SEED = "nmp/Push-v0", 130, 20_000
ROWS = (
    "ACNMP",
    "twin, nearest",
    "twin, ridge",
    "twin, Gaussian process",
    "CMA-ES context",
    "ProMP+RL (Ewerton)",
)
#: degrees, between which demonstrated targets lie, and how far beyond their outermost the one is
SHOWN, BEYOND = (-35.0, 100.0), (10.0, 30.0)
FEWEST, MOST = 5, 9


@dataclass(frozen=True)
class RandomSplit(Adaptation):
    """Five to nine targets at random, and one beyond: past the last bearing, or before the first.

    >>> shown, held_out = RandomSplit(0).split("nmp/Push-v0")
    >>> 5 <= len(shown) <= 9, held_out.shape
    (True, (2,))

    :param target: the number of the split
    """

    target: int

    name: ClassVar[str] = "random-split"

    @property
    def kind(self) -> str:
        """All are of a kind."""
        return "beyond"

    def split(self, task_id: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the demonstrated targets, shape (K, 2) in m, and the one of this number.

        :param task_id: of the task, which is always push
        """
        rng = np.random.default_rng([FIRST_SEED, self.target])
        bearings = rng.uniform(*SHOWN, int(rng.integers(FEWEST, MOST + 1)))
        farther = rng.uniform(*BEYOND)
        asked = bearings.max() + farther if self.target % 2 else bearings.min() - farther
        angles = np.radians([*bearings, np.clip(asked, *BEARINGS)])
        distances = rng.uniform(*DISTANCES, len(angles))[:, None]
        targets = distances * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return targets[:-1], targets[-1]


def measure(label: str, number: int) -> dict[str, Any]:
    """Return what a row's run on a split came to.

    :param label: of the row in the suite push
    :param number: of the split
    """
    run = RunSpecification(
        label, push.ALGORITHMS[label], TASK, FIRST_SEED + number, BUDGET, RandomSplit(number), {}
    )
    curve = execute(run).measured.curve
    first = rollouts_to_success(curve["rollouts"], curve["greedy_success"])
    return {
        "row": label,
        "split": number,
        "rollouts": first if np.isfinite(first) else None,
        "error": -float(curve["greedy_reward"][-1]),
    }


def show(file: Path) -> None:
    """Print a table: rollouts until success, and how many more than ACNMP takes, with intervals.

    A run that never succeeds counts with its budget.

    :param file: one JSON object a line
    """
    spent: dict[str, dict[int, float]] = {}
    solved: dict[str, int] = {}
    errors: dict[str, list[float]] = {}
    for each in read_lines(file):
        row, first = each["row"], each["rollouts"]
        spent.setdefault(row, {})[each["split"]] = BUDGET if first is None else first
        solved[row] = solved.get(row, 0) + (first is not None)
        errors.setdefault(row, []).append(each["error"])
    print(
        "| | runs | solved | median (quartiles) | worst | expected | more than ACNMP | error [m²] |"
    )
    print("|---|--:|--:|--:|--:|--:|--:|--:|")
    for row in ROWS:
        values = np.array([*spent[row].values()])
        low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
        told = "–" if row == ROWS[0] else difference(spent[row], spent[ROWS[0]])
        print(
            f"| {row} | {len(values)} | {solved[row]} | {middle:g} ({low:g}–{high:g}) | "
            f"{values.max():g} | {values.sum() / max(solved[row], 1):.1f} | {told} | "
            f"{np.median(errors[row]):.4f} |"
        )


def difference(one: dict[int, float], other: dict[int, float]) -> str:
    """Return a mean difference over the splits that both have, with its 95 % interval.

    :param one: by split
    :param other: that is subtracted
    """
    apart = np.array([one[split] - other[split] for split in one if split in other])
    low, high = map(float, mean_interval(apart))
    return f"{apart.mean():.1f} [{low:.1f}, {high:.1f}]"


def main() -> None:
    """Do what the command line asks for."""
    kind, file, *numbers = sys.argv[1:]
    if kind == "run":
        first, n = map(int, numbers)
        runs = [(row, split) for split in range(first, first + n) for row in ROWS]
        append_missing(Path(file), measure, runs, "split")
    show(Path(file))


if __name__ == "__main__":
    main()
