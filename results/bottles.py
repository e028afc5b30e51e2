"""The final greedy paths of the bottles task: which way round they pass, and how they look."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from numpy.typing import ArrayLike

from benchmark_envs.tasks.bottles import BOTTLES, GOAL, START, SUM_OF_RADII
from results.records import Record

BOTTLE_RADIUS = 0.03  # m
STYLES: dict[str, dict[str, Any]] = {  # by mode; colours of Okabe and Ito
    "s": {"color": "#0072B2", "linestyle": "-"},
    "reverse_s": {"color": "#D55E00", "linestyle": "-"},
    "not solved": {"color": "0.55", "linestyle": "--"},
}
NAMES = {"s": "S", "reverse_s": "reverse S", "not solved": "not solved"}


@dataclass(frozen=True)
class FinalPath:
    """The last greedy rollout of a run.

    :param label: the algorithm's
    :param mode: ``"s"``, ``"reverse_s"`` or ``"not solved"``
    :param executed: the hand's path, shape (T, 2) in m
    :param bottles: centres, shape (2, 2) in m
    """

    label: str
    mode: str
    executed: np.ndarray
    bottles: np.ndarray


def mode_of(trajectory: ArrayLike, bottles: ArrayLike = BOTTLES) -> str:
    """Tell on which side of bottle 0 a path passes, where it comes closest to the bottle's y.

    >>> mode_of([[0.5, -0.4], [0.6, -0.2], [0.5, 0.4]])
    's'

    :param trajectory: shape (T, 2) in m
    :param bottles: bottle positions, shape (4,) in m
    :return: ``"s"`` at larger x than the bottle, ``"reverse_s"`` otherwise
    """
    path, (x, y) = np.asarray(trajectory), np.asarray(bottles)[:2]
    nearest = np.argmin(np.abs(path[:, 1] - y))
    return "s" if path[nearest, 0] > x else "reverse_s"


def final_paths(records: Iterable[Record]) -> list[FinalPath]:
    """Return the final greedy paths of the finished runs.

    :param records: of runs on a bottles task
    """
    paths = []
    for record in records:
        if record["outcome"] == "finished":
            greedy = record["greedy"]
            solved = record["curve"]["greedy_success"][-1]
            mode = mode_of(greedy["executed"], greedy["context"]) if solved else "not solved"
            executed, bottles = np.array(greedy["executed"]), np.array(greedy["context"])
            label = record["specification"]["label"]
            paths.append(FinalPath(label, mode, executed, bottles.reshape(2, 2)))
    return paths


def seeds_of(label: str, n_seeds: int) -> str:
    """Return a legend's entry: the algorithm and its number of seeds.

    :param label: the algorithm's
    :param n_seeds: how many of its runs are shown
    """
    return f"{label} ({n_seeds} seed{'s' if n_seeds != 1 else ''})"


def draw_paths(paths: Sequence[FinalPath], labels: Sequence[str]) -> Figure:
    """Draw the final greedy paths, one panel an algorithm, to scale.

    :param paths: of one task, at least one
    :param labels: the algorithms in the order of the panels
    """
    shown = [label for label in labels if any(path.label == label for path in paths)]
    figure = Figure(figsize=(max(6.5, 2.6 * len(shown)), 6.2), layout="constrained")
    panels = figure.subplots(1, len(shown), sharex=True, sharey=True, squeeze=False)[0]
    for axes, label in zip(panels, shown, strict=True):
        _draw_panel(axes, [path for path in paths if path.label == label])
    panels[0].set_ylabel("y [m]")
    handles = [
        *(Line2D([], [], label=name, **STYLES[mode]) for mode, name in NAMES.items()),
        Line2D([], [], color="0.6", linestyle=":", label="nearer, the hand touches the bottle"),
    ]
    figure.suptitle("Executed paths of the final greedy policies, one line a seed")
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _draw_panel(axes: Axes, paths: Sequence[FinalPath]) -> None:
    for bottle in np.unique([path.bottles for path in paths], axis=0).reshape(-1, 2):
        centre = (float(bottle[0]), float(bottle[1]))
        axes.add_patch(Circle(centre, SUM_OF_RADII, fill=False, edgecolor="0.6", linestyle=":"))
        axes.add_patch(Circle(centre, BOTTLE_RADIUS, facecolor="0.75", edgecolor="0.4"))
    alpha = 0.9 if len(paths) <= 10 else 0.5
    for path in paths:
        axes.plot(*path.executed.T, linewidth=1.2, alpha=alpha, **STYLES[path.mode])
    axes.plot(*START, "o", color="black", markersize=6)
    axes.plot(*GOAL, "*", color="black", markersize=11)
    for name, point in (("start", START), ("goal", GOAL)):
        axes.annotate(name, (point[0], point[1]), (8, -4), textcoords="offset points", fontsize=9)
    counts = Counter(path.mode for path in paths)
    shares = ", ".join(f"{counts[mode]} {name}" for mode, name in NAMES.items() if counts[mode])
    axes.set_title(f"{seeds_of(paths[0].label, len(paths))}\n{shares}", fontsize=10)
    axes.set(aspect="equal", xlabel="x [m]", xlim=(0.3, 0.7), ylim=(-0.47, 0.47))
    axes.set_xticks([0.3, 0.5, 0.7])
    axes.spines[["top", "right"]].set_visible(False)
