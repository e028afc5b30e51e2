"""Plots of adaptation to held-out contexts (thesis, Fig. 5.6 b)."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from results.adaptation.summary import context_text
from results.exceptions import BenchmarkError
from results.harness.records import RunRecord, finished
from results.harness.slugs import task_slug
from results.report.figure_style import ROOM, line_style, logarithmic_from_zero, plain_axes
from results.report.frames import curves_frame
from results.report.report import Figures, refuse_references

KINDS = ("extrapolation", "interpolation")  # of which curves are published
ROLLOUTS_PER_UPDATE = 2  # of the published curves
QUARTILES = (0.25, 0.5, 0.75)

References = Mapping[str, NDArray[np.float64]]


def figures(
    records: Sequence[RunRecord], labels: Sequence[str], references: Sequence[Path] = ()
) -> Figures:
    """Draw a figure for each task; return them by the name of their file.

    :param records: with at least one finished run
    :param labels: the algorithms in the order of the legend
    :param references: .npy files of published errors, see `read_reference`
    :raises BenchmarkError: a reference is no such file
    """
    (protocol, *_) = {record.specification.protocol.name for record in records}
    if protocol != "leave-one-out":
        refuse_references(protocol, references)
    published = dict(read_reference(path) for path in references)
    drawn: dict[str, Figure] = {}
    for task, curves in curves_frame(records).groupby("task"):
        runs = [record for record in finished(records) if record.specification.task == task]
        unit = runs[0].task.error_unit
        told = "error of the greedy policy" + (f" [{unit}]" if unit else "")
        figure = adaptation_curves(curves, labels, published, panel_titles(runs), told)
        drawn[f"curves_{task_slug(str(task))}.png"] = figure
    return drawn


def panel_titles(runs: Sequence[RunRecord]) -> dict[str, str]:
    """Return which contexts each kind is about.

    :param runs: finished ones of one task
    """
    titles: dict[str, str] = {}
    for kind in sorted({run.specification.protocol.kind for run in runs}):
        of_kind = [run for run in runs if run.specification.protocol.kind == kind]
        contexts = {context_text(run) for run in of_kind}
        numbers = sorted({run.specification.protocol.number or 0 for run in of_kind})
        listed = f"targets {', '.join(str(number) for number in numbers)}"
        titles[kind] = f"{kind}: {contexts.pop() if len(contexts) == 1 else listed}"
    return titles


def adaptation_curves(
    curves: pd.DataFrame,
    labels: Sequence[str],
    references: References,
    titles: Mapping[str, str],
    told: str = "",
) -> Figure:
    """Draw the greedy error against rollouts, a panel for each kind of target; below it success.

    :param curves: of one task, one row per step
    :param labels: the algorithms in the order of the legend
    :param references: published errors of shape (runs, updates), by kind of target
    :param titles: of the panels, by kind
    :param told: of the errors' axis
    """
    kinds = sorted(set(curves["kind"]))
    n_columns = min(len(kinds), 3)
    n_rows = math.ceil(len(kinds) / n_columns)
    size = (max(5.5 * n_columns, 7.0), 6.2 * n_rows + 1.0)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(2 * n_rows, n_columns, squeeze=False, height_ratios=(2, 1) * n_rows)
    errors, successes = panels[0::2].flatten(), panels[1::2].flatten()
    for axes in errors[1:]:
        axes.sharey(errors[0])
    handles: dict[str, Artist] = {}
    for axes in (*errors[len(kinds) :], *successes[len(kinds) :]):
        axes.set_visible(False)
    for axes, success, kind in zip(errors, successes, kinds, strict=False):
        chosen = curves.loc[curves["kind"] == kind]
        _draw_panel(axes, chosen, labels)
        _draw_success(success, chosen, labels)
        if kind in references:
            _draw_reference(axes, references[kind])
        axes.set(title=titles[kind], ylabel=told)
        _scale_errors(axes, curves)
        success.set(xlabel="rollouts", ylabel="runs that succeed", ylim=(-0.03, 1.03))
        success.yaxis.set_major_formatter(PercentFormatter(1.0))
        for each in (axes, success):
            _scale_rollouts(each, curves)
            plain_axes(each)
        found, names = axes.get_legend_handles_labels()
        handles |= dict(zip(names, found, strict=True))
    break_line = "\n" if n_columns == 1 else " "
    figure.suptitle(
        f"{curves['task'].iloc[0]}: adaptation to a held-out context;{break_line}median and "
        "quartiles over contexts and seeds"
    )
    names = sorted(handles, key=lambda name: list([*labels, name]).index(name))
    figure.legend(
        [handles[name] for name in names], names,
        loc="outside lower center", ncols=min(int(size[0] // 2.5), len(names)), frameon=False,
    )  # fmt: skip
    return figure


def error_quartiles(curves: pd.DataFrame) -> pd.DataFrame:
    """Return the quartiles of the greedy error over runs, one row per count of rollouts.

    A run's error holds until its next row; where a run has no policy yet, it is left out.

    :param curves: of one algorithm and kind of target
    :return: columns `QUARTILES`
    """
    errors = curves.assign(error=-curves["greedy_reward"]).pivot_table(
        index="rollouts", columns=["target", "seed"], values="error", aggfunc="last"
    )
    return errors.ffill().quantile(list(QUARTILES), axis=1).T


def read_reference(path: Path) -> tuple[str, NDArray[np.float64]]:
    """Return the kind of target that a file of published errors is about, and the errors.

    :param path: of a .npy file of shape (runs, updates); signs do not matter
    :return: one of `KINDS`, and errors of shape (runs, updates)
    :raises BenchmarkError: not such a file, or its name does not tell the kind
    """
    kinds = [kind for kind in KINDS if kind in path.stem]
    try:
        errors = np.abs(np.asarray(np.load(path, allow_pickle=False), np.float64))
    except (OSError, ValueError) as error:
        raise BenchmarkError(
            f"--reference '{path}' is no .npy file of numbers ({error})."
        ) from error
    if errors.ndim != 2 or len(kinds) != 1:
        raise BenchmarkError(
            f"--reference '{path}' has shape {errors.shape}; it must be (runs, updates), and its "
            f"name must hold one of {', '.join(KINDS)}."
        )
    return kinds[0], errors


def _scale_errors(axes: Axes, curves: pd.DataFrame) -> None:
    """Make the errors' axis logarithmic; where runs reach no error at all, linear near it."""
    errors = -curves["greedy_reward"].to_numpy(float)
    if (errors > 0).all():
        axes.set_yscale("log")
    else:
        axes.set_yscale("symlog", linthresh=float(np.quantile(errors[errors > 0], 0.05)))
        axes.set_ylim(bottom=0.0)


def _scale_rollouts(axes: Axes, curves: pd.DataFrame) -> None:
    """End the axis with the longest run; make it logarithmic where the budgets differ."""
    ends = [max(of_label["rollouts"]) for _, of_label in curves.groupby("label")]
    axes.set_xlim(0, ROOM * max(ends))
    if max(ends) > min(ends):
        logarithmic_from_zero(axes, 10)


def _draw_panel(axes: Axes, curves: pd.DataFrame, labels: Sequence[str]) -> None:
    found = set(curves["label"])
    for label in labels:
        if label in found:
            style = line_style(label, labels)
            quartiles = error_quartiles(curves.loc[curves["label"] == label])
            low, median, high = (quartiles[q] for q in QUARTILES)
            axes.step(median.index, median, where="post", label=label, **style)
            axes.fill_between(
                median.index, low, high, step="post", color=style["color"], alpha=0.13, linewidth=0
            )


def _draw_success(axes: Axes, curves: pd.DataFrame, labels: Sequence[str]) -> None:
    """Draw the share of runs whose greedy policy succeeds."""
    found = set(curves["label"])
    for label in labels:
        if label in found:
            chosen = curves.loc[curves["label"] == label]
            succeeds = chosen.assign(success=chosen["greedy_success"].astype(float)).pivot_table(
                index="rollouts", columns=["target", "seed"], values="success", aggfunc="last"
            )
            rate = succeeds.ffill().fillna(0.0).mean(axis=1)
            axes.step(rate.index, rate, where="post", **line_style(label, labels))


def _draw_reference(axes: Axes, errors: NDArray[np.float64]) -> None:
    rollouts = ROLLOUTS_PER_UPDATE * np.arange(errors.shape[1])
    low, median, high = np.quantile(errors, QUARTILES, axis=0)
    axes.plot(rollouts, median, color="0.35", linewidth=1.2, label="published curve")
    axes.fill_between(rollouts, low, high, color="0.35", alpha=0.1, linewidth=0)
