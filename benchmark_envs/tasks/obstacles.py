"""`nmp/Obstacles-v0`: a curve through a via-point that leaves four ellipses alone (thesis 5.2.1).

The x position advances with time whatever is commanded; y is commanded, and followed exactly. The
demonstrations have two humps each, left and right; the ellipses lie below the lowest of them. The
reward tells of the via-point alone, so that only who keeps the demonstrations' shape clears the
ellipses under the other hump.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from benchmark_envs.registry import register_task
from benchmark_envs.rollouts import BoolArray, FloatArray, Measured
from benchmark_envs.task import Task
from benchmark_envs.tasks.via_points import next_to

T = 200
LEFT, RIGHT = -0.5, 0.5  # m, along x
#: of the demonstrations in the thesis's published code: factors of the curve, and its constants
HEIGHTS = (-0.6, -0.4, -0.2, 0.2, 0.4, 0.6)
HUMPS, WIDTH, LOWERED = (-0.25, 0.25), 0.15, 0.25
VIA_X = -0.26  # m; the thesis's via-point is met at 0.24 of the time
#: m; the thesis's code has 0.6. The highest demonstration is at 0.452 m there
EXTRAPOLATION_HEIGHTS = (0.5, 0.6, 0.8, 1.0)
Y_LIMIT = 1.2  # m
TOLERANCE = 0.02  # m, as in `nmp/ViaPoints-v0`
# Not published. Two under each hump, above and below y = 0, that overlap: no way leads between
# them. The lowest demonstrations clear them by 0.02 m.
#: centre x, y and radii along x, y of each ellipse in m
ELLIPSES = tuple((x, y, 0.1, 0.065) for x in HUMPS for y in (-0.06, 0.06))


@register_task("nmp/Obstacles-v0")
class ObstaclesTask(Task):
    """A point that moves from x = -0.5 to x = 0.5 m in a second, at a height y that is commanded.

    Reward (thesis 5.2.1): minus the distance along y from the via-point, in m, at its x alone,
    where y(x) is linear between the time points; nothing of the ellipses. Success: at most 0.02 m
    from the via-point, and no ellipse touched. ``outcomes["touched"]`` counts those that are, and
    ``outcomes["ends"]`` is how far, in m, start or end lie from y = 0, where all demonstrations
    begin and end. Nothing is simulated: what is executed is what is commanded.

    >>> task = ObstaclesTask()
    >>> shown, beyond = task.demonstrated_contexts, task.extrapolation_contexts
    >>> shown.round(2)[-1].tolist(), beyond[1].tolist()
    ([-0.26, 0.45], [-0.26, 0.6])
    >>> tried = [task.demonstrate(shown[-1]), task.demonstrate(beyond[1])]
    >>> rollouts = task.simulate(beyond[1], tried)
    >>> rollouts.rewards.round(2).tolist(), rollouts.successes.tolist()
    ([-0.15, -0.0], [False, True])
    """

    context_names: tuple[str, ...] = ("via-point x [m]", "via-point y [m]")
    trajectory_names: ClassVar[tuple[str, ...]] = ("y [m]",)
    #: the root mean square of the demonstrations' y is 0.2 m
    exploration_scale: ClassVar[tuple[float, ...]] = (0.2,)
    reward_terms: Mapping[str, str] = {"via_point": "minus the distance from the via-point [m]"}
    step_reward: str = "the distance's term at the time point next to the via-point [m]"
    error_unit: str = "m"
    optimum: tuple[str, float] | None = ("via-point met", 0.0)

    def __init__(self) -> None:
        self.dt = 1 / T
        low, high = np.array([-0.4, -1.0]), np.array([-0.1, 1.0])
        self.context_space = spaces.Box(low.astype(np.float32), high.astype(np.float32))
        self.trajectory_space = spaces.Box(-Y_LIMIT, Y_LIMIT, (T, 1), np.float32)

    @property
    def demonstrated_contexts(self) -> FloatArray:
        """The via-points of the thesis's six demonstrations, shape (6, 2) in m."""
        x = np.full(len(HEIGHTS), VIA_X)
        return np.column_stack([x, np.array(HEIGHTS) * two_humps(x)])

    @property
    def extrapolation_contexts(self) -> FloatArray:
        """Via-points ever farther above them, shape (4, 2) in m; number 1 is the thesis's."""
        return np.array([(VIA_X, height) for height in EXTRAPOLATION_HEIGHTS])

    @property
    def reward_range(self) -> tuple[float, float]:
        """The via-point at one limit and the curve at the other; and the via-point met."""
        return -(1.0 + float(self.trajectory_space.high.max())), 0.0

    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw a via-point of the left hump among the demonstrations, shape (2,).

        :param rng: the generator to draw from
        """
        x, height = rng.uniform(-0.4, -0.1), rng.uniform(min(map(abs, HEIGHTS)), max(HEIGHTS))
        return np.array([x, rng.choice([-1.0, 1.0]) * height * two_humps(x)])

    def initial_trajectory(self, context: ArrayLike) -> FloatArray:
        """Return a constant y of 0 m, from start to end, through all ellipses, shape (T, 1).

        :param context: via-point, shape (2,) in m
        """
        self.check_context(context)
        return np.zeros((T, 1))

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Return the demonstrations' curve as high as the via-point asks for, shape (T, 1) in m.

        Curves lower than 0.17 times `two_humps` touch ellipses; there a via-point lies in one, or
        has hardly room beside it.

        :param context: via-point, shape (2,) in m
        :param mode: there is only ``"default"``
        """
        self.check_mode(mode)
        x, y = self.check_context(context)
        curve = y / two_humps(x) * two_humps(np.linspace(LEFT, RIGHT, T))
        return curve.clip(-Y_LIMIT, Y_LIMIT)[:, None]

    def scene(self, context: ArrayLike) -> dict[str, Any]:
        """Return the ellipses and the via-point; see `Task.scene`.

        :param context: via-point, shape (2,) in m
        """
        via = self.check_context(context)
        ellipses = [{"center": [x, y], "radii": [a, b]} for x, y, a, b in ELLIPSES]
        return {
            "limits": [[LEFT - 0.02, RIGHT + 0.02], [-0.6, 1.1]],
            "along": {"name": "x [m]", "low": LEFT, "high": RIGHT},
            "ellipses": ellipses,
            "targets": [via.tolist()],
        }

    def _execute(self, contexts: FloatArray, trajectories: FloatArray) -> Measured:
        y, rows = trajectories[..., 0], np.arange(len(trajectories))
        left, share = next_to((contexts[:, 0] - LEFT) / (RIGHT - LEFT))
        before, behind = y[rows, left], y[rows, left + 1]
        distances: FloatArray = np.abs(before + share * (behind - before) - contexts[:, 1])
        steps = np.zeros(y.shape)
        steps[rows, left + (share > 0.5)] = -distances
        touched = touched_ellipses(y, np.array(ELLIPSES)).sum(axis=1)
        ends = np.abs(y[:, [0, -1]]).max(axis=1)
        return Measured(
            executed=trajectories,
            terms={"via_point": -distances},
            successes=(distances <= TOLERANCE) & (touched == 0),
            step_rewards=steps,
            outcomes={"touched": touched.astype(np.float64), "ends": ends},
        )


def two_humps(x: ArrayLike) -> FloatArray:
    """Return the curve whose multiples the demonstrations are, of the shape of ``x``.

    Two Gaussian bumps, lowered so that it is 0 at both ends; from the thesis's published code.

    >>> two_humps([-0.5, -0.25, 0.0, 0.25, 0.5]).round(3).tolist()
    [-0.001, 0.754, 0.249, 0.754, -0.001]

    :param x: in m
    """
    x = np.asarray(x, np.float64)
    bumps = [np.exp(-((x - centre) ** 2) / (2 * WIDTH**2)) for centre in HUMPS]
    return np.sum(bumps, axis=0) - LOWERED


def touched_ellipses(y: FloatArray, ellipses: FloatArray) -> BoolArray:
    """Tell which ellipses curves touch or cross, shape (N, E), booleans.

    Curves are linear between time points. Where an ellipse is scaled to a unit circle, a curve
    touches it if one of its segments comes as near as 1 to the centre.

    >>> flat = np.array([np.zeros(200), np.full(200, 0.2)])
    >>> touched_ellipses(flat, np.array(ELLIPSES)).sum(axis=1).tolist()
    [4, 0]

    :param y: at evenly spaced x from -0.5 to 0.5 m, shape (N, T) in m
    :param ellipses: centre x, y and radii along x, y, shape (E, 4) in m
    """
    x = np.broadcast_to(np.linspace(LEFT, RIGHT, y.shape[1]), y.shape)
    points = np.stack([x, y], axis=2)[:, None]  # (N, 1, T, 2)
    scaled = (points - ellipses[:, None, :2]) / ellipses[:, None, 2:]  # (N, E, T, 2)
    start, step = scaled[..., :-1, :], np.diff(scaled, axis=2)
    share = -(start * step).sum(axis=3) / (step**2).sum(axis=3)
    nearest = start + share.clip(0.0, 1.0)[..., None] * step
    return np.asarray(((nearest**2).sum(axis=3) <= 1.0).any(axis=2))
