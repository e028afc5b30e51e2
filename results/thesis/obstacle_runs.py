"""What the figures of thesis 5.2.1 share: runs of the suite obstacles, measured and drawn."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from results.harness.records import RunRecord
from results.one_context.final_rollouts import draw_scene
from results.report.figure_style import plain_axes
from results.report.frames import rollouts_to_success

FOLDER = SUITE = "obstacles"
FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Outcomes:
    """What came of the last greedy rollouts of runs in one context, an entry for each run.

    :param solved: via-point met, no ellipse touched
    :param errors: distance from the via-point in m
    :param shapes: distance from the demonstrations' shape in m
    :param touched: ellipses touched
    :param ends: how far start or end lie from y = 0, in m
    :param rollouts: until the greedy policy succeeds for good; infinite where it never does
    """

    solved: NDArray[np.bool_]
    errors: FloatArray
    shapes: FloatArray
    touched: FloatArray
    ends: FloatArray
    rollouts: FloatArray

    @property
    def n_solved(self) -> int:
        """How many runs are solved."""
        return int(self.solved.sum())


def outcomes(runs: Sequence[RunRecord]) -> Outcomes:
    """Return what came of runs.

    :param runs: finished ones in one context
    """
    rollouts, curves = [run.measured.rollouts["greedy"] for run in runs], [r.curve for r in runs]
    more = [run.measured.more for run in runs]
    since = [rollouts_to_success(each["rollouts"], each["greedy_success"]) for each in curves]
    return Outcomes(
        solved=np.array([bool(each.success) for each in rollouts]),
        errors=np.array([-(each.reward or 0.0) for each in rollouts]),
        shapes=np.array([each["shapes"]["greedy"] for each in more]),
        touched=np.array([each["outcomes"]["greedy"]["touched"] for each in more]),
        ends=np.array([each["outcomes"]["greedy"]["ends"] for each in more]),
        rollouts=np.array(since),
    )


def via_height(run: RunRecord) -> float:
    """Return the height of a run's via-point in m.

    :param run: a finished one
    """
    return float(scene_of(run)["targets"][0][1])


def scene_of(run: RunRecord) -> dict[str, Any]:
    """Return what stands around a run's paths.

    :param run: a finished one
    """
    context = run.measured.context
    return (context.scene if context else None) or {}


def draw_paths(axes: Axes, runs: Sequence[RunRecord], colour: str = "#D55E00") -> None:
    """Draw demonstrations, ellipses and via-point, and above them what each run found.

    :param axes: of a panel
    :param runs: finished ones in one context
    :param colour: of what was found
    """
    scene = scene_of(runs[0])
    draw_scene(axes, scene)
    shown = np.array(runs[0].measured.more["shown"])[..., 0]
    found = np.array([run.measured.rollouts["greedy"].trajectory for run in runs])[..., 0]
    n_time_points, (low, high) = found.shape[1], (scene["along"][end] for end in ("low", "high"))
    for paths, look, name in (
        (shown, {"color": "#56B4E9", "linewidth": 1.0}, "demonstrations"),
        (found, {"color": colour, "linewidth": 1.6, "alpha": 0.8}, "found, a line for each seed"),
    ):
        x = low + (high - low) * kept_points(paths.shape[1], n_time_points) / (n_time_points - 1)
        axes.plot(x, paths.T, label=[name] + ["_"] * (len(paths) - 1), **look)
    plain_axes(axes)


def kept_points(n_kept: int, n_time_points: int) -> NDArray[np.int_]:
    """Return the indices of the time points that a record kept, evenly from the first one on.

    >>> kept_points(3, 9).tolist()
    [0, 3, 6]

    :param n_kept: how many
    :param n_time_points: of how many
    """
    return np.arange(n_kept) * -(-n_time_points // n_kept)
