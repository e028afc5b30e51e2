"""Figures of runs in one context: learning curves, and the final greedy rollouts."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from results.harness.records import RunRecord, finished
from results.harness.slugs import slug, task_slug
from results.one_context.error_curves import by_run, error_curves
from results.one_context.final_rollouts import draw_final_rollouts
from results.report.figure_style import ROOM, line_style, plain_axes, seeds_of
from results.report.frames import curves_frame
from results.report.report import Figures, refuse_references


def figures(
    records: Sequence[RunRecord], labels: Sequence[str], references: Sequence[Path] = ()
) -> Figures:
    """Draw a task's curves and final rollouts; return the figures by the name of their file.

    :param records: with at least one finished run
    :param labels: the algorithms in the order of the legend
    :param references: must be empty: there are no published curves of such runs
    :raises BenchmarkError: references are given
    """
    refuse_references("one-context", references)
    drawn: dict[str, Figure] = {}
    for task, on_task in curves_frame(records).groupby("task"):
        name = task_slug(str(task))
        runs = [r for r in finished(records) if r.specification.task == task]
        drawn[f"curves_{name}.png"] = learning_curves(on_task, labels, runs[0].task.optimum)
        variants = [str(variant) for variant in dict.fromkeys(on_task["variant"])]
        if any(variants) and runs[0].task.error_unit:
            unit = runs[0].task.error_unit
            drawn[f"errors_{name}.png"] = error_curves(on_task, labels, unit)
        for variant in variants:
            chosen = [run for run in runs if run.specification.variant == variant]
            chosen = [run for run in chosen if "greedy" in run.measured.rollouts]  # not imported
            ending = f"_{slug(variant)}" if variant else ""
            if chosen:
                drawn[f"rollouts_{name}{ending}.png"] = draw_final_rollouts(chosen, labels)
    return drawn


def learning_curves(
    curves: pd.DataFrame, labels: Sequence[str], optimum: tuple[str, float] | None = None
) -> Figure:
    """Draw success and reward of the greedy policies against rollouts.

    :param curves: of one task, one row per step
    :param labels: the algorithms in the order of the legend
    :param optimum: name and value of the largest reward, where it is known
    """
    figure = Figure(figsize=(13, 4.8), layout="constrained")
    success, reward, final = figure.subplots(1, 3)
    found, what = set(curves["label"]), "run" if set(curves["variant"]) != {""} else "seed"
    shown = [label for label in labels if label in found]
    for label in shown:
        style = line_style(label, labels)
        chosen = curves.loc[curves["label"] == label]
        succeeds = by_run(chosen, "greedy_success")
        rate, name = succeeds.mean(axis=1), seeds_of(label, succeeds.shape[1], what)
        success.step(rate.index, rate, where="post", label=name, **style)
        rewards = by_run(chosen, "greedy_reward")
        low, median, high = (rewards.quantile(q, axis=1) for q in (0.25, 0.5, 0.75))
        for axes in (reward, final):
            axes.step(median.index, median, where="post", **style)
            axes.fill_between(
                median.index, low, high, step="post", color=style["color"], alpha=0.15, linewidth=0
            )
    task = str(curves["task"].iloc[0])
    success.set(title=f"{what.capitalize()}s whose greedy policy succeeds", ylim=(-0.02, 1.02))
    success.yaxis.set_major_formatter(PercentFormatter(1.0))
    reward.set(title="Greedy reward: median, quartiles")
    final.set(title="The same, enlarged", ylim=enlarged_limits(curves))
    for axes, unit in ((success, f"{what}s"), (reward, "reward"), (final, "reward")):
        _finish(axes, max(curves["rollouts"].to_list()), unit)
    if optimum is not None:
        _mark(final, *optimum)
    figure.suptitle(f"{task}: what the greedy policy reaches after a number of rollouts")
    figure.legend(loc="outside lower center", ncols=min(4, len(shown)), frameon=False)
    return figure


def enlarged_limits(curves: pd.DataFrame) -> tuple[float, float]:
    """Return the limits of reward between which the solved runs differ.

    :param curves: of one task
    """
    last = curves.sort_values("rollouts").groupby(["label", "variant", "seed"]).tail(1)
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
    axes.set(xlabel="rollouts", ylabel=unit, xlim=(0, ROOM * budget))
    plain_axes(axes)
