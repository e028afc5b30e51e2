"""Figure 5.9: two arms' representations of the same skills come together during training."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from results.harness.records import RunRecord
from results.report.figure_style import COLOURS
from results.thesis.interface import Finding, Records, ThesisFigure, chosen
from results.thesis.transfer_runs import ALONE, FOLDER, FULL, OURS, QUICK

LEAST = 0.8  # agreement in the worst run; of 12 skills, chance has a twelfth
MARKERS = {"3-DoF arm": "o", "4-DoF arm": "^"}
KINDS = ("reach", "push", "peg insertion")
MADE = (
    "Eight views of each of twelve skills and each arm: the trajectory at 9 to 12 random time "
    "points, as in training. Agreement: the share of views whose nearest view of the other arm, in "
    "the latent space itself, is of the same skill. Shuffled: the mean of the same with the other "
    "arm's skills shuffled, a thousand times. Unseen: twelve skills that neither network was "
    "shown, anywhere in the tasks' ranges; they are held against the 95 % quantile of their "
    f"shuffles. {ALONE.capitalize()}: weight 0 of the distance in Eq. 5.4. The map is "
    "scikit-learn's t-SNE of both arms' views, each moment by itself; the agreement does not "
    "depend on it. Seeds from 2 on; 0 and 1 were tuned on."
)


def numbers(runs: Sequence[RunRecord], key: str) -> NDArray[np.float64]:
    """Return a number of every snapshot, shape (N, snapshots).

    :param runs: finished ones
    :param key: of the snapshots
    """
    return np.array([[s[key] for s in run.measured.more["snapshots"]] for run in runs], np.float64)


def findings(records: Records) -> list[Finding]:
    """Return whether the space is common, whether training makes it so, and for which skills.

    :param records: of `FOLDER`
    """
    ours, alone = (chosen(records[FOLDER], label) for label in (OURS, ALONE))
    shown, unseen, apart = (
        numbers(runs, key)
        for runs, key in ((ours, "agreement"), (ours, "unseen"), (alone, "agreement"))
    )
    least, n = float(shown[:, -1].min()), len(ours)
    high = [run.measured.more["snapshots"][-1]["unseen_shuffled"]["high"] for run in ours]
    new, press = int((unseen[:, -1] > high).sum()), numbers(ours, "button")[:, -1]
    return [
        Finding(
            f"after training, both arms put a skill at the same place (at least {LEAST:.0%} agree)",
            "shown", f"{_spread(shown[:, -1])} agree; shuffled {_shuffled(ours):.0%}",
            least >= LEAST,
        ),
        Finding(
            "it is learned: before training, at most half as many agree in any run", "shown",
            f"{_spread(shown[:, 0])}", bool(2 * shown[:, 0].max() <= least),
        ),
        Finding(
            f"the distance in Eq. 5.4 brings it about: of {ALONE}, at most half as many agree",
            "said", f"{_spread(apart[:, -1])}", bool(2 * apart[:, -1].max() <= least),
        ),
        Finding(
            "skills that neither arm was shown are placed alike, too", "not asked",
            f"{_spread(unseen[:, -1])} agree; beyond 95 % of the shuffled in {new} of {n} runs",
            new == n,
        ),
        Finding(
            "the button press of the 3-DoF arm lies nearer to the 4-DoF expert's than to any proxy",
            "not asked", f"in {press.sum():.0f} of {n} runs", bool(press.all()),
        ),
    ]  # fmt: skip


def _spread(values: NDArray[np.float64]) -> str:
    low, high = values.min(), values.max()
    return f"{np.median(values):.0%} ({low:.0%} to {high:.0%} in {len(values)} runs)"


def _shuffled(runs: Sequence[RunRecord]) -> float:
    return float(np.mean([run.measured.more["snapshots"][-1]["shuffled"]["mean"] for run in runs]))


def draw(records: Records) -> Figure:
    """Draw the maps of the first seed, and below them the agreement of all seeds.

    :param records: of `FOLDER`
    """
    ours, alone = (chosen(records[FOLDER], label) for label in (OURS, ALONE))
    more = ours[0].measured.more
    n = len(more["snapshots"])
    figure = Figure(figsize=(3.1 * n, 7.4), layout="constrained")
    grid = figure.add_gridspec(2, n, height_ratios=(1.25, 1))
    for column, snapshot in enumerate(more["snapshots"]):
        axes = figure.add_subplot(grid[0, column])
        _draw_map(axes, snapshot, more["skills"])
        axes.set_title(f"step {snapshot['step']}: {snapshot['agreement']:.0%} agree", fontsize=10)
    _draw_agreement(figure.add_subplot(grid[1, : n // 2 + 1]), ours, alone)
    legend = figure.add_subplot(grid[1, n // 2 + 1 :])
    legend.axis("off")
    legend.legend(handles=_handles(), loc="center", frameon=False, ncols=2, fontsize=9)
    figure.suptitle(f"t-SNE of both arms' representations, seed {ours[0].specification.seed}")
    return figure


def _shade(skill: int, kinds: Sequence[int]) -> tuple[str, float]:
    """Return a skill's colour, by its kind, and its opacity, by its number within the kind."""
    kind = kinds[skill]
    return COLOURS[kind], 0.3 + 0.23 * sum(k == kind for k in kinds[:skill])


def _draw_map(axes: Axes, snapshot: dict[str, Any], kinds: Sequence[int]) -> None:
    points = np.array(snapshot["map"])
    n_each = (len(points) - 2) // 2
    by_arm = points[:n_each], points[n_each:-2]
    for of_arm, marker in zip(by_arm, MARKERS.values(), strict=True):
        for skill, of_skill in enumerate(of_arm.reshape(len(kinds), -1, 2)):
            colour, alpha = _shade(skill, kinds)
            axes.plot(
                *of_skill.T, marker, color=colour, alpha=alpha, markersize=5, markeredgewidth=0
            )
    for point, marker in zip(points[-2:], MARKERS.values(), strict=True):
        axes.plot(*point, marker, color="black", markersize=10, fillstyle="none", markeredgewidth=2)
    axes.set_xticks([])
    axes.set_yticks([])


def _draw_agreement(axes: Axes, ours: Sequence[RunRecord], alone: Sequence[RunRecord]) -> None:
    steps = [s["step"] for s in ours[0].measured.more["snapshots"]]
    at = np.arange(len(steps))
    lines = (
        ("shown skills", numbers(ours, "agreement"), COLOURS[0], "-"),
        ("unseen skills", numbers(ours, "unseen"), COLOURS[2], "--"),
        (f"shown skills, {ALONE}", numbers(alone, "agreement"), COLOURS[1], "-."),
    )
    for name, values, colour, style in lines:
        axes.plot(at, np.median(values, axis=0), style, marker="o", color=colour, label=name)
        low, high = values.min(axis=0), values.max(axis=0)
        axes.fill_between(at, low, high, color=colour, alpha=0.15, linewidth=0)
    axes.axhline(_shuffled(ours), color="0.4", linestyle=":", label="shuffled")
    axes.set(ylim=(0, 1.03), xlabel="training step", ylabel="agreement (median, all runs)")
    axes.set_xticks(at, [str(step) for step in steps])
    axes.grid(alpha=0.25)
    axes.legend(frameon=False, fontsize=9)


def _handles() -> list[Line2D]:
    arms = [
        Line2D([], [], marker=marker, color="0.4", linestyle="", label=arm)
        for arm, marker in MARKERS.items()
    ]
    kinds = [
        Line2D([], [], marker="s", color=colour, linestyle="", label=f"{kind} (4 shades: 4 skills)")
        for kind, colour in zip(KINDS, COLOURS, strict=False)
    ]
    press = Line2D(
        [], [], marker="o", color="black", linestyle="", fillstyle="none",
        label="button press (not shown)",
    )  # fmt: skip
    return [*arms, *kinds, press]


FIGURE = ThesisFigure("fig-5.9", MADE, FULL, QUICK, findings, draw)
