"""Plots of adaptation to held-out contexts (thesis, Fig. 5.6 b)."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmark_envs import extrapolation, make_task
from results.adaptation import KINDS, kind_of, yardstick
from results.exceptions import BenchmarkError
from results.plot import line_style, logarithmic_from_zero, task_slug

ROLLOUTS_PER_UPDATE = 2  # of the published curves
QUARTILES = (0.25, 0.5, 0.75)

References = Mapping[str, NDArray[np.float64]]


def adaptation_figures(
    curves: pd.DataFrame, labels: Sequence[str], references: References
) -> dict[str, Figure]:
    """Draw a figure for each task; return them by the name of their file.

    :param curves: of `results.records.curves_frame`
    :param labels: the algorithms in the order of the legend
    :param references: published errors of shape (runs, updates), by kind of target
    """
    return {
        f"curves_{task_slug(str(task))}.png": adaptation_curves(on_task, labels, references)
        for task, on_task in curves.groupby("task")
    }


def adaptation_curves(
    curves: pd.DataFrame, labels: Sequence[str], references: References
) -> Figure:
    """Draw the greedy error against rollouts, a panel for each kind of target.

    :param curves: of one task, one row a step
    :param labels: the algorithms in the order of the legend
    :param references: published errors of shape (runs, updates), by kind of target
    """
    unknown = pd.Series(math.nan, curves.index)
    beyond = curves["extrapolation"] if "extrapolation" in curves else unknown
    pairs = zip(curves["target"], beyond, strict=True)
    curves = curves.assign(kind=[kind_of(*pair) for pair in pairs])
    kinds = sorted(set(curves["kind"]))
    n_columns = min(len(kinds), 3)
    n_rows = math.ceil(len(kinds) / n_columns)
    size = (max(5.5 * n_columns, 7.0), 4.4 * n_rows + 1.0)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(n_rows, n_columns, sharey=True, squeeze=False)
    task = str(curves["task"].iloc[0])
    unit = yardstick(task).unit
    handles: dict[str, Artist] = {}
    for axes in panels.flat[len(kinds) :]:
        axes.set_visible(False)
    for axes, kind in zip(panels.flat, kinds, strict=False):
        chosen = curves.loc[curves["kind"] == kind]
        _draw_panel(axes, chosen, labels)
        if kind in references:
            _draw_reference(axes, references[kind])
        axes.set(title=_panel_title(task, kind, chosen), xlabel="rollouts")
        _scale_errors(axes, curves)
        _scale_rollouts(axes, curves)
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
        found, names = axes.get_legend_handles_labels()
        handles |= dict(zip(names, found, strict=True))
    for axes in panels[:, 0]:
        axes.set_ylabel("error of the greedy policy" + (f" [{unit}]" if unit else ""))
    figure.suptitle(
        f"{task}: adaptation to a held-out context; median and quartiles over contexts and seeds"
    )
    names = sorted(handles, key=lambda name: list([*labels, name]).index(name))
    figure.legend(
        [handles[name] for name in names], names,
        loc="outside lower center", ncols=min(4, len(names)), frameon=False,
    )  # fmt: skip
    return figure


def error_quartiles(curves: pd.DataFrame) -> pd.DataFrame:
    """Return the quartiles of the greedy error over runs, one row a count of rollouts.

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
    :return: one of `results.adaptation.KINDS`, and errors of shape (runs, updates)
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


def _panel_title(task: str, kind: str, curves: pd.DataFrame) -> str:
    """Return which contexts a panel is about."""
    if kind in KINDS:
        return f"{kind}: targets {', '.join(str(t) for t in sorted(set(curves['target'])))}"
    _, context = extrapolation(task, int(curves["target"].iloc[0]))
    names = make_task(task).context_names
    return ", ".join(f"{name} {value:g}" for name, value in zip(names, context, strict=True))


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
    axes.set_xlim(0, max(ends))
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


def _draw_reference(axes: Axes, errors: NDArray[np.float64]) -> None:
    rollouts = ROLLOUTS_PER_UPDATE * np.arange(errors.shape[1])
    low, median, high = np.quantile(errors, QUARTILES, axis=0)
    axes.plot(rollouts, median, color="0.35", linewidth=1.2, label="published curve")
    axes.fill_between(rollouts, low, high, color="0.35", alpha=0.1, linewidth=0)
