"""Figure 5.4: the farther the via-point is from the demonstrations, the less shape is kept."""

from itertools import groupby
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from results.harness.records import RunRecord
from results.report.figure_style import line_style, plain_axes
from results.report.statistics import mean_interval
from results.thesis.interface import Finding, Records, SuiteRuns, ThesisFigure, chosen
from results.thesis.obstacle_runs import (
    FOLDER,
    SUITE,
    Outcomes,
    draw_paths,
    outcomes,
    via_height,
)

OURS, THESIS_NETWORK = "ACNMP", "ACNMP, thesis's network"
LABELS = (OURS, THESIS_NETWORK, "twin, nearest", "twin, ridge", "twin, Gaussian process")
#: the nearest and the farthest via-point
QUICK_NUMBERS = (0, 3)
NEVER = 38.0  # drawn for infinitely many rollouts
MADE = (
    "As in Figure 5.3, via-points at 0.5, 0.6, 0.8 and 1.0 m, 35 rollouts each; the highest "
    "demonstration passes 0.452 m. Shape: root mean square distance from the nearest multiple of "
    "the demonstrated curve. A distance grows where the 95 % bootstrap interval of the difference "
    "between the farthest and the nearest via-point, over seeds, lies above 0."
)


def by_height(records: Records, label: str) -> dict[float, list[RunRecord]]:
    """Return an algorithm's runs by the height of their via-point, from the lowest.

    :param records: of `FOLDER`
    :param label: the algorithm's
    """
    runs = sorted(chosen(records[FOLDER], label), key=via_height)
    return {height: list(each) for height, each in groupby(runs, key=via_height)}


def _outcomes(records: Records, label: str) -> dict[float, Outcomes]:
    return {height: outcomes(runs) for height, runs in by_height(records, label).items()}


def findings(records: Records) -> list[Finding]:
    """Return whether the via-point is met at every distance, and how the shape fares.

    :param records: of `FOLDER`
    """
    return [
        finding
        for label in (OURS, THESIS_NETWORK)
        for finding in (_meets(records, label), _loses_shape(records, label))
    ]


def _meets(records: Records, label: str) -> Finding:
    found = _outcomes(records, label)
    solved = sum(each.n_solved for each in found.values())
    n = sum(len(each.errors) for each in found.values())
    worst = max(float(each.errors.max()) for each in found.values())
    return Finding(
        f"{label} meets the via-point at every distance and touches no ellipse", "shown",
        f"{solved} of {n} runs, at worst {worst:.3g} m off", solved == n,
    )  # fmt: skip


def _loses_shape(records: Records, label: str) -> Finding:
    found = _outcomes(records, label)
    near, far = (found[end(found)].shapes for end in (min, max))
    n = min(len(near), len(far))
    low, high = (float(bound) for bound in mean_interval(far[:n] - near[:n]))
    medians = ", ".join(
        f"{height:g} m: {np.median(each.shapes):.3g}" for height, each in found.items()
    )
    return Finding(
        f"{label} keeps less of the shape the farther the via-point lies", "shown",
        f"median distance {medians} m; difference [{low:.3g}, {high:.3g}] m", low > 0,
    )  # fmt: skip


def draw(records: Records) -> Figure:
    """Draw the trajectories at each distance, and the curves of shape and rollouts.

    :param records: of `FOLDER`
    """
    heights = list(by_height(records, OURS))
    figure = Figure(figsize=(13, 9.5), layout="constrained")
    both = cast(NDArray[Any], figure.subfigures(2, 1, height_ratios=(1.5, 1)))
    above, below = both.ravel()
    panels = above.subplots(2, len(heights), sharex=True, sharey=True, squeeze=False)
    for row, label in zip(panels, (OURS, THESIS_NETWORK), strict=True):
        row[0].set_ylabel(f"{label}\ny [m]", fontsize=9)
        for axes, (height, runs) in zip(row, by_height(records, label).items(), strict=True):
            draw_paths(axes, runs)
            solved = outcomes(runs).n_solved
            axes.set_title(f"via-point at {height:g} m: {solved}/{len(runs)} solved", fontsize=9)
    shape, rollouts = np.ravel(below.subplots(1, 2))
    _draw_curves(shape, records, "shapes", "distance from the demonstrated shape [m]")
    _draw_curves(rollouts, records, "rollouts", "rollouts to success (at the top: none)")
    handles, names = shape.get_legend_handles_labels()
    below.legend(handles, names, loc="outside lower center", ncols=len(LABELS), frameon=False)
    return figure


def _draw_curves(axes: Axes, records: Records, what: str, name: str) -> None:
    for label in LABELS:
        found = _outcomes(records, label)
        heights, style = list(found), line_style(label, LABELS)
        values = [np.minimum(getattr(each, what), NEVER) for each in found.values()]
        middle, low, high = (
            [float(summary(each)) for each in values] for summary in (np.median, np.min, np.max)
        )
        axes.plot(heights, middle, label=label, marker="o", **style)
        axes.fill_between(heights, low, high, color=style["color"], alpha=0.13, linewidth=0)
    axes.set(xlabel="height of the via-point [m]; demonstrations reach 0.452 m", ylabel=name)
    axes.set_ylim(bottom=0)
    plain_axes(axes)


FIGURE = ThesisFigure(
    "fig-5.4",
    MADE,
    full=(SuiteRuns(FOLDER, SUITE, LABELS),),
    quick=(SuiteRuns(FOLDER, SUITE, LABELS, n_seeds=1, numbers=QUICK_NUMBERS),),
    findings=findings,
    draw=draw,
)
