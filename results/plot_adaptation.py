"""Plots of adaptation to held-out targets (thesis, Fig. 5.6 b)."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from results.adaptation import KINDS, UNITS
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
    figure = Figure(figsize=(11, 5.4), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    task = str(curves["task"].iloc[0])
    handles: dict[str, Artist] = {}
    for axes, (kind, extrapolation) in zip(panels, KINDS.items(), strict=True):
        chosen = curves.loc[curves["extrapolation"] == extrapolation]
        _draw_panel(axes, chosen, labels)
        if kind in references:
            _draw_reference(axes, references[kind])
        targets = ", ".join(str(target) for target in sorted(set(chosen["target"])))
        axes.set(title=f"{kind}: targets {targets or 'none'}", xlabel="rollouts", yscale="log")
        _scale_rollouts(axes, curves)
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
        found, names = axes.get_legend_handles_labels()
        handles |= dict(zip(names, found, strict=True))
    panels[0].set_ylabel(
        "error of the greedy policy" + (f" [{UNITS[task]}]" if task in UNITS else "")
    )
    figure.suptitle(
        f"{task}: adaptation to a held-out target; median and quartiles over targets and seeds"
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
    :return: a key of `results.adaptation.KINDS`, and errors of shape (runs, updates)
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
