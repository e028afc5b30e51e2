"""`nmp/Aperture-v0`: pass through the opening of a wall to a goal (thesis 5.2.2, experiment 2).

A small disc starts at (0, 5), must pass a thick wall through its opening without touching it, and
end at the goal. Where the opening and the goal lie is the context, so the passage happens at
different times in different contexts.
"""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from benchmark_envs.exceptions import InvalidContextError
from benchmark_envs.executor import SensorLog
from benchmark_envs.motion import interpolate, resample
from benchmark_envs.mujoco_task import MujocoTask
from benchmark_envs.registry import register_task
from benchmark_envs.rollouts import FloatArray, Measured

T = 200
START = np.array([0.0, 5.0])  # m
WORLD = np.array([-1.0, 11.0])  # m; low and high bound of either coordinate
LOW = np.array([2.0, 1.0, 3.5, 0.0])  # m; the thesis's ranges of xc, yc, xg, yg
HIGH = np.array([8.0, 9.0, 10.0, 10.0])
GOAL_BEHIND = 1.5  # m; the goal lies at least this far behind the opening's centre
HALF_THICKNESS, HALF_OPENING = 1.0, 1.0  # m; of the wall along x, of the opening along y
SUBSTEPS = 2  # of 20 ms: a rollout lasts 8 s, and a time point is one of 25 frames per second
START_TOLERANCE, GOAL_TOLERANCE = 0.15, 0.15  # m
MIN_CLEARANCE = 0.447  # m; for success
GOOD_CLEARANCE = 0.63  # m; from here on the wall costs nothing
WORST_ERROR = float(np.hypot(*(WORLD[1] - WORLD[[0, 0]])))  # m; bounds each term of the reward
APPROACH = 1.45  # m; the expert turns this far before and behind the opening's centre
ROUNDING = 0.45  # m; of its path that each of its turns takes: none lies inside the wall


@register_task("nmp/Aperture-v0")
class ApertureTask(MujocoTask):
    """A solid wall with one opening, and a disc that is a planar, servo-driven Cartesian robot.

    Reward: ``-start - goal - max(0, 0.63 - clearance)``, each term at most 16.97 m. ``start`` is
    the distance in m of the first set-point to (0, 5), where the robot stands at first whatever
    is commanded; ``goal`` that of the executed path's end to the goal. ``clearance`` is the
    smallest signed distance to the opening's edges inside the wall, taken from the set-points,
    because the wall stops the robot and the executed path does not tell how deep they lie in it.
    Success: start and goal within 0.15 m, an executed clearance of at least 0.447 m, and no
    contact with the wall.

    >>> task = ApertureTask(n_threads=1)
    >>> context = [5.0, 5.0, 9.0, 5.0]
    >>> straight, expert = task.initial_trajectory(context), task.demonstrate(context)
    >>> task.simulate(context, [straight, expert]).successes.tolist()
    [True, True]

    :param n_threads: of the simulator; by default one per core
    """

    context_names: tuple[str, ...] = (
        "opening x [m]",
        "opening y [m]",
        "goal x [m]",
        "goal y [m]",
    )
    trajectory_names: ClassVar[tuple[str, ...]] = ("robot x [m]", "robot y [m]")
    exploration_scale: ClassVar[tuple[float, ...]] = (0.5, 0.5)
    reward_terms: Mapping[str, str] = {
        "start": "minus the first set-point's distance to the start [m]",
        "goal": "minus the distance of the executed path's end to the goal [m]",
        "wall": "minus what the set-points' least clearance lacks of 0.63 m [m]",
    }
    step_reward: str = (
        "a term at the time point it is about [m]: start at the first, wall where the clearance is "
        "least, goal at the last, 0 elsewhere"
    )
    error_unit: str = "m"
    camera: ClassVar[str] = "top"
    frame_every: ClassVar[float] = 1

    def __init__(self, n_threads: int | None = None) -> None:
        self.context_space = spaces.Box(
            LOW.astype(np.float32), HIGH.astype(np.float32), dtype=np.float32
        )
        self.trajectory_space = spaces.Box(
            np.float32(WORLD[0]), np.float32(WORLD[1]), (T, 2), np.float32
        )
        super().__init__(_load_model(), SUBSTEPS, n_threads)
        _, minus_kp, minus_kv = self.model.actuator("robot_x").biasprm[:3]
        damping = self.model.dof_damping[0]
        self._lead = float((damping - minus_kv) / -minus_kp)  # s; then the servo follows v exactly

    @property
    def reward_range(self) -> tuple[float, float]:
        """All three errors at their bound; and none."""
        return -3 * WORST_ERROR, 0.0

    def check_context(self, context: ArrayLike) -> FloatArray:
        """Check the context as `Task.check_context` does, and that the goal lies behind the wall.

        :param context: opening and goal, shape (4,) in m
        :raises InvalidContextError: as there, or the goal lies too near behind the opening
        """
        checked = super().check_context(context)
        if checked[2] < checked[0] + GOAL_BEHIND - 1e-5:
            raise InvalidContextError(
                f"the goal's x is {checked[2]:.6g}, but must be at least the opening's x + "
                f"{GOAL_BEHIND:g} = {checked[0] + GOAL_BEHIND:.6g}, so that it lies behind the "
                f"wall: move the goal, or the opening to x <= {checked[2] - GOAL_BEHIND:.6g}."
            )
        return checked

    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw opening and goal uniformly from the thesis's ranges, shape (4,) in m.

        :param rng: the generator to draw from
        """
        xc, yc = rng.uniform(LOW[:2], HIGH[:2])
        return np.array([xc, yc, rng.uniform(xc + GOAL_BEHIND, HIGH[2]), rng.uniform(0.0, 10.0)])

    def initial_trajectory(self, context: ArrayLike) -> FloatArray:
        """Return the straight line from start to goal, shape (T, 2) in m.

        :param context: opening and goal, shape (4,) in m
        """
        goal = self.check_context(context)[2:]
        return START + np.linspace(0.0, 1.0, T)[:, None] * (goal - START)

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Return a smooth path through the middle of the opening, shape (T, 2) in m.

        It passes at uniform speed from the start by (xc - 1.45, yc) and (xc + 1.45, yc) to the
        goal, as the thesis's synthetic demonstrations do. Its turns are parabolas (a quadratic
        spline) that end before the wall; an interpolating spline would overshoot inside it.

        :param context: opening and goal, shape (4,) in m
        :param mode: ``"default"``, the only one
        """
        xc, yc, *goal = self.check_context(context)
        self.check_mode(mode)
        corners = np.array([START, (xc - APPROACH, yc), (xc + APPROACH, yc), goal])
        return resample(round_corners(corners, ROUNDING), T)

    def scene(self, context: ArrayLike) -> dict[str, Any]:
        """Return start, goal and the wall's two parts; see `Task.scene`.

        :param context: opening and goal, shape (4,) in m
        """
        xc, yc, *goal = self.check_context(context).tolist()
        low, high = WORLD.tolist()
        left, right = xc - HALF_THICKNESS, xc + HALF_THICKNESS
        return {
            "limits": [[low, high], [low, high]],
            "points": {"start": START.tolist(), "goal": goal},
            "circles": [],
            "boxes": [
                {"low": [left, low], "high": [right, yc - HALF_OPENING]},
                {"low": [left, yc + HALF_OPENING], "high": [right, high]},
            ],
        }

    def _drawn(self, context: FloatArray, states: FloatArray) -> tuple[mujoco.MjModel, FloatArray]:
        """Move wall and goal to their places, and the robot back to the frame of the world."""
        model, moved = _load_model(), states.copy()
        moved[:, 1:3] += context[:2]  # after the time
        model.body("wall").pos[:2], model.body("goal").pos[:2] = context[:2], context[2:]
        return model, moved

    def _initial_state(self, context: FloatArray) -> FloatArray:
        """At rest at the start, in the opening's frame."""
        return self.executor.initial_state(START - context[:2])

    def _controls(self, contexts: FloatArray, followed: FloatArray) -> FloatArray:
        """Set-points with velocity feed-forward, shape (N, T * SUBSTEPS, 2), opening's frame.

        MuJoCo reads its sensors at the beginning of a step, so a step's position is commanded for
        its beginning, and its rate leads to the next one.
        """
        positions = interpolate(START, followed, SUBSTEPS) - contexts[:, None, :2]
        rates = np.diff(positions, axis=1, append=positions[:, -1:]) / self.model.opt.timestep
        return positions + self._lead * rates

    def _measure(self, contexts: FloatArray, trajectories: FloatArray, log: SensorLog) -> Measured:
        relative = np.concatenate([log.readings["robot_x"], log.readings["robot_y"]], axis=2)
        executed = relative + contexts[:, None, :2]
        start_error = np.linalg.norm(trajectories[:, 0] - START, axis=1)
        goal_error = np.linalg.norm(executed[:, -1] - contexts[:, 2:], axis=1)
        wanted = clearances(trajectories, contexts[:, :2])
        lacking = np.maximum(0.0, GOOD_CLEARANCE - wanted.min(axis=1))
        start, goal, wall = -np.minimum([start_error, goal_error, lacking], WORST_ERROR)
        step_rewards = np.zeros(wanted.shape)
        step_rewards[:, 0] += start
        step_rewards[np.arange(len(wall)), wanted.argmin(axis=1)] += wall
        step_rewards[:, -1] += goal
        touched = (log.peaks["robot_touch"] > 0).any(axis=(1, 2))
        passed = clearances(executed, contexts[:, :2]).min(axis=1) >= MIN_CLEARANCE
        arrived = (start_error <= START_TOLERANCE) & (goal_error <= GOAL_TOLERANCE)
        return Measured(
            executed=executed,
            terms={"start": start, "goal": goal, "wall": wall},
            successes=~touched & passed & arrived,
            step_rewards=step_rewards,
        )


def _load_model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(Path(__file__).with_name("aperture.xml")))


def clearances(paths: FloatArray, openings: FloatArray) -> FloatArray:
    """Return the smallest signed distance to the opening's edges on the way to each point.

    It is ``1 - |y - yc|`` where ``|x - xc| <= 1``, negative inside the wall's solid parts, and 1,
    its largest value, where the way does not pass through the wall at all. The ways are straight
    lines, the first one from the start. On a line the distance is concave, so its minimum lies at
    an end of the part that is inside: the result is exact, and no path can jump the wall.

    :param paths: shape (N, T, 2) in m
    :param openings: centres, shape (N, 2) in m
    :return: shape (N, T) in m
    """
    start = np.broadcast_to(START, (len(paths), 1, 2))
    points = np.concatenate([start, paths], axis=1) - openings[:, None]
    x, y = points[:, :-1, 0], points[:, :-1, 1]
    dx, dy = np.diff(points[..., 0], axis=1), np.diff(points[..., 1], axis=1)
    upright = np.abs(dx) < 1e-12
    slope = np.where(upright, 1.0, dx)
    faces = [(side * HALF_THICKNESS - x) / slope for side in (-1.0, 1.0)]
    first = np.where(upright, 0.0, np.clip(np.minimum(*faces), 0.0, 1.0))
    last = np.where(upright, 1.0, np.clip(np.maximum(*faces), 0.0, 1.0))
    middle = x + (first + last) / 2 * dx
    inside = np.abs(middle) <= HALF_THICKNESS
    farthest = np.maximum(np.abs(y + first * dy), np.abs(y + last * dy))
    return np.where(inside, HALF_OPENING - farthest, HALF_OPENING)


def round_corners(corners: FloatArray, distance: float) -> FloatArray:
    """Return a polyline with its inner corners replaced by parabolas, as dense points.

    :param corners: shape (K, 2) in m
    :param distance: from the corner at which its parabola begins and ends, in m; less where a
        neighbouring side is shorter than twice of that
    :return: shape (M, 2) in m
    """
    lengths = [float(np.linalg.norm(b - a)) for a, b in pairwise(corners)]
    s = np.linspace(0.0, 1.0, 50)[:, None]
    points = [corners[:1]]
    for i in range(1, len(corners) - 1):
        before, after = lengths[i - 1], lengths[i]
        cut = min(distance, before / 2, after / 2)
        begin = corners[i] + cut / before * (corners[i - 1] - corners[i])
        end = corners[i] + cut / after * (corners[i + 1] - corners[i])
        points.append((1 - s) ** 2 * begin + 2 * s * (1 - s) * corners[i] + s**2 * end)
    return np.concatenate([*points, corners[-1:]])
