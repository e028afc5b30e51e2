"""Picture and table of `results.experiments.fetch`, from its files alone."""

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from results.report.figure_style import DPI, line_style, plain_axes, seeds_of

METHODS = ("RC-NMP", "ACNMP", "SAC+HER", "PPO")
STEPS = 50  # of the simulator's control in a rollout
Runs = dict[tuple[str, str], list[dict[str, Any]]]


def read(folder: Path) -> Runs:
    """Return the records by task and method.

    :param folder: of the JSON files
    """
    found: Runs = defaultdict(list)
    for path in sorted(folder.glob("*.json")):
        record = json.loads(path.read_text(encoding="utf-8"))
        found[record["task"], record["method"]].append(record)
    return found


def draw(folder: Path, picture: Path) -> str:
    """Draw the curves, a panel for each task, and return the table of the evaluations.

    :param folder: of the JSON files
    :param picture: PNG to write
    """
    runs = read(folder)
    tasks = sorted({task for task, _ in runs}, key=lambda task: ("Reach" not in task, task))
    figure = Figure(figsize=(4.2 * len(tasks), 3.4), layout="constrained")
    panels = figure.subplots(1, len(tasks), squeeze=False, sharey=True)[0]
    for axes, task in zip(panels, tasks, strict=True):
        for method in METHODS:
            if (task, method) in runs:
                _curve(axes, method, runs[task, method])
        axes.set_title(task)
        axes.set_xlabel("control steps of the simulator, in 1000")
        axes.set_ylim(-3, 103)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncol=2, fontsize=8)
        plain_axes(axes)
    panels[0].set_ylabel("unseen goals reached [%]")
    figure.savefig(picture, dpi=DPI)
    return table(runs)


def _curve(axes: Axes, method: str, records: list[dict[str, Any]]) -> None:
    """Draw the mean over the seeds, and each seed faintly."""
    style = line_style(method, METHODS)
    curves = [record["curve"] for record in records]
    x = STEPS / 1000 * np.array([point["rollouts"] for point in curves[0]])
    y = 100 * np.array([[point["solved"] for point in curve] for curve in curves])
    axes.plot(x, y.T, color=style["color"], linewidth=0.8, alpha=0.4)
    axes.plot(x, y.mean(axis=0), **style, marker="o", label=seeds_of(method, len(curves)))


def table(runs: Runs) -> str:
    """Return the evaluations of each run as a Markdown table.

    :param runs: by task and method
    """
    lines = ["| task | method | seed | solved after rollouts | minutes |", "|---|---|--:|---|--:|"]
    for (task, method), records in runs.items():
        for record in records:
            told = ", ".join(
                f"{point['rollouts']}: {point['solved']:.3f} of {point['n_contexts']}"
                for point in record["curve"]
            )
            lines.append(
                f"| {task} | {method} | {record['seed']} | {told} | {record['minutes']:.1f} |"
            )
    return "\n".join(lines)
