"""`nmp/Bottles-v0`: pass between two bottles without touching them (thesis 6.2.3, Eq. 6.4).

The hand holds a bottle and travels from the start to the goal, with two bottles standing on the
straight line in between. The path must cross that line between them: an S or a reverse S.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from benchmark_envs.arguments import check_flag
from benchmark_envs.exceptions import TaskError
from benchmark_envs.executor import SensorLog
from benchmark_envs.motion import interpolate, resample
from benchmark_envs.mujoco_task import MujocoTask
from benchmark_envs.registry import register_task
from benchmark_envs.rollouts import BoolArray, FloatArray, Measured

T = 200
START = np.array([0.5, -0.4])  # m
GOAL = np.array([0.5, 0.4])  # m
BOTTLES = np.array([0.5, -0.2, 0.5, 0.0])  # m; the thesis's positions
BOTTLE_RADIUS = 0.03  # m
SUM_OF_RADII = 0.065  # m; of a bottle and the hand (0.035)
BOTTLE_HEIGHT = 0.18  # m
WORKSPACE = np.array([[0.1, -0.6], [0.9, 0.6]])  # m; low and high corner
SUBSTEPS = 2  # of 5 ms: a rollout lasts 2 s
GOAL_TOLERANCE = 0.02  # m
FALLEN = math.cos(math.radians(15))  # a bottle that leans more has been knocked over
SIDE_MARGIN = 1e-3  # m; a hand this close to the line of the bottles has not changed sides
LONGEST = 10.0  # m; longer paths than this cost no more, so that the reward is bounded
OPTIMUM = -0.129  # reward of the shortest path in the thesis's arrangement, 0.860 m long
PLANE = [[0.3, 0.7], [-0.47, 0.47]]  # m; the part of the workspace that matters
DOWN, NOT_CROSSED, PER_METRE = -2.0, -4.0, -0.15  # Eq. 6.4


@register_task("nmp/Bottles-v0")
class BottlesTask(MujocoTask):
    """Two free-standing bottles and a hand that is a planar, servo-driven Cartesian robot.

    Reward (Eq. 6.4): ``-2 N_down - 4 I - 0.15 L`` with the number of bottles touched or fallen,
    1 if the path does not cross between the bottles, and the executed path's length in m. The
    shortest path that solves the thesis's arrangement is 0.860 m long: the optimum is -0.129.
    Success: no bottle down, crossed, and the hand ends within 0.02 m of the goal.

    >>> task = BottlesTask(n_threads=1)
    >>> rollouts = task.simulate(BOTTLES, task.demonstrate(BOTTLES, "reverse_s"))
    >>> round(float(rollouts.rewards[0]), 2), task.mode_of(BOTTLES, rollouts.executed[0])
    (-0.13, 'reverse_s')

    :param random_bottles: draw the bottles' positions for each context instead of the thesis's
    :param n_threads: of the simulator; by default one per core
    """

    context_names: tuple[str, ...] = (
        "bottle 0 x [m]",
        "bottle 0 y [m]",
        "bottle 1 x [m]",
        "bottle 1 y [m]",
    )
    trajectory_names: ClassVar[tuple[str, ...]] = ("hand x [m]", "hand y [m]")
    modes: ClassVar[tuple[str, ...]] = ("s", "reverse_s")
    # Chosen on seeds from 1000 on: REPS, DREPS, GA and RC-NMP all find the crossing twice as fast
    # as with 0.15 m along the direction of travel too.
    exploration_scale: ClassVar[tuple[float, ...]] = (0.15, 0.03)
    reward_terms: Mapping[str, str] = {
        "bottles_down": "-2 for each bottle that was touched or fell",
        "not_crossed": "-4 if the path does not cross between the bottles",
        "length": "-0.15 per metre of the executed path",
    }
    frame_every: ClassVar[float] = 4

    def __init__(self, random_bottles: bool = False, n_threads: int | None = None) -> None:
        self.random_bottles = check_flag("random_bottles", random_bottles)
        self.optimum = None if random_bottles else ("shortest path", OPTIMUM)
        self.context_space = spaces.Box(
            np.array([0.45, -0.25, 0.45, -0.05], np.float32),
            np.array([0.55, -0.15, 0.55, 0.10], np.float32),
            dtype=np.float32,
        )
        self.trajectory_space = spaces.Box(
            np.broadcast_to(WORKSPACE[0], (T, 2)).astype(np.float32),
            np.broadcast_to(WORKSPACE[1], (T, 2)).astype(np.float32),
            dtype=np.float32,
        )
        model = mujoco.MjModel.from_xml_path(str(Path(__file__).with_name("bottles.xml")))
        super().__init__(model, SUBSTEPS, n_threads)

    @property
    def reward_range(self) -> tuple[float, float]:
        """Both bottles down, not crossed, the longest path; and the straight line's length."""
        return 2 * DOWN + NOT_CROSSED + PER_METRE * LONGEST, PER_METRE * (0.8 - GOAL_TOLERANCE)

    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        """Return the thesis's bottle positions, or a draw with ``random_bottles``, shape (4,).

        The drawn bottles stand 0.19 to 0.26 m apart, so that the gap is never narrower than
        0.06 m for the hand's centre.

        :param rng: the generator to draw from
        """
        if not self.random_bottles:
            return BOTTLES.copy()
        x = rng.uniform(0.47, 0.53, size=2)
        y = rng.uniform(-0.24, -0.16)
        return np.array([x[0], y, x[1], y + rng.uniform(0.19, 0.26)])

    def initial_trajectory(self, context: ArrayLike) -> FloatArray:
        """Return the straight line from start to goal, shape (T, 2) in m.

        :param context: bottle positions, shape (4,) in m
        """
        self.check_context(context)
        return START + np.linspace(0.0, 1.0, T)[:, None] * (GOAL - START)

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Return the shortest path that passes the bottles with 5 mm to spare, shape (T, 2) in m.

        :param context: bottle positions, shape (4,) in m
        :param mode: ``"s"`` passes bottle 0 at its right (larger x), ``"reverse_s"`` at its left
        """
        bottles = self.check_context(context).reshape(2, 2)
        side = 1.0 if self.check_mode(mode) == "s" else -1.0
        path = taut_path(bottles, SUM_OF_RADII + 0.005, side)
        return resample(path, T)

    def mode_of(self, context: ArrayLike, executed: ArrayLike) -> str:
        """Tell on which side of bottle 0 a path passes, where it comes closest to the bottle's y.

        :param context: bottle positions, shape (4,) in m
        :param executed: shape (T, 2) in m
        :return: ``"s"`` at larger x than the bottle, ``"reverse_s"`` otherwise
        """
        path, (x, y) = np.asarray(executed), np.asarray(context)[:2]
        nearest = np.argmin(np.abs(path[:, 1] - y))
        return "s" if path[nearest, 0] > x else "reverse_s"

    def scene(self, context: ArrayLike) -> dict[str, Any]:
        """Return start, goal, the bottles and how near the hand may come; see `Task.scene`.

        :param context: bottle positions, shape (4,) in m
        """
        centers = self.check_context(context).reshape(2, 2).tolist()
        kinds = (
            (BOTTLE_RADIUS, "solid", "bottle"),
            (SUM_OF_RADII, "dashed", "nearer, the hand touches the bottle"),
        )
        return {
            "limits": PLANE,
            "points": {"start": START.tolist(), "goal": GOAL.tolist()},
            "circles": [
                {"center": center, "radius": radius, "style": style, "label": label}
                for center in centers
                for radius, style, label in kinds
            ],
            "boxes": [],
        }

    def _initial_state(self, context: FloatArray) -> FloatArray:
        """Hand at the start, bottles upright at their places, everything at rest."""
        qpos = self.model.qpos0.copy()
        for name, value in (("hand_x", START[0]), ("hand_y", START[1])):
            qpos[self.model.joint(name).qposadr[0]] = value
        for i, bottle in enumerate(context.reshape(2, 2)):
            address = self.model.joint(f"bottle_{i}").qposadr[0]
            qpos[address : address + 3] = *bottle, BOTTLE_HEIGHT / 2
        return self.executor.initial_state(qpos)

    def _controls(self, contexts: FloatArray, followed: FloatArray) -> FloatArray:
        """Set-points and their rates for the servos, shape (N, T * SUBSTEPS, 4)."""
        positions = interpolate(START, followed, SUBSTEPS)
        before = np.concatenate(
            [np.broadcast_to(START, (len(positions), 1, 2)), positions[:, :-1]], axis=1
        )
        return np.concatenate([positions, (positions - before) / self.model.opt.timestep], axis=2)

    def _measure(self, contexts: FloatArray, trajectories: FloatArray, log: SensorLog) -> Measured:
        executed = np.concatenate([log.readings["hand_x"], log.readings["hand_y"]], axis=2)
        down = bottles_down(log)
        crossed = crosses_between(executed, contexts.reshape(-1, 2, 2))
        length = np.minimum(path_length(executed), LONGEST)
        at_goal = np.linalg.norm(executed[:, -1] - GOAL, axis=1) <= GOAL_TOLERANCE
        return Measured(
            executed=executed,
            terms={
                "bottles_down": DOWN * down,
                "not_crossed": NOT_CROSSED * ~crossed,
                "length": PER_METRE * length,
            },
            successes=(down == 0) & crossed & at_goal,
            paths={f"bottle_{i}": log.readings[f"bottle_{i}_position"] for i in (0, 1)},
        )


def bottles_down(log: SensorLog) -> NDArray[np.int_]:
    """Count the bottles that were touched above their base or lean, shape (N,).

    :param log: of the sensors ``bottle_{0,1}_touch`` and ``bottle_{0,1}_axis``
    """
    down = []
    for i in (0, 1):
        touched = (log.peaks[f"bottle_{i}_touch"] > 0).any(axis=(1, 2))
        leans = (log.readings[f"bottle_{i}_axis"][:, :, 2] < FALLEN).any(axis=1)
        down.append(touched | leans)
    return np.sum(down, axis=0)


def crosses_between(paths: FloatArray, bottles: FloatArray) -> BoolArray:
    """Tell which paths change sides between the bottles an odd number of times, shape (N,).

    A change of side counts where it meets the line through the bottles between their centres.

    :param paths: shape (N, T, 2) in m
    :param bottles: where they stand at the start, shape (N, 2, 2) in m
    """
    first, second = bottles[:, None, 0], bottles[:, None, 1]
    distance = np.linalg.norm(second - first, axis=-1)
    along = (second - first) / distance[..., None]
    across = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    s = np.sum((paths - first) * along, axis=-1)
    d = np.sum((paths - first) * across, axis=-1) - SIDE_MARGIN
    changes = (d[:, 1:] > 0) != (d[:, :-1] > 0)
    step = np.where(changes, d[:, 1:] - d[:, :-1], 1.0)
    meets = s[:, :-1] - d[:, :-1] / step * (s[:, 1:] - s[:, :-1])
    inside = changes & (meets > 0) & (meets < distance)
    return inside.sum(axis=1) % 2 == 1


def path_length(paths: FloatArray) -> FloatArray:
    """Return the lengths of paths, shape (N,) in m.

    :param paths: shape (N, T, 2) in m
    """
    return np.linalg.norm(np.diff(paths, axis=1), axis=2).sum(axis=1)


def taut_path(bottles: FloatArray, radius: float, side: float) -> FloatArray:
    """Return the shortest path from start to goal around both bottles, as dense points in m.

    A string pulled tight: tangent, arc around bottle 0, inner tangent, arc around bottle 1,
    tangent.

    :param bottles: centres, shape (2, 2) in m
    :param radius: distance to keep from the centres, in m
    :param side: +1 passes bottle 0 at larger x and bottle 1 at smaller x, -1 the other way round
    :return: shape (K, 2) in m
    :raises TaskError: the bottles stand too close together
    """
    gap = bottles[1] - bottles[0]
    distance = float(np.linalg.norm(gap))
    if distance <= 2 * radius:
        raise TaskError(
            f"the bottles stand {distance:.3f} m apart, and the expert needs more than "
            f"{2 * radius:.3f} m to pass between them."
        )

    def tangent_angle(centre: FloatArray, point: FloatArray, turn: float) -> float:
        """Angle, seen from the centre, at which a string to the point leaves the circle."""
        to_point = point - centre
        return math.atan2(to_point[1], to_point[0]) + turn * math.acos(
            min(1.0, radius / float(np.linalg.norm(to_point)))
        )

    heading = math.atan2(gap[1], gap[0])
    inner = math.acos(2 * radius / distance)
    angles = (
        (tangent_angle(bottles[0], START, side), heading - side * inner),
        (heading + math.pi - side * inner, tangent_angle(bottles[1], GOAL, side)),
    )
    points = [START]
    for bottle, (begin, end), turn in zip(bottles, angles, (side, -side), strict=True):
        sweep = (end - begin + math.pi) % (2 * math.pi) - math.pi
        if turn * sweep < 0:  # the string does not touch this bottle
            begin, sweep = begin + sweep / 2, 0.0
        arc = begin + np.linspace(0.0, sweep, 50)
        points.extend(bottle + radius * np.stack([np.cos(arc), np.sin(arc)], axis=1))
    return np.array([*points, GOAL])
