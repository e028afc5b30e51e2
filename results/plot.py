"""Plots of runs in one context: learning curves, and the bottles task's final paths."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter, ScalarFormatter

from results.bottles import draw_paths, final_paths, seeds_of
from results.records import Record
from results.specification import slug

# Okabe and Ito's palette, which colour-blind readers can tell apart, without its yellow; with the
# line styles, also in print without colour.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
LINES = ("-", "--", "-.", (0, (1, 1)))
OPTIMA = {"nmp/Bottles-v0": ("shortest path", -0.129)}  # of the final reward, where it is known
DPI = 150


def figures(
    curves: pd.DataFrame, records: Sequence[Record], labels: Sequence[str]
) -> dict[str, Figure]:
    """Draw all that runs show; return the figures by the name of their file.

    :param curves: of `results.records.curves_frame`, of at least one run
    :param records: of the same runs
    :param labels: the algorithms in the order of the legend
    """
    drawn: dict[str, Figure] = {}
    for task, on_task in curves.groupby("task"):
        name = task_slug(str(task))
        drawn[f"curves_{name}.png"] = learning_curves(on_task, labels)
        paths = final_paths(record for record in records if record["specification"]["task"] == task)
        if str(task).startswith("nmp/Bottles-"):
            drawn[f"paths_{name}.png"] = draw_paths(paths, labels)
    return drawn


def save_figures(folder: Path, drawn: Mapping[str, Figure]) -> list[Path]:
    """Write figures as PNG files and return their paths.

    :param folder: where to write
    :param drawn: by the name of their file
    """
    for name, figure in drawn.items():
        figure.savefig(folder / name, dpi=DPI)
    return [folder / name for name in drawn]


def task_slug(task: str) -> str:
    """Return a task's name for files.

    >>> task_slug("nmp/Push-v0")
    'push-v0'

    :param task: its id
    """
    return slug(task.removeprefix("nmp/"))


def line_style(label: str, labels: Sequence[str]) -> dict[str, Any]:
    """Return an algorithm's colour and line, the same in all figures of a suite.

    :param label: the algorithm's
    :param labels: all algorithms of the suite, in their order
    """
    place = list(labels).index(label)
    return {
        "color": COLOURS[place % len(COLOURS)],
        "linestyle": LINES[place % len(LINES)],
        "linewidth": 2.0,
    }


def logarithmic_from_zero(axes: Axes, first: float) -> None:
    """Make an axis of rollouts logarithmic from a count on, and linear from 0 to it.

    :param axes: whose x-axis
    :param first: the count, positive
    """
    axes.set_xscale("symlog", linthresh=first, linscale=0.3)
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.set_xlabel(f"rollouts (logarithmic from {first:.0f} on)")


def learning_curves(curves: pd.DataFrame, labels: Sequence[str]) -> Figure:
    """Draw success and reward of the greedy policies against rollouts.

    :param curves: of one task, one row a step
    :param labels: the algorithms in the order of the legend
    """
    figure = Figure(figsize=(13, 4.8), layout="constrained")
    success, reward, final = figure.subplots(1, 3)
    found = set(curves["label"])
    shown = [label for label in labels if label in found]
    for label in shown:
        style = line_style(label, labels)
        chosen = curves.loc[curves["label"] == label]
        n_seeds = chosen["seed"].nunique()
        rate = by_seed(chosen, "greedy_success").mean(axis=1)
        success.step(rate.index, rate, where="post", label=seeds_of(label, n_seeds), **style)
        rewards = by_seed(chosen, "greedy_reward")
        low, median, high = (rewards.quantile(q, axis=1) for q in (0.25, 0.5, 0.75))
        for axes in (reward, final):
            axes.step(median.index, median, where="post", **style)
            axes.fill_between(
                median.index, low, high, step="post", color=style["color"], alpha=0.15, linewidth=0
            )
    task = str(curves["task"].iloc[0])
    success.set(title="Seeds whose greedy policy succeeds", ylim=(-0.02, 1.02))
    success.yaxis.set_major_formatter(PercentFormatter(1.0))
    reward.set(title="Greedy reward: median, quartiles")
    final.set(title="The same, enlarged", ylim=enlarged_limits(curves))
    for axes, unit in ((success, "seeds"), (reward, "reward"), (final, "reward")):
        _finish(axes, max(curves["rollouts"].to_list()), unit)
    if task in OPTIMA:
        _mark(final, *OPTIMA[task])
    figure.suptitle(f"{task}: what the greedy policy reaches after a number of rollouts")
    figure.legend(loc="outside lower center", ncols=min(4, len(shown)), frameon=False)
    return figure


def by_seed(curves: pd.DataFrame, column: str) -> pd.DataFrame:
    """Return a column with one row a count of rollouts and one column a seed.

    A run that has no row at a count is where its last row left it.

    :param curves: of one algorithm on one task
    :param column: numbers or booleans
    """
    table = curves.pivot_table(index="rollouts", columns="seed", values=column, aggfunc="last")
    return table.astype(float).ffill()


def enlarged_limits(curves: pd.DataFrame) -> tuple[float, float]:
    """Return the limits of reward between which the solved runs differ.

    :param curves: of one task
    """
    last = curves.sort_values("rollouts").groupby(["label", "seed"]).tail(1)
    solved = last["greedy_success"].to_numpy(bool)
    rewards = last["greedy_reward"].to_numpy(float)
    low, high = np.quantile(rewards[solved] if solved.any() else rewards, [0.1, 1.0])
    height = max(high - low, 1e-3 * max(1.0, abs(high)))
    return float(low - height), float(high + 0.4 * height)


def _mark(axes: Axes, name: str, value: float) -> None:
    """Draw a line at a known reward, where the axes show it."""
    low, high = axes.get_ylim()
    if low < value < high:
        axes.axhline(value, color="0.3", linewidth=1, linestyle=":")
        text = f"{name} ({value})"
        axes.annotate(
            text, (axes.get_xlim()[0], value), (6, 3), textcoords="offset points",
            color="0.3", fontsize=9,
        )  # fmt: skip


def _finish(axes: Axes, budget: int, unit: str) -> None:
    axes.set(xlabel="rollouts", ylabel=unit, xlim=(0, budget))
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
