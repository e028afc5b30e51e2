"""Errors against rollouts, of all algorithms and of a task's variants (thesis Fig. 6.4)."""

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from results.report.figure_style import COLOURS, LINES, ROOM, line_style, plain_axes, seeds_of


def error_curves(curves: pd.DataFrame, labels: Sequence[str], unit: str) -> Figure:
    """Draw the mean error of the best rollout so far, with its standard error.

    All algorithms are at the left, the variants of the first one at the right.

    :param curves: of one task, one row per step
    :param labels: the algorithms in the order of the legend
    :param unit: of minus the reward
    """
    found = set(curves["label"])
    shown = [label for label in labels if label in found]
    figure = Figure(figsize=(12, 5.4), layout="constrained")
    algorithms, variants = figure.subplots(1, 2)
    for label in shown:
        chosen = curves.loc[curves["label"] == label]
        _draw(algorithms, chosen, label, line_style(label, labels))
    first = curves.loc[curves["label"] == shown[0]]
    for index, variant in enumerate(dict.fromkeys(first["variant"])):
        style = {"color": COLOURS[index % len(COLOURS)], "linestyle": LINES[index % len(LINES)]}
        _draw(variants, first.loc[first["variant"] == variant], str(variant), style)
    algorithms.set_title("All variants")
    variants.set_title(f"{shown[0]}: each variant")
    for axes in (algorithms, variants):
        limits = {"xlim": (0, ROOM * max(curves["rollouts"].to_list())), "ylim": (0, None)}
        axes.set(xlabel="rollouts", ylabel=f"error [{unit}]", **limits)
        plain_axes(axes)
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.14)}
        axes.legend(**below, ncols=2, frameon=False, fontsize=9)
    figure.suptitle(
        f"{curves['task'].iloc[0]}: error of the best rollout so far, mean and standard error"
    )
    return figure


def by_run(curves: pd.DataFrame, column: str) -> pd.DataFrame:
    """Return a column with one row per count of rollouts and one column per run.

    A run that has no row at a count is where its last row left it.

    :param curves: of one algorithm on one task
    :param column: numbers or booleans
    """
    runs: list[Hashable] = ["variant", "seed"]
    table = curves.pivot_table(index="rollouts", columns=runs, values=column, aggfunc="last")
    return table.astype(float).ffill()


def _draw(axes: Axes, curves: pd.DataFrame, name: str, style: dict[str, Any]) -> None:
    errors = -by_run(curves, "best_reward")
    mean, n_runs = errors.mean(axis=1), errors.shape[1]
    axes.plot(mean.index, mean, label=seeds_of(name, n_runs, "run"), **style)
    if n_runs > 1:
        half = errors.std(axis=1) / np.sqrt(n_runs)
        axes.fill_between(
            mean.index, mean - half, mean + half, color=style["color"], alpha=0.15, linewidth=0
        )
