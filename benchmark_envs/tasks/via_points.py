"""`nmp/ViaPoints-v0`: a curve over time through one to six points (thesis 6.2.2).

The x position advances with time whatever is commanded; y is commanded, and followed exactly. How
hard a context is depends on how many points there are, and on how near they lie along x.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from benchmark_envs.exceptions import TaskError
from benchmark_envs.registry import register_task
from benchmark_envs.rollouts import BoolArray, FloatArray, Measured
from benchmark_envs.task import Task

T = 200
MOST_POINTS = 6
Y_LOW, Y_HIGH = -1.0, 2.0  # m; a curve may swing past points in [0, 1] to meet the next ones
START_Y = 0.5  # m; the middle of where points lie
# m; less than a tenth of the points' standard deviation (0.29 m): no point is met by chance often,
# and the eye sees the curve go through a point of this radius.
TOLERANCE = 0.02
CURVATURE = 30.0  # of the expert: what squared second differences cost beside first ones
ATTRACTION = 1e6  # of the expert: what squared distances to the points cost beside both


@register_task("nmp/ViaPoints-v0")
class ViaPointsTask(Task):
    """A point that moves from x = 0 to x = 1 m in a second, at a height y that is commanded.

    Reward (thesis 6.2.2): minus the mean of the distances ``|y(x_i) - y_i|`` to the via-points
    ``(x_i, y_i)``, in m, where y(x) is linear between the time points. Success: every distance is
    at most 0.02 m. Nothing is simulated: what is executed is what is commanded.

    A context holds six points, whatever ``n_points`` is, so that what was learned or kept for one
    number of points can be used for another. Where there are fewer, the last one is repeated, and
    **repeated points count once**: the mean is over different points. Drawn points are sorted by
    x; a context that is given may hold them in any order.

    >>> task = ViaPointsTask(n_points=2)
    >>> context = [0.2, 0.3] + 5 * [0.8, 0.9]
    >>> flat, expert = task.initial_trajectory(context), task.demonstrate(context)
    >>> rollouts = task.simulate(context, [flat, expert])
    >>> rollouts.rewards.round(2).tolist(), rollouts.successes.tolist()
    ([-0.3, -0.0], [False, True])

    :param n_points: how many points a drawn context has, 1 to 6; None draws the number too, all
        being equally likely
    :raises TaskError: another number of points
    """

    context_names: tuple[str, ...] = tuple(
        f"point {i} {axis} [m]" for i in range(MOST_POINTS) for axis in "xy"
    )
    trajectory_names: ClassVar[tuple[str, ...]] = ("y [m]",)
    #: the standard deviation of the points' y about the initial trajectory is 0.29 m
    exploration_scale: ClassVar[tuple[float, ...]] = (0.3,)
    reward_terms: Mapping[str, str] = {
        f"point_{i}": f"minus the distance to point {i}, over their number; 0 if a repetition [m]"
        for i in range(MOST_POINTS)
    }
    step_reward: str = "each point's term at the time point next to it [m]"
    error_unit: str = "m"
    optimum: tuple[str, float] | None = ("all points met", 0.0)

    def __init__(self, n_points: int | None = None) -> None:
        if n_points not in (None, *range(1, MOST_POINTS + 1)):
            raise TaskError(
                f"n_points is {n_points}, but a context has 1 to {MOST_POINTS} points; give one "
                "of these numbers, or None to draw it for each context."
            )
        self.n_points = n_points
        self.dt = 1 / T
        self.context_space = spaces.Box(0.0, 1.0, (2 * MOST_POINTS,), np.float32)
        self.trajectory_space = spaces.Box(Y_LOW, Y_HIGH, (T, 1), np.float32)

    @property
    def reward_range(self) -> tuple[float, float]:
        """Every point at 0 and the curve at its highest; and every point met."""
        return -Y_HIGH, 0.0

    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw the points' x and y uniformly from [0, 1] m, sorted by x, shape (12,).

        Each number of points has draws of its own of a generator, so that equally seeded contexts
        of different numbers have no point in common.

        :param rng: the generator to draw from
        """
        n = self.n_points or int(rng.integers(1, MOST_POINTS + 1))
        first = n * (n - 1) // 2  # after one point, two points, ...
        points = rng.uniform(size=(first + n, 2))[first:]
        points = points[np.argsort(points[:, 0])]
        return np.concatenate([points, np.repeat(points[-1:], MOST_POINTS - n, axis=0)]).ravel()

    def initial_trajectory(self, context: ArrayLike) -> FloatArray:
        """Return a constant y of 0.5 m, which knows nothing of the points, shape (T, 1).

        :param context: points, shape (12,) in m
        """
        self.check_context(context)
        return np.full((T, 1), START_Y)

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Return a smooth curve through the points, shape (T, 1) in m.

        A spline under tension: of all curves through the points the one whose first and second
        differences are smallest. Points at the same x pull it to their mean; where points lie too
        near to each other along x, the curve would have to leave the trajectory space.

        :param context: points, shape (12,) in m
        :param mode: there is only ``"default"``
        """
        self.check_mode(mode)
        points = self._points(context)
        left, share = next_to(points[:, 0])
        rows, meets = np.arange(len(points)), np.zeros((len(points), T))
        meets[rows, left], meets[rows, left + 1] = 1 - share, share
        first, second = np.diff(np.eye(T), axis=0), np.diff(np.eye(T), n=2, axis=0)
        cost = first.T @ first + CURVATURE * second.T @ second + ATTRACTION * meets.T @ meets
        curve = np.asarray(np.linalg.solve(cost, ATTRACTION * meets.T @ points[:, 1]), np.float64)
        return curve.clip(Y_LOW, Y_HIGH)[:, None]

    def scene(self, context: ArrayLike) -> dict[str, Any]:
        """Return the points, each once; see `Task.scene`.

        :param context: points, shape (12,) in m
        """
        return {
            "limits": [[-0.02, 1.02], [-0.3, 1.3]],
            "along": {"name": "x [m]", "low": 0.0, "high": 1.0},
            "targets": self._points(context).tolist(),
        }

    def _points(self, context: ArrayLike) -> FloatArray:
        """Return a context's different points, shape (P, 2) in m."""
        points = self.check_context(context).reshape(MOST_POINTS, 2)
        return points[~repeated(points[None])[0]]

    def _execute(self, contexts: FloatArray, trajectories: FloatArray) -> Measured:
        points = contexts.reshape(-1, MOST_POINTS, 2)
        counts = ~repeated(points)
        left, share = next_to(points[..., 0])
        y = trajectories[..., 0]
        before, behind = (np.take_along_axis(y, index, axis=1) for index in (left, left + 1))
        distances: FloatArray = np.abs(before + share * (behind - before) - points[..., 1])
        terms = -np.where(counts, distances, 0.0) / counts.sum(axis=1, keepdims=True)
        steps = np.zeros(y.shape)
        np.add.at(steps, (np.arange(len(y))[:, None], left + (share > 0.5)), terms)
        return Measured(
            executed=trajectories,
            terms={f"point_{i}": terms[:, i] for i in range(MOST_POINTS)},
            successes=np.max(distances, axis=1) <= TOLERANCE,
            step_rewards=steps,
        )


def repeated(points: FloatArray) -> BoolArray:
    """Tell which points are equal to one before them, shape (N, P).

    >>> repeated(np.array([[[0.1, 0.5], [0.2, 0.5], [0.1, 0.5]]])).tolist()
    [[False, False, True]]

    :param points: shape (N, P, 2)
    """
    equal = (points[:, :, None] == points[:, None]).all(axis=3)
    return np.tril(equal, k=-1).any(axis=2)


def next_to(x: FloatArray) -> tuple[NDArray[np.int_], FloatArray]:
    """Return the time point before each x, and the share of the way to the next one that is done.

    >>> next_to(np.array([0.0, 0.5, 1.0]))
    (array([  0,  99, 198]), array([0. , 0.5, 1. ]))

    :param x: in [0, 1] m, any shape
    :return: indices from 0 to T - 2, and shares from 0 to 1, both of the shape of ``x``
    """
    at = np.clip(x, 0.0, 1.0) * (T - 1)
    left = np.minimum(at.astype(int), T - 2)
    return left, at - left
