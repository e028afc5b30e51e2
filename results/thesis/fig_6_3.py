"""Figure 6.3: RC-NMP passes well-spread via-points and misses crowded ones."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from results.harness.records import RunRecord
from results.report.figure_style import COLOURS, plain_axes
from results.thesis.interface import Finding, Records, SuiteRuns, ThesisFigure, chosen

FOLDER, OURS, VARIANT = "via-points", "RC-NMP", "4 points"
PASSED = 0.01  # m: nearer than a line is wide in the thesis's figure
MADE = (
    "Every run searches a curve through 4 points drawn at random, in 300 rollouts, without a PD "
    "controller. Shown are the runs that end with the least and the largest error. The steepness "
    "of a problem is the largest slope between two points that follow each other. A jump in a "
    "curve is where crossover passes from one parent to another; stored rollouts are parents "
    "too, so jumps add up. Only a controller would smooth them, and the task does not punish them."
)


def points_of(run: RunRecord) -> NDArray[np.float64]:
    """Return a run's via-points from left to right, shape (P, 2) in m.

    :param run: a finished one
    """
    context = run.measured.context
    scene = {} if context is None or context.scene is None else context.scene
    points = np.array(scene["targets"], np.float64)
    return points[np.argsort(points[:, 0])]


def steepness(points: NDArray[np.float64]) -> float:
    """Return the largest slope between points that follow each other.

    :param points: shape (P, 2), from left to right
    """
    if len(points) < 2:
        return 0.0
    steps = np.diff(points, axis=0)
    return float((np.abs(steps[:, 1]) / np.maximum(steps[:, 0], 1e-6)).max())


def final_error(run: RunRecord) -> float:
    """Return the mean distance from the points of the best rollout, in m.

    :param run: a finished one
    """
    return -float(run.curve["best_reward"][-1])


def by_error(records: Records) -> list[RunRecord]:
    """Return RC-NMP's runs, the best first.

    :param records: of `FOLDER`
    """
    return sorted(chosen(records[FOLDER], OURS, VARIANT), key=final_error)


def findings(records: Records) -> list[Finding]:
    """Return whether easy problems are solved, and whether those that are not are steep ones.

    :param records: of `FOLDER`
    """
    runs = by_error(records)
    best, worst = runs[0], runs[-1]
    half = len(runs) // 2
    slopes = [steepness(points_of(run)) for run in runs]
    easy, hard = (float(np.median(part)) for part in (slopes[:half], slopes[half:]))
    return [
        Finding(
            f"it finds a curve through well-spread points (mean distance below {PASSED} m)",
            "shown", f"{final_error(best):.4f} m in the best of {len(runs)} problems",
            final_error(best) < PASSED,
        ),
        Finding(
            "a configuration with a sharp turn is not solved",
            "shown", f"{final_error(worst):.4f} m in the worst problem",
            final_error(worst) >= PASSED,
        ),
        Finding(
            "points close in x and far apart in y are what makes a problem hard",
            "shown", f"median of the largest slopes {easy:.1f} where the error is small, "
            f"{hard:.1f} where it is large",
            half > 0 and hard > easy,
        ),
    ]  # fmt: skip


def draw(records: Records) -> Figure:
    """Draw the runs with the least and the largest error.

    :param records: of `FOLDER`
    """
    runs = by_error(records)
    figure = Figure(figsize=(10, 4.8), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, run in zip(panels, (runs[0], runs[-1]), strict=True):
        _draw(axes, run)
    panels[0].set_ylabel("y [m]")
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _draw(axes: Axes, run: RunRecord) -> None:
    path = np.array(run.measured.rollouts["greedy"].trajectory)[:, 0]
    axes.plot(np.linspace(0, 1, len(path)), path, color=COLOURS[0], linewidth=2.0, label=OURS)
    axes.plot(*points_of(run).T, "o", color="black", markersize=7, label="via-points")
    asked = run.specification
    axes.set_title(
        f"problem {asked.seed}: mean distance {final_error(run):.4f} m after {asked.budget} "
        "rollouts",
        fontsize=10,
    )
    axes.set_xlabel("x [m]")
    plain_axes(axes)


FIGURE = ThesisFigure(
    "fig-6.3",
    MADE,
    full=(SuiteRuns(FOLDER, "via-points", (OURS,), variants=(VARIANT,)),),
    quick=(SuiteRuns(FOLDER, "via-points", (OURS,), n_seeds=3, budget=100, variants=(VARIANT,)),),
    findings=findings,
    draw=draw,
)
