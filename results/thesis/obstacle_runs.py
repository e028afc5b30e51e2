"""What the figures of thesis 5.2.1 share: runs of the suite obstacles, measured and drawn."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from benchmark_envs.tasks.obstacles import (
    HEIGHTS,
    LEFT,
    RIGHT,
    TOLERANCE,
    touched_ellipses,
    two_humps,
)
from results.harness.records import RolloutRecord, RunRecord
from results.one_context.final_rollouts import draw_scene
from results.report.figure_style import plain_axes
from results.report.frames import rollouts_to_success

FOLDER = SUITE = "obstacles"
FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Outcomes:
    """What came of an algorithm's runs in one context, an entry for each run.

    :param errors: distance from the via-point in m
    :param shapes: distance from the demonstrations' shape in m, see `shape_distance`
    :param touched: ellipses touched
    :param ends: how far start or end lie from y = 0, in m
    :param rollouts: until the greedy policy succeeds for good; infinite where it never does
    """

    errors: FloatArray
    shapes: FloatArray
    touched: FloatArray
    ends: FloatArray
    rollouts: FloatArray

    @property
    def n_solved(self) -> int:
        """How many runs pass the via-point and touch no ellipse."""
        return int(((self.errors <= TOLERANCE) & (self.touched == 0)).sum())


def outcomes(runs: Sequence[RunRecord], which: str = "greedy") -> Outcomes:
    """Return what came of runs.

    :param runs: finished ones in one context
    :param which: the last ``"greedy"`` rollout, or the one before any search, ``"untrained"``
    """
    paths = np.stack([path_of(run, which) for run in runs])
    solved = [
        rollouts_to_success(run.curve["rollouts"], run.curve["greedy_success"]) for run in runs
    ]
    return Outcomes(
        errors=np.array([-(rollout_of(run, which).reward or 0.0) for run in runs]),
        shapes=shape_distance(paths),
        touched=touched_ellipses(paths, ellipses_of(runs[0])).sum(axis=1).astype(float),
        ends=np.abs(paths[:, [0, -1]]).max(axis=1),
        rollouts=np.array(solved),
    )


def rollout_of(run: RunRecord, which: str = "greedy") -> RolloutRecord:
    """Return a rollout of a run's record.

    :param run: a finished one
    :param which: its name
    """
    return run.measured.rollouts[which]


def path_of(run: RunRecord, which: str = "greedy") -> FloatArray:
    """Return the heights over time of a rollout, shape (T,) in m.

    :param run: a finished one
    :param which: its name
    """
    return np.array(rollout_of(run, which).trajectory)[:, 0]


def scene_of(run: RunRecord) -> dict[str, Any]:
    """Return what stands around a run's paths.

    :param run: a finished one
    """
    context = run.measured.context
    return (context.scene if context else None) or {}


def ellipses_of(run: RunRecord) -> FloatArray:
    """Return the ellipses' centres and radii, shape (E, 4) in m.

    :param run: a finished one
    """
    return np.array([[*e["center"], *e["radii"]] for e in scene_of(run)["ellipses"]])


def shape_distance(paths: FloatArray) -> FloatArray:
    """Return the root mean square distance from the nearest curve of the demonstrated shape, (N,).

    All demonstrations are multiples of one curve, so the nearest one is a projection.

    >>> curve = two_humps(np.linspace(LEFT, RIGHT, 200))
    >>> shape_distance(np.stack([1.3 * curve, np.ones(200)])).round(2).tolist()
    [0.0, 0.43]

    :param paths: shape (N, T) in m
    """
    curve = two_humps(np.linspace(LEFT, RIGHT, paths.shape[1]))
    along = paths @ curve / (curve @ curve)
    return np.sqrt(np.mean((paths - np.outer(along, curve)) ** 2, axis=1))


def draw_paths(axes: Axes, runs: Sequence[RunRecord], which: str, colour: str, name: str) -> None:
    """Draw demonstrations, ellipses and via-point, and above them a rollout of each run.

    :param axes: of a panel
    :param runs: finished ones in one context
    :param which: their rollout
    :param colour: of the rollouts
    :param name: of the rollouts in the legend
    """
    x = np.linspace(LEFT, RIGHT, len(path_of(runs[0], which)))
    draw_scene(axes, scene_of(runs[0]))
    shown = np.outer(two_humps(x), HEIGHTS)
    labels = ["demonstrations"] + ["_"] * (len(HEIGHTS) - 1)
    axes.plot(x, shown, color="#56B4E9", linewidth=1, label=labels)
    paths = np.stack([path_of(run, which) for run in runs], axis=1)
    labels = [name] + ["_"] * (len(runs) - 1)
    axes.plot(x, paths, color=colour, linewidth=1.6, alpha=0.8, label=labels)
    plain_axes(axes)
