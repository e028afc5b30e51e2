"""A sheet about one rollout: pictures with their times, where it took place, what came of it."""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from benchmark_envs import Rollouts, Task
from results.one_context.final_rollouts import draw_scene
from results.report.figure_style import COLOURS, DPI, plain_axes

ROWS, COLUMNS = 2, 4  # of pictures
WIDTH = 12.0  # inches of the sheet
PATH_HEIGHT = 3.4  # inches of the path below the pictures


def save_sheet(
    frames: list[NDArray[np.uint8]], task: Task, rollouts: Rollouts, out: Path | BytesIO
) -> None:
    """Write evenly spaced pictures of a rollout above its path.

    :param frames: of shape (H, W, 3), the first one near the rollout's begin, the last one its end
    :param task: which says what context and trajectory mean
    :param rollouts: a batch of one
    :param out: a .png, or what takes its bytes
    """
    height, width = frames[0].shape[:2]
    pictures = ROWS * (WIDTH / COLUMNS * height / width + 0.3)
    figure = Figure((WIDTH, pictures + PATH_HEIGHT + 0.8), layout="constrained")
    parts: Any = figure.subfigures(2, 1, height_ratios=(pictures, PATH_HEIGHT))
    above, below = parts
    chosen = np.linspace(0, len(frames) - 1, ROWS * COLUMNS).round().astype(int)
    for axes, i in zip(above.subplots(ROWS, COLUMNS).flat, chosen, strict=True):
        axes.imshow(frames[i])
        axes.set_title(f"{(i + 1) / task.frames_per_second:.2f} s", fontsize=9)
        axes.set_axis_off()
    figure.suptitle(told(task, rollouts), fontsize=10)
    _draw_path(below, task, rollouts)
    figure.savefig(out, dpi=DPI, format="png")


def told(task: Task, rollouts: Rollouts) -> str:
    """Return what the sheet says above: the context by its names, and the outcome.

    :param task: of the rollout
    :param rollouts: a batch of one
    """
    values = zip(task.context_names, rollouts.contexts[0], strict=True)
    context = ", ".join(f"{name} = {value:.4g}" for name, value in values)
    outcome = "success" if rollouts.successes[0] else "no success"
    return f"{context}\n{outcome}, reward {rollouts.rewards[0]:.4f}"


def _draw_path(figure: SubFigure, task: Task, rollouts: Rollouts) -> None:
    """Draw the path in its plane, where there is one, and beside it each dimension over time."""
    executed, wanted = rollouts.executed[0], rollouts.trajectories[0]
    scene = task.scene(rollouts.contexts[0])
    planar = scene is not None and scene.get("along") is None and executed.shape[1] == 2
    panels = figure.subplots(1, 2 if planar else 1, squeeze=False)[0]
    if planar and scene is not None:
        draw_scene(panels[0], scene)
        panels[0].plot(*wanted.T, color="0.5", linestyle=":", label="set-points")
        panels[0].plot(*executed.T, color=COLOURS[0], label="executed")
        panels[0].set(aspect="equal", xlabel=task.trajectory_names[0])
        panels[0].set_ylabel(task.trajectory_names[1])
        plain_axes(panels[0])
    _draw_over_time(panels[-1], task, wanted, executed)


def _draw_over_time(
    axes: Axes, task: Task, wanted: NDArray[np.floating], executed: NDArray[np.floating]
) -> None:
    times = task.dt * np.arange(1, len(executed) + 1)
    for i, name in enumerate(task.trajectory_names):
        colour = COLOURS[i % len(COLOURS)]
        axes.plot(times, executed[:, i], color=colour, label=name)
        axes.plot(times, wanted[:, i], color=colour, linestyle=":")
    axes.set(xlabel="time [s]   (dotted: set-points)")
    axes.legend(fontsize=8, frameon=False)
    plain_axes(axes)
