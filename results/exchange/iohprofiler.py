"""Runs as IOHprofiler's files, which IOHanalyzer and the package iohinspector read.

Each algorithm is a folder; in it, each task (with each variant, in each numbered context) is a
function: a JSON file about its runs, and a table of their rows, one run after the other, each from
evaluation 1 on. An evaluation is a rollout, the instance is the run's seed, the value is the best
reward so far, to be maximised, and the greedy policy's reward and success stand beside it.
"""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from results.exceptions import BenchmarkError
from results.harness.records import RunRecord, finished
from results.harness.slugs import slug, task_slug

VERSION = "0.3.18"  # of the format
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
    functions = list(dict.fromkeys(_function(run) for run in sorted(runs, key=_order)))
    written = []
    for label in dict.fromkeys(run.specification.label for run in runs):
        for number, function in enumerate(functions, 1):
            chosen = [
                r for r in runs if r.specification.label == label and _function(r) == function
            ]
            if chosen:
                folder = out / slug(label)
                written.append(_write(folder, number, function, sorted(chosen, key=_order)))
    return written


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


def _write(folder: Path, number: int, function: str, runs: Sequence[RunRecord]) -> Path:
    asked = runs[0].specification
    name, dimension = task_slug(function), _dimension(runs)
    data = Path(f"data_f{number}_{name}") / f"IOHprofiler_f{number}_DIM{dimension}.dat"
    (folder / data).parent.mkdir(parents=True, exist_ok=True)
    lines = [" ".join(COLUMNS)]
    for run in runs:
        lines += [_line(row) for row in _rows(run)]
    (folder / data).write_text("\n".join(lines) + "\n", encoding="utf-8")
    content = {
        "version": VERSION,
        "suite": asked.suite.name or "sb3-nmp",
        "function_id": number,
        "function_name": function,
        "maximization": True,
        "algorithm": {"name": asked.label, "info": asked.description or asked.algorithm},
        "attributes": list(COLUMNS),
        "scenarios": [
            {"dimension": dimension, "path": str(data), "runs": [_about(run) for run in runs]}
        ],
    }
    path = folder / f"IOHprofiler_f{number}_{name}.json"
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return path


def _line(row: Iterable[Any]) -> str:
    evaluations, best, greedy, success = row
    return f"{evaluations} {best:.10f} {greedy:.10f} {int(success)}"


def _about(run: RunRecord) -> dict[str, Any]:
    rows = _rows(run)
    best = max(rows, key=lambda row: row[1])
    return {
        "instance": run.specification.seed,
        "evals": run.specification.budget,
        "best": {"evals": best[0], "y": best[1], "x": []},
    }


def _dimension(runs: Sequence[RunRecord]) -> int:
    """Return how many numbers a trajectory has, 1 where no run tells."""
    for run in runs:
        for rollout in run.measured.rollouts.values():
            return len(rollout.trajectory) * len(rollout.trajectory[0])
    return 1
