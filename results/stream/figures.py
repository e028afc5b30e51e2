"""Plots of learning on a stream of contexts (thesis, Fig. 5.6 d and e)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from results.harness.records import RunRecord
from results.harness.slugs import task_slug
from results.report.figure_style import line_style, logarithmic_from_zero, plain_axes, seeds_of
from results.report.frames import curves_frame
from results.report.report import Figures, refuse_references
from results.report.statistics import mean_interval
from results.stream.summary import THRESHOLDS

FloatArray = NDArray[np.float64]


def figures(
    records: Sequence[RunRecord], labels: Sequence[str], references: Sequence[Path] = ()
) -> Figures:
    """Draw a figure for each task; return them by the name of their file.

    :param records: with at least one finished run
    :param labels: the algorithms in the order of the legend
    :param references: must be empty: there are no published curves of such runs
    :raises BenchmarkError: references are given
    """
    refuse_references("stream", references)
    return {
        f"curves_{task_slug(str(task))}.png": stream_curves(on_task, labels)
        for task, on_task in curves_frame(records).groupby("task")
    }


def stream_curves(curves: pd.DataFrame, labels: Sequence[str]) -> Figure:
    """Draw the failure rate in unseen contexts against contexts seen and against rollouts.

    :param curves: of one task, one row per evaluation
    :param labels: the algorithms in the order of the legend
    """
    figure = Figure(figsize=(11, 5.0), layout="constrained")
    panels = dict(zip(("contexts", "rollouts"), figure.subplots(1, 2, sharey=True), strict=True))
    found = set(curves["label"])
    shown = [label for label in labels if label in found]
    for label in shown:
        chosen = curves.loc[curves["label"] == label]
        style = line_style(label, labels)
        name = seeds_of(label, chosen["seed"].nunique())
        for column, axes in panels.items():
            grid, rates = by_seed_on_grid(chosen, column)
            low, high = mean_interval(rates)
            axes.plot(grid, rates.mean(axis=0), label=name, **style)
            axes.fill_between(grid, low, high, color=style["color"], alpha=0.15, linewidth=0)
    panels["contexts"].set(
        xlabel="environments (contexts) seen", ylabel="unseen contexts that fail"
    )
    panels["rollouts"].set(xlabel="rollouts")
    logarithmic_from_zero(panels["rollouts"], min(c for c in curves["rollouts"] if c > 0))
    for axes in panels.values():
        _finish(axes)
    task = str(curves["task"].iloc[0])
    figure.suptitle(f"{task}: failures of the greedy policy; mean and 95 % bootstrap over seeds")
    handles, names = panels["rollouts"].get_legend_handles_labels()
    figure.legend(
        handles, names, loc="outside lower center", ncols=min(4, len(shown)), frameon=False
    )
    return figure


def by_seed_on_grid(curves: pd.DataFrame, column: str) -> tuple[FloatArray, FloatArray]:
    """Return failure rates of all seeds at common counts, linear between a seed's evaluations.

    Before its first and after its last evaluation a seed is where these left it.

    :param curves: of one algorithm on one task
    :param column: ``"contexts"`` or ``"rollouts"``; the last evaluation at a count is taken
    :return: the counts, shape (K,), and the rates, shape (seeds, K)
    """
    grid = np.unique(curves[column].to_numpy(float))
    rates = []
    for _, run in curves.sort_values("rollouts").groupby("seed"):
        last = run.groupby(column)["failure_rate"].last()
        rates.append(np.interp(grid, last.index.to_numpy(float), last.to_numpy(float)))
    return grid, np.array(rates)


def _finish(axes: Axes) -> None:
    for rate in THRESHOLDS.values():
        axes.axhline(rate, color="0.4", linewidth=1, linestyle=":")
        axes.annotate(
            f"{100 * rate:g} %", (1.0, rate), (-2, 2), xycoords=("axes fraction", "data"),
            textcoords="offset points", color="0.4", fontsize=8, ha="right",
        )  # fmt: skip
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    plain_axes(axes)
