"""`nmp/Push-v0`: a planar arm of three joints pushes a cylinder to a target (thesis 5.2.2).

The thesis and the work it compares with (a ProMP a target with REPS) give nine of ten targets with
demonstrations and learn the tenth. `leave_one_out` makes that split.
"""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from benchmark_envs.cache import ContextCache
from benchmark_envs.exceptions import TaskError
from benchmark_envs.executor import SensorLog
from benchmark_envs.motion import interpolate
from benchmark_envs.mujoco_task import MujocoTask
from benchmark_envs.registry import register_task
from benchmark_envs.rollouts import BoolArray, FloatArray, Measured
from benchmark_envs.tasks.push_expert import (
    APPROACH_DEPTH,
    POCKET_DEPTH,
    headings,
    inverse_kinematics,
    pocket_pose,
    two_moves,
)

T = 300
JOINTS = ("joint_1", "joint_2", "joint_3")
OBJECT = ("object_x", "object_y")
START = np.array([-0.5106, 2.4228, -0.9142])  # rad
CYLINDER = np.array([0.2796, -0.0624])  # m; where it stands at first
JOINT_LIMIT = 3.5  # rad
SUBSTEPS = 3  # of 1/60 s: 0.05 s per time point, 15 s per rollout
GOAL_TOLERANCE = 0.03  # m
PUSHED = 0.01  # m; a cylinder that rests nearer to its start has not been pushed anywhere
FARTHEST = 0.5  # m; an error of the path counts no more than this, so that the reward is bounded
FARTHEST_END = 1.0  # m; the same for the final distance
#: by the name of the reward: its only term's meaning and unit
REWARDS = {
    "path": ("minus the sum over time of the squared distance to the expert's path [m²]", "m²"),
    "goal": ("minus the cylinder's final distance to the target [m]", "m"),
}
STEP_REWARD = "minus the cylinder's squared distance to the expert's path at that time point [m²]"

#: the ten targets of the thesis, numbered from 0, x and y in m
TARGETS = np.array(
    [
        [0.353, -0.161],
        [0.278, -0.236],
        [0.203, -0.286],
        [0.403, -0.086],
        [0.378, 0.113],
        [0.303, 0.188],
        [0.203, 0.288],
        [-0.097, 0.364],
        [0.043, 0.338],
        [-0.257, 0.238],
    ]
)
#: the ends of the arc, which lie outside the other nine; the eight others are interpolation
EXTRAPOLATION_TARGETS = (2, 9)

#: where targets are drawn from, about the base: bearing in degrees and distance in m
BEARINGS = (-60.0, 140.0)
DISTANCES = (0.33, 0.42)

REFINEMENTS = 6  # simulations in which the expert corrects its aim
ACCURACY = 0.01  # m; the expert is content with this
CACHED_SOLUTIONS = 4096  # of the expert; 12 kB each


@register_task("nmp/Push-v0")
class PushTask(MujocoTask):
    """A cylinder on a table, a planar arm with a U-shaped hand, and a target.

    Reward ``"path"`` (the thesis's): minus the sum, over the time points, of the squared distance
    in m^2 between the cylinder's path and its path under the expert's trajectory for that target;
    `Rollouts.step_rewards` holds the summands. Reward ``"goal"``: minus the cylinder's final
    distance to the target in m. Success, with both: that distance is at most 0.03 m.

    What a rollout achieved (`Rollouts.achieved_contexts`) is the target where the cylinder came to
    rest, unless it was hardly moved.

    Replaying the joint angles of the eight recordings that are left of the thesis's experiment
    moves the cylinder along the recorded paths with a mean error of 0.7 mm, 0.4 mm at the end.

    The path reward needs the expert, so `simulate` raises `TaskError` in a context that the expert
    cannot solve; the goal reward takes any.


    >>> task = PushTask(reward="goal", n_threads=1)
    >>> held = task.initial_trajectory(task.targets[0])
    >>> round(float(task.simulate(task.targets[0], held).rewards[0]), 3), task.error_unit
    (-0.123, 'm')

    :param reward: ``"path"`` or ``"goal"``
    :param n_threads: of the simulator; by default one per core
    :raises TaskError: no such reward
    """

    context_names: tuple[str, ...] = ("target x [m]", "target y [m]")
    trajectory_names: ClassVar[tuple[str, ...]] = (
        "joint 1 [rad]",
        "joint 2 [rad]",
        "joint 3 [rad]",
    )
    tells_achievement: bool = True
    exploration_scale: ClassVar[tuple[float, ...]] = (0.1, 0.1, 0.1)
    frame_every: ClassVar[float] = 2
    #: numbered targets, shape (10, 2) in m, for `leave_one_out`
    targets: ClassVar[FloatArray] = TARGETS

    def __init__(self, reward: str = "path", n_threads: int | None = None) -> None:
        if not isinstance(reward, str) or reward not in REWARDS:
            raise TaskError(f"no reward '{reward}' of PushTask; there are {', '.join(REWARDS)}.")
        self.reward = reward
        meaning, self.error_unit = REWARDS[reward]
        self.reward_terms: Mapping[str, str] = {reward: meaning}
        self.step_reward = STEP_REWARD if reward == "path" else ""
        self.context_space = spaces.Box(
            np.array([-0.35, -0.40], np.float32), np.array([0.45, 0.45], np.float32)
        )
        self.trajectory_space = spaces.Box(-JOINT_LIMIT, JOINT_LIMIT, (T, 3), np.float32)
        model = mujoco.MjModel.from_xml_path(str(Path(__file__).with_name("push.xml")))
        super().__init__(model, SUBSTEPS, n_threads)
        self._solutions = ContextCache(self._refine, CACHED_SOLUTIONS)

    @property
    def reward_range(self) -> tuple[float, float]:
        """As far away as counts all the time, or at the end; and no error at all."""
        return (-T * FARTHEST**2 if self.reward == "path" else -FARTHEST_END), 0.0

    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw a target from the band around the arc of the ten targets, shape (2,) in m.

        :param rng: the generator to draw from
        """
        bearing = np.radians(rng.uniform(*BEARINGS))
        return rng.uniform(*DISTANCES) * np.array([np.cos(bearing), np.sin(bearing)])

    def initial_trajectory(self, context: ArrayLike) -> FloatArray:
        """Return the start pose, held, shape (T, 3) in rad.

        :param context: the target, shape (2,) in m
        """
        self.check_context(context)
        return np.tile(START, (T, 1))

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Return the expert's trajectory, which always succeeds, shape (T, 3) in rad.

        It moves as the thesis's recordings do (`push_expert`), and ends within 0.02 m of the
        target where `sample_context` draws one. The expert tries its plan in simulation and
        corrects its aim by the error it sees. The same target gives the same trajectory.

        :param context: the target, shape (2,) in m
        :param mode: ``"default"``, the only one
        :raises TaskError: the cylinder cannot be pushed to the target
        """
        self.check_mode(mode)
        return self._solutions[self.check_context(context)][0].copy()

    def _drawn(self, context: FloatArray, states: FloatArray) -> tuple[mujoco.MjModel, FloatArray]:
        """Show the target at its place."""
        model = copy.deepcopy(self.model)
        model.body("target").pos[:2] = context
        return model, states

    def _refine(self, target: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the expert's trajectory and the cylinder's path under it.

        Simulate plans, each aimed off by the last one's miss, and keep the best.

        :param target: shape (2,) in m
        :return: shapes (T, 3) in rad and (T, 2) in m
        :raises TaskError: the cylinder cannot be pushed to the target
        """
        aim, best, least = target, None, GOAL_TOLERANCE
        for _ in range(REFINEMENTS):
            plan = self._plan(target, aim)
            if plan is None:
                break
            path = readings(self._run(target[None], plan[None]), OBJECT)[0]
            miss = target - path[-1]
            error = float(np.linalg.norm(miss))
            if error < least:
                best, least = (plan, path), error
            if error <= ACCURACY:
                break
            aim = aim + miss
        if best is None:
            raise TaskError(
                f"the expert cannot push the cylinder to {target.round(4).tolist()} m. It reaches "
                f"the targets that lie {DISTANCES[0]} to {DISTANCES[1]} m from the base at (0, 0), "
                f"at bearings of {BEARINGS[0]:.0f} to {BEARINGS[1]:.0f} degrees."
            )
        return best

    def _plan(self, target: FloatArray, aim: FloatArray) -> FloatArray | None:
        """Return the two moves that bring the cylinder about to ``aim``, None if out of reach."""
        approach, final, offset = headings(target)
        contact = inverse_kinematics(pocket_pose(CYLINDER, approach, APPROACH_DEPTH, 0.0))
        end = inverse_kinematics(pocket_pose(aim, final, POCKET_DEPTH, offset))
        if contact is None or end is None or np.abs(end).max() > JOINT_LIMIT:
            return None
        return two_moves(START, contact, end, T)

    def _initial_state(self, context: FloatArray) -> FloatArray:
        """Arm at the start, cylinder at its place, everything at rest, whatever the target."""
        qpos = np.zeros(self.model.nq)
        for name, value in zip(JOINTS + OBJECT, [*START, *CYLINDER], strict=True):
            qpos[self.model.joint(name).qposadr[0]] = value
        return self.executor.initial_state(qpos)

    def _controls(self, contexts: FloatArray, followed: FloatArray) -> FloatArray:
        """Joint angles, shape (N, T * SUBSTEPS, 3) in rad."""
        return interpolate(START, followed, SUBSTEPS)

    def _measure(self, contexts: FloatArray, trajectories: FloatArray, log: SensorLog) -> Measured:
        path, steps = readings(log, OBJECT), None
        distance = np.linalg.norm(path[:, -1] - contexts, axis=1)
        pushed = np.linalg.norm(path[:, -1] - CYLINDER, axis=1) > PUSHED
        if self.reward == "path":
            steps = self._step_rewards(contexts, path, ~log.diverged)
            error_term = steps.sum(axis=1)
        else:
            error_term = -np.minimum(distance, FARTHEST_END)
        return Measured(
            executed=readings(log, JOINTS),
            terms={self.reward: error_term},
            successes=distance <= GOAL_TOLERANCE,
            paths={"object": path},
            step_rewards=steps,
            achieved_contexts=self.within_contexts(path[:, -1], pushed),
        )

    def _step_rewards(self, contexts: FloatArray, path: FloatArray, ok: BoolArray) -> FloatArray:
        """Return minus the squared distances to the expert's paths, the worst where not ok.

        :param contexts: shape (N, 2) in m
        :param path: of the cylinder, shape (N, T, 2) in m
        :param ok: shape (N,)
        :return: shape (N, T) in m^2
        """
        rewards = np.full(path.shape[:2], -(FARTHEST**2))
        for i in np.flatnonzero(ok):
            square = np.sum((path[i] - self._solutions[contexts[i]][1]) ** 2, axis=1)
            rewards[i] = -np.minimum(square, FARTHEST**2)
        return rewards


def readings(log: SensorLog, names: tuple[str, ...]) -> FloatArray:
    """Return the readings of scalar sensors side by side, shape (N, T, number of names).

    :param log: of those sensors
    :param names: of the sensors
    """
    return np.concatenate([log.readings[name] for name in names], axis=2)
