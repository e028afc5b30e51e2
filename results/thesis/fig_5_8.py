"""Figure 5.8: three skills that both arms can do, and a fourth that one has to be told."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from results.report.figure_style import COLOURS, plain_axes
from results.thesis.interface import Finding, Records, ThesisFigure, chosen
from results.thesis.transfer_runs import ALONE, FOLDER, FULL, OURS, QUICK

ARMS = {"3dof": "3-DoF arm", "4dof": "4-DoF arm"}
TASKS = {
    "nmp/ArmReach-v0": "proxy: reach",
    "nmp/ArmPush-v0": "proxy: push",
    "nmp/PegInsertion-v0": "proxy: peg insertion",
    "nmp/ButtonPress-v0": "test: button press",
}
ALPHAS = (0.3, 0.55, 1.0)  # of the arm at the beginning, midway and at the end
MADE = (
    "Four skills of each kind, where the recordings of the thesis end, up to 3 degrees and 10 mm "
    "by the seed; a scripted expert for each arm. The button press of the 3-DoF arm's expert is "
    "translated to the 4-DoF arm (Eq. 5.4) and executed in MuJoCo, before any refinement. A cube "
    "that has moved by half a millimetre was touched; solved: 15 mm from its goal at most. "
    "`results/experiments/transfer.md` has the refinement and the twin."
)


def findings(records: Records) -> list[Finding]:
    """Return whether the arms can do what they are to show, and what the translation does.

    :param records: of `FOLDER`
    """
    ours, alone = (
        [run.measured.more for run in chosen(records[FOLDER], label)] for label in (OURS, ALONE)
    )
    solved = np.array([[each["experts"][arm] for arm in ARMS] for each in ours])
    proxies, press = solved[..., :-1], solved[:, 0, -1]
    touched, done, misses = (
        np.array([each[key] for each in ours]) for key in ("touched", "solved", "miss")
    )
    n, by_chance = len(ours), sum(each["touched"] for each in alone)
    return [
        Finding(
            "both arms do the three proxy skills", "shown",
            f"{proxies.sum()} of {proxies.size} demonstrations solve their task in MuJoCo",
            bool(proxies.all()),
        ),
        Finding(
            "the 3-DoF arm does the test skill", "shown", f"{press.sum()} of {n}",
            bool(press.all()),
        ),
        Finding(
            "translated, it is near enough for the 4-DoF arm: the cube is touched",
            "close enough",
            f"touched in {touched.sum()} of {n} runs, solved in {done.sum()}; median miss "
            f"{1000 * np.median(misses):.0f} mm, worst {1000 * misses.max():.0f}; by {ALONE}: "
            f"touched in {by_chance} of {len(alone)}",
            bool(touched.all()),
        ),
    ]  # fmt: skip


def draw(records: Records) -> Figure:
    """Draw one skill of each kind and the test skill from above, by both arms.

    :param records: of `FOLDER`
    """
    drawn = next(
        run.measured.more["scenes"]
        for run in chosen(records[FOLDER], OURS)
        if run.measured.more["scenes"]
    )
    figure = Figure(figsize=(14, 6.6), layout="constrained")
    panels = figure.subplots(len(ARMS), len(TASKS), sharex=True, sharey=True, squeeze=False)
    for scene in drawn:
        row, column = list(ARMS).index(scene["arm"]), list(TASKS).index(scene["task"])
        _draw_scene(panels[row, column], scene)
        panels[row, column].set_title(f"{TASKS[scene['task']]}, {ARMS[scene['arm']]}", fontsize=10)
    for axes in panels[-1]:
        axes.set_xlabel("x [m]")
    for axes in panels[:, 0]:
        axes.set_ylabel("y [m]")
    handles, names = panels[0, -1].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=5, frameon=False)
    figure.suptitle("Experts' rollouts from above: the arm at the beginning, midway and at the end")
    return figure


def _draw_scene(axes: Axes, scene: dict[str, Any]) -> None:
    for corners in scene["boxes"]:
        axes.add_patch(Polygon(corners, facecolor="0.75", edgecolor="0.4"))
    for line, alpha in zip(scene["arm_lines"], ALPHAS, strict=True):
        name = "arm, from base to tip" if alpha == ALPHAS[-1] else None
        axes.plot(*np.array(line).T, "o-", color="0.2", alpha=alpha, markersize=4, label=name)
    path = "path of what is pushed, or else of the tip"
    axes.plot(*np.array(scene["path"]).T, color=COLOURS[0], linewidth=2.5, label=path)
    axes.plot(*scene["target"], "*", color=COLOURS[1], markersize=13, label="target")
    axes.set(aspect="equal", xlim=(-0.12, 0.55), ylim=(-0.32, 0.24))
    plain_axes(axes)


FIGURE = ThesisFigure("fig-5.8", MADE, FULL, QUICK, findings, draw)
