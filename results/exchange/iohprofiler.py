"""Runs as IOHprofiler's files, which IOHanalyzer and the package iohinspector read.

Each algorithm is a folder; in it, each task (with each variant, in each numbered context) is a
function: a JSON file about its runs, and a table of their rows, one run after the other, each from
evaluation 1 on. An evaluation is a rollout, the instance is the run's seed, the value is the best
reward so far, to be maximised, and the greedy policy's reward and success stand beside it.

A function has one number, one dimension and one suite, whichever algorithm's file tells of it.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

from results.exceptions import BenchmarkError
from results.harness.records import RunRecord, finished
from results.harness.slugs import slug, task_slug

VERSION = "0.3.18"  # of the format
LARGEST_INSTANCE = 2**16 - 1  # iohinspector keeps instances in 16 bits
COLUMNS = ("evaluations", "raw_y", "greedy_reward", "greedy_success")
NEEDED = ("best_reward", "greedy_reward", "greedy_success")


def export_iohprofiler(records: Sequence[RunRecord], out: Path) -> list[Path]:
    """Write runs for IOHanalyzer.

    :param records: of finished and failed runs; failed ones are left out
    :param out: the folder to be made
    :return: the JSON files
    :raises BenchmarkError: the folder holds files already, there is nothing to write, or a run
        whose curve does not tell its first rollout
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise BenchmarkError(f"--out is '{out}', which is there already; name a new folder.")
    runs = finished(records)
    if not runs:
        raise BenchmarkError("no run has finished, so that there is nothing to export.")
    for run in runs:
        _check(run)
    runs.sort(key=_order)
    functions = list(dict.fromkeys(map(_function, runs)))
    suites = {run.specification.suite.name for run in runs}
    folders = _folders(list(dict.fromkeys(run.specification.label for run in runs)))
    export = _Export(out, min(suites) if len(suites) == 1 else "", _instances(runs))
    written = []
    for label, folder in folders.items():
        for number, function in enumerate(functions, 1):
            alike = [run for run in runs if _function(run) == function]
            chosen = [run for run in alike if run.specification.label == label]
            if chosen:
                named = _Named(number, function, _dimension(alike))
                written.append(export.write(folder, named, chosen))
    return written


def _folders(labels: Sequence[str]) -> dict[str, str]:
    """Return a folder for each algorithm, of its own where names are written alike.

    >>> _folders(["GA", "GA+", "B"])
    {'GA': 'ga', 'GA+': 'ga-2', 'B': 'b'}
    """
    found: dict[str, str] = {}
    for label in labels:
        names = (f"{slug(label)}{f'-{n}' if n > 1 else ''}" for n in count(1))
        found[label] = next(name for name in names if name not in found.values())
    return found


def _instances(runs: Sequence[RunRecord]) -> dict[int, int]:
    """Return the instance of each seed: itself, or its place where one is too large for readers."""
    seeds = sorted({run.specification.seed for run in runs})
    large = seeds[-1] > LARGEST_INSTANCE
    return {seed: place if large else seed for place, seed in enumerate(seeds, 1)}


def _check(run: RunRecord) -> None:
    missing = [name for name in NEEDED if name not in run.curve]
    if missing:
        raise BenchmarkError(
            f"{run.specification.name} has no {' and no '.join(missing)} in its curve; IOHanalyzer "
            "takes runs in one context."
        )
    first = _rows(run)[0][0]
    if first != 1:
        raise BenchmarkError(
            f"{run.specification.name} tells nothing before rollout {first}; IOHanalyzer needs the "
            "first one, which imported evaluations lack: leave this run out."
        )


def _order(run: RunRecord) -> tuple[str, str, int, int]:
    asked = run.specification
    return asked.task, asked.variant, asked.protocol.number or 0, asked.seed


def _function(run: RunRecord) -> str:
    """Return the name of what is optimised."""
    asked = run.specification
    number = "" if asked.protocol.number is None else f", target {asked.protocol.number}"
    return f"{asked.task}{f', {asked.variant}' if asked.variant else ''}{number}"


def _rows(run: RunRecord) -> list[tuple[Any, ...]]:
    """Return what is known after each number of rollouts, from the first one on."""
    names = ("rollouts", *NEEDED)
    rows = zip(*(run.curve[name] for name in names), strict=True)
    return [row for row in rows if row[0] > 0 and row[1] is not None]


@dataclass(frozen=True)
class _Named:
    """A function: its number, its name, and how many numbers a trajectory has."""

    number: int
    name: str
    dimension: int


@dataclass(frozen=True)
class _Export:
    """What all files share: their folder, the suite, and the instance of each seed."""

    out: Path
    suite: str
    instances: dict[int, int]

    def write(self, folder: str, function: _Named, runs: Sequence[RunRecord]) -> Path:
        """Write an algorithm's runs of a function; return the JSON file."""
        asked, number = runs[0].specification, function.number
        name, dimension = task_slug(function.name), function.dimension
        data = Path(f"data_f{number}_{name}") / f"IOHprofiler_f{number}_DIM{dimension}.dat"
        (self.out / folder / data).parent.mkdir(parents=True, exist_ok=True)
        lines = [" ".join(COLUMNS)]
        for run in runs:
            lines += [_line(row) for row in _rows(run)]
        (self.out / folder / data).write_text("\n".join(lines) + "\n", encoding="utf-8")
        about = [self._about(run) for run in runs]
        content = {
            "version": VERSION,
            "suite": self.suite or "sb3-nmp",
            "function_id": number,
            "function_name": function.name,
            "maximization": True,
            "algorithm": {"name": asked.label, "info": asked.description or asked.algorithm},
            "attributes": list(COLUMNS),
            "scenarios": [{"dimension": dimension, "path": str(data), "runs": about}],
        }
        path = self.out / folder / f"IOHprofiler_f{number}_{name}.json"
        path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        return path

    def _about(self, run: RunRecord) -> dict[str, Any]:
        rows = _rows(run)
        best = max(rows, key=lambda row: row[1])
        return {
            "instance": self.instances[run.specification.seed],
            "evals": run.specification.budget,
            "best": {"evals": best[0], "y": best[1], "x": []},
        }


def _line(row: Iterable[Any]) -> str:
    evaluations, best, greedy, success = row
    return f"{evaluations} {best:.10f} {greedy:.10f} {int(success)}"


def _dimension(runs: Sequence[RunRecord]) -> int:
    """Return how many numbers a trajectory has, 1 where no run tells."""
    for run in runs:
        for rollout in run.measured.rollouts.values():
            return len(rollout.trajectory) * len(rollout.trajectory[0])
    return 1
