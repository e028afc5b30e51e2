"""Figure 5.4: the farther the via-point is from the demonstrations, the less shape is kept."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmark_envs.tasks.obstacles import EXTRAPOLATION_HEIGHTS, HEIGHTS, VIA_X, two_humps
from results.report.figure_style import line_style, plain_axes
from results.report.statistics import mean_interval
from results.thesis.interface import Finding, Records, SuiteRuns, ThesisFigure, chosen
from results.thesis.obstacle_runs import FOLDER, SUITE, Outcomes, draw_paths, outcomes

OURS, THESIS_NETWORK = "ACNMP", "ACNMP, thesis's network"
LABELS = (OURS, THESIS_NETWORK, "twin, nearest", "twin, ridge", "twin, Gaussian process")
NUMBERS = tuple(range(len(EXTRAPOLATION_HEIGHTS)))
QUICK_NUMBERS = (NUMBERS[0], NUMBERS[-1])
MADE = (
    "As in Figure 5.3, via-points at 0.5, 0.6, 0.8 and 1.0 m, 35 rollouts each; the highest "
    "demonstration passes 0.452 m. Shape: root mean square distance from the nearest multiple of "
    "the demonstrated curve. A distance grows where the 95 % bootstrap interval of the difference "
    "between the farthest and the nearest via-point, over seeds, lies above 0."
)


def by_number(records: Records, label: str) -> dict[int, Outcomes]:
    """Return what came of an algorithm's runs in each context that it has runs of.

    :param records: of `FOLDER`
    :param label: the algorithm's
    """
    runs = chosen(records[FOLDER], label)
    numbers = sorted({run.specification.protocol.number or 0 for run in runs})
    return {n: outcomes(chosen(runs, label, number=n)) for n in numbers}


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
    found = by_number(records, label)
    solved = sum(each.n_solved for each in found.values())
    n = sum(len(each.errors) for each in found.values())
    worst = max(float(each.errors.max()) for each in found.values())
    return Finding(
        f"{label} meets the via-point at every distance and touches no ellipse", "shown",
        f"{solved} of {n} runs, at worst {worst:.3g} m off", solved == n,
    )  # fmt: skip


def _loses_shape(records: Records, label: str) -> Finding:
    found = by_number(records, label)
    near, far = (found[end(found)].shapes for end in (min, max))
    n = min(len(near), len(far))
    low, high = (float(bound) for bound in mean_interval(far[:n] - near[:n]))
    medians = ", ".join(
        f"{EXTRAPOLATION_HEIGHTS[k]:g} m: {np.median(each.shapes):.3g}" for k, each in found.items()
    )
    return Finding(
        f"{label} keeps less of the shape the farther the via-point lies", "shown",
        f"median distance {medians} m; difference [{low:.3g}, {high:.3g}] m", low > 0,
    )  # fmt: skip


def draw(records: Records) -> Figure:
    """Draw the trajectories at each distance, and the curves of shape and rollouts.

    :param records: of `FOLDER`
    """
    numbers = list(by_number(records, OURS))
    figure = Figure(figsize=(13, 9.5), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1.5, 1))
    panels = above.subplots(2, len(numbers), sharex=True, sharey=True, squeeze=False)
    for row, label in zip(panels, (OURS, THESIS_NETWORK), strict=True):
        row[0].set_ylabel(f"{label}\ny [m]", fontsize=9)
        for axes, number in zip(row, numbers, strict=True):
            runs = chosen(records[FOLDER], label, number=number)
            draw_paths(axes, runs, "greedy", "#D55E00", "found, a line for each seed")
            solved = outcomes(runs).n_solved
            height = EXTRAPOLATION_HEIGHTS[number]
            axes.set_title(f"via-point at {height:g} m: {solved}/{len(runs)} solved", fontsize=9)
    shape, rollouts = below.subplots(1, 2)
    _draw_curves(shape, records, "shapes", "distance from the demonstrated shape [m]")
    _draw_curves(rollouts, records, "rollouts", "rollouts to success (none: 35+)")
    handles, names = shape.get_legend_handles_labels()
    below.legend(handles, names, loc="outside lower center", ncols=len(LABELS), frameon=False)
    return figure


def _draw_curves(axes: Axes, records: Records, what: str, name: str) -> None:
    highest = max(HEIGHTS) * float(two_humps(VIA_X))
    for label in LABELS:
        found = by_number(records, label)
        beyond = [EXTRAPOLATION_HEIGHTS[n] - highest for n in found]
        values = np.array([np.minimum(getattr(each, what), 36.0) for each in found.values()])
        middle = np.median(values, axis=1)
        style = line_style(label, LABELS)
        axes.plot(beyond, middle, label=label, marker="o", **style)
        low, high = values.min(axis=1), values.max(axis=1)
        axes.fill_between(beyond, low, high, color=style["color"], alpha=0.13, linewidth=0)
    axes.set(xlabel="via-point above the highest demonstration [m]", ylabel=name)
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
