"""Figure 5.12: far beyond the demonstrations ACNMP's joints move as the expert's do."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from results.harness.records import RunRecord
from results.report.figure_style import plain_axes
from results.report.statistics import quantile
from results.thesis.interface import Finding, Records, ThesisFigure, chosen
from results.thesis.obstacle_runs import kept_points
from results.thesis.real_robot_runs import (
    OURS,
    PICK_AND_PLACE,
    PLACED,
    QUICK_PLACED,
    TWIN,
    heights_text,
)

#: the context that is the furthest from the demonstrations: an object of 9 cm, a tower of 11 cm
NUMBER = 1
LEAST_CORRELATION = 0.95
STILL = 0.1  # degrees: a joint that moves less is held still
MADE = (
    "Pick-and-place in MuJoCo, eight demonstrations of objects of 2 and 6 cm and towers of 2 to 8 "
    "cm, 100 rollouts. Grey: the demonstrations; blue: our expert, whom the reward does not tell "
    "of; red: ACNMP's answer. Shape: for each joint that the expert moves, the correlation over "
    "time of its angle with the expert's, least over joints; in these "
    f"words it is kept where that is at least {LEAST_CORRELATION} in the median run."
)


def least_correlation(run: RunRecord, which: str) -> float:
    """Return the least correlation over joints of a rollout's angles with the expert's.

    Joints that the expert holds still have none.

    :param run: a finished one
    :param which: its rollout, such as ``"greedy"``
    """
    found, expert = angles(run, which), angles(run, "expert")
    return min(
        float(np.corrcoef(one, other)[0, 1])
        for one, other in zip(found.T, expert.T, strict=True)
        if np.ptp(other) > STILL
    )


def angles(run: RunRecord, which: str) -> NDArray[np.float64]:
    """Return a rollout's joint angles, shape (T, 6) in degrees.

    :param run: a finished one
    :param which: its rollout
    """
    return np.degrees(np.array(run.measured.rollouts[which].trajectory))


def findings(records: Records) -> list[Finding]:
    """Return whether the task is solved, and whether the shape is kept.

    :param records: of `PICK_AND_PLACE`
    """
    ours, twins = (chosen(records[PICK_AND_PLACE], label, number=NUMBER) for label in (OURS, TWIN))
    solved, first, by_twin = (
        _solved(ours, "greedy"),
        _solved(ours, "untrained"),
        _solved(twins, "greedy"),
    )
    kept, before, of_twin = (
        [least_correlation(run, which) for run in runs]
        for runs, which in ((ours, "greedy"), (ours, "untrained"), (twins, "greedy"))
    )
    n = len(ours)
    return [
        Finding(
            f"ACNMP solves {heights_text(ours[0])} cm, which the demonstrations alone do not",
            "shown", f"{solved} of {n} runs, before any rollout {first}; {TWIN} {by_twin} of "
            f"{len(twins)}", solved == n and first == 0,
        ),
        Finding(
            "it keeps the demonstrated shape, of which the reward has no term", "shown",
            f"least correlation {quantile(kept, 0.5):.3f} (worst {min(kept):.3f}); before any "
            f"rollout {quantile(before, 0.5):.3f}; {TWIN} {quantile(of_twin, 0.5):.3f}",
            quantile(kept, 0.5) >= LEAST_CORRELATION,
        ),
    ]  # fmt: skip


def _solved(runs: Sequence[RunRecord], which: str) -> int:
    return sum(bool(run.measured.rollouts[which].success) for run in runs)


def draw(records: Records) -> Figure:
    """Draw the six joints over time.

    :param records: of `PICK_AND_PLACE`
    """
    runs = chosen(records[PICK_AND_PLACE], OURS, number=NUMBER)
    figure = Figure(figsize=(13, 6.6), layout="constrained")
    panels = figure.subplots(2, 3, sharex=True)
    for joint, axes in enumerate(panels.flat):
        _draw_joint(axes, runs, joint)
        axes.set_title(runs[0].task.trajectory_names[joint].replace("[rad]", "[degrees]"))
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
    handles, names = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(f"Object and tower of {heights_text(runs[0])} cm, a line for each seed")
    return figure


def _draw_joint(axes: Axes, runs: Sequence[RunRecord], joint: int) -> None:
    shown = np.degrees(np.array(runs[0].measured.more["shown"])[..., joint])
    found, expert = (
        np.array([angles(run, which)[:, joint] for run in some])
        for which, some in (("greedy", runs), ("expert", runs[:1]))
    )
    times = runs[0].task.dt * np.arange(1, found.shape[1] + 1)
    for paths, colour, name in (
        (shown, "0.75", "demonstrations"),
        (found, "#D55E00", "ACNMP"),
        (expert, "#0072B2", "expert"),
    ):
        at = times[kept_points(paths.shape[1], len(times))]
        labels = [name] + ["_"] * (len(paths) - 1)
        axes.plot(at, paths.T, color=colour, linewidth=1.2, label=labels)
    plain_axes(axes)


FIGURE = ThesisFigure("fig-5.12", MADE, (PLACED,), (QUICK_PLACED,), findings, draw)
