"""The final greedy rollouts of runs: paths in the plane where the task has one, else over time."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Ellipse, Rectangle

from results.harness.records import RolloutRecord, RunRecord
from results.report.figure_style import COLOURS, plain_axes, seeds_of

UNSOLVED = "not solved"
UNSOLVED_STYLE = {"color": "0.55", "linestyle": "--"}
DASHED = {"color": "0.6", "linestyle": ":"}
SOLID: dict[str, Any] = {"facecolor": "0.75", "edgecolor": "0.4"}
MARKERS = {"start": ("o", 6), "goal": ("*", 11)}


def draw_final_rollouts(runs: Sequence[RunRecord], labels: Sequence[str]) -> Figure:
    """Draw the executed trajectories of the final greedy policies, one column per algorithm.

    Where the runs' contexts differ, only those in the context of the first seed are drawn.

    :param runs: finished ones of one task, at least one
    :param labels: the algorithms in the order of the columns
    """
    runs = _in_one_scene(runs)
    found = {run.specification.label for run in runs}
    shown = [label for label in labels if label in found]
    styles = outcome_styles(runs)
    planar = all(scene_of(run) is not None for run in runs)
    draw = _draw_plane if planar else _draw_over_time
    figure = Figure(figsize=_size(runs[0], len(shown), planar), layout="constrained")
    n_rows = 1 if planar else len(runs[0].task.trajectory_names)
    panels = figure.subplots(n_rows, len(shown), sharex=True, sharey="row", squeeze=False)
    for column, label in enumerate(shown):
        of_label = [run for run in runs if run.specification.label == label]
        draw(list(panels[:, column]), of_label, styles)
        panels[0, column].set_title(_title(label, of_label), fontsize=10)
    _name_rows(list(panels[:, 0]), runs[0], planar)
    figure.suptitle(
        f"{_where(runs)}: executed trajectories of the final greedy policies, one line per seed"
    )
    looks = {**styles, **{name: DASHED for name in _dashed_labels(runs)}}
    handles = [Line2D([], [], label=name, **look) for name, look in looks.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    return figure


def _in_one_scene(runs: Sequence[RunRecord]) -> list[RunRecord]:
    """Return the runs whose scene is that of the first seed; all of them where there is none."""
    first = scene_of(min(runs, key=lambda run: run.specification.seed))
    return [run for run in runs if scene_of(run) == first or first is None]


def _where(runs: Sequence[RunRecord]) -> str:
    asked = runs[0].specification
    return f"{asked.task}, {asked.variant}" if asked.variant else asked.task


def outcome(run: RunRecord) -> str:
    """Return how a run's final rollout ended: its mode, ``solved`` or ``not solved``.

    :param run: a finished one
    """
    rollout = greedy(run)
    if not rollout.success:
        return UNSOLVED
    return rollout.mode.replace("_", " ") or "solved"


def greedy(run: RunRecord) -> RolloutRecord:
    """Return the last greedy rollout of a run.

    :param run: a finished one
    """
    return run.measured.rollouts["greedy"]


def scene_of(run: RunRecord) -> dict[str, Any] | None:
    """Return what to draw of a run's context in the plane, None where there is no plane.

    :param run: a finished one
    """
    context = run.measured.context
    return None if context is None else context.scene


def outcome_styles(runs: Sequence[RunRecord]) -> dict[str, dict[str, Any]]:
    """Return the line's style by outcome; those that no run has are left out.

    :param runs: finished ones
    """
    found = sorted({outcome(run) for run in runs} - {UNSOLVED})
    styles: dict[str, dict[str, Any]] = {
        name: {"color": COLOURS[i % len(COLOURS)], "linestyle": "-"} for i, name in enumerate(found)
    }
    if any(outcome(run) == UNSOLVED for run in runs):
        styles[UNSOLVED] = dict(UNSOLVED_STYLE)
    return styles


def _size(run: RunRecord, n_columns: int, planar: bool) -> tuple[float, float]:
    scene = scene_of(run)
    if planar and scene is not None:
        (left, right), (low, high) = scene["limits"]
        height = 5.0
        return max(6.5, (height * (right - left) / (high - low) + 0.5) * n_columns), height + 1.2
    return max(6.5, 2.8 * n_columns), 1.2 + 1.6 * len(run.task.trajectory_names)


def _title(label: str, runs: Sequence[RunRecord]) -> str:
    counts = Counter(outcome(run) for run in runs)
    shares = ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))
    return f"{seeds_of(label, len(runs))}\n{shares}"


def _alpha(runs: Sequence[RunRecord]) -> float:
    return 0.9 if len(runs) <= 10 else 0.5


def _draw_plane(
    panels: list[Axes], runs: Sequence[RunRecord], styles: Mapping[str, dict[str, Any]]
) -> None:
    (axes,) = panels
    scene = scene_of(runs[0]) or {}
    draw_scene(axes, scene)
    along = scene.get("along")
    for run in runs:
        path = np.array(greedy(run).executed)
        if along is not None:
            path = np.column_stack([np.linspace(along["low"], along["high"], len(path)), path])
        axes.plot(*path.T, linewidth=1.2, alpha=_alpha(runs), **styles[outcome(run)])
    axes.set_aspect("equal" if along is None else "auto")
    axes.set_xlabel(_axis_names(runs[0])[0])
    axes.spines[["top", "right"]].set_visible(False)


def _axis_names(run: RunRecord) -> tuple[str, ...]:
    """Return the names of the plane's axes."""
    along = (scene_of(run) or {}).get("along")
    names = run.task.trajectory_names
    return names if along is None else (along["name"], *names)


def _dashed_labels(runs: Sequence[RunRecord]) -> list[str]:
    """Return what the dashed circles mean."""
    circles = (scene_of(runs[0]) or {}).get("circles", ())
    named = [c["label"] for c in circles if c.get("style") == "dashed" and c.get("label")]
    return list(dict.fromkeys(named))


def draw_scene(axes: Axes, scene: Mapping[str, Any]) -> None:
    """Draw what stands in the plane of the trajectories, and set the limits.

    :param axes: of a panel
    :param scene: of `scene_of`
    """
    for box in scene.get("boxes", ()):
        low, high = np.array(box["low"]), np.array(box["high"])
        axes.add_patch(Rectangle(tuple(low), *(high - low), facecolor="0.8", edgecolor="0.4"))
    for circle in scene.get("circles", ()):
        centre = (float(circle["center"][0]), float(circle["center"][1]))
        dashed = circle.get("style") == "dashed"
        look = {"fill": False, "edgecolor": DASHED["color"], "linestyle": DASHED["linestyle"]}
        axes.add_patch(Circle(centre, circle["radius"], **(look if dashed else SOLID)))
    for ellipse in scene.get("ellipses", ()):
        width, height = (2 * radius for radius in ellipse["radii"])
        axes.add_patch(Ellipse(tuple(ellipse["center"]), width, height, **SOLID))
    for name, point in scene.get("points", {}).items():
        marker, size = MARKERS.get(name, ("s", 6))
        axes.plot(*point, marker, color="black", markersize=size)
        axes.annotate(name, tuple(point), (8, -4), textcoords="offset points", fontsize=9)
    for target in scene.get("targets", ()):
        axes.plot(*target, "o", color="black", markersize=5, zorder=3)
    axes.set(xlim=scene["limits"][0], ylim=scene["limits"][1])


def _draw_over_time(
    panels: list[Axes], runs: Sequence[RunRecord], styles: Mapping[str, dict[str, Any]]
) -> None:
    for run in runs:
        path = np.array(greedy(run).executed)
        times = run.task.dt * np.arange(1, len(path) + 1)
        for axes, values in zip(panels, path.T, strict=True):
            axes.plot(times, values, linewidth=1.2, alpha=_alpha(runs), **styles[outcome(run)])
    for axes in panels:
        plain_axes(axes)
    panels[-1].set_xlabel("time [s]")


def _name_rows(panels: Sequence[Axes], run: RunRecord, planar: bool) -> None:
    names = _axis_names(run)[1:2] if planar else run.task.trajectory_names
    for axes, name in zip(panels, names, strict=True):
        axes.set_ylabel(name)
