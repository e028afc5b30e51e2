"""`PlanarArmTask`: what the skills of the two planar arms share, button press and proxies.

Each skill is a file: a scene (its MJCF), a tool, contexts, and the tool's way for the expert.
"""

import copy
from abc import abstractmethod
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
from benchmark_envs.motion import interpolate, limit_speed
from benchmark_envs.mujoco_task import MujocoTask
from benchmark_envs.rollouts import FloatArray, Measured
from benchmark_envs.tasks.planar_arms import PEG, PlanarArm, approach_and_line

T = 300
SUBSTEPS = 3  # of 1/60 s: 0.05 s per time point, 15 s per rollout
JOINT_LIMIT = 3.5  # rad
FASTEST = 0.1  # rad from one time point to the next; the thesis's recordings move 0.03 at most
FARTHEST = 1.0  # m; a final distance counts no more than this, so that the reward is bounded
OBJECT = ("object_x", "object_y")
TOUCHED = 5e-4  # m; a thing that has moved farther was touched
ARM_HEIGHT = 0.08  # m; of the links
REFINEMENTS = 6  # simulations in which the expert corrects its aim
CACHED = 1024  # solutions of the expert
#: the boxes of each tool, in the frame of its mount: place and half-sizes, x along the tool, in m
TOOLS: Mapping[str, tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...]] = {
    "peg": (((PEG / 2, 0.0, -0.07), (PEG / 2, 0.006, 0.004)),),
    "pocket": (
        ((0.01927, 0.0, -0.055), (0.01, 0.0375, 0.01)),
        ((0.05677, 0.0475, -0.055), (0.0375, 0.01, 0.01)),
        ((0.05677, -0.0475, -0.055), (0.0375, 0.01, 0.01)),
    ),
}


def arm_model(arm: PlanarArm, tool: str, scene: Path) -> mujoco.MjModel:
    """Return a scene with an arm in it.

    The joints are named ``joint_1`` on, as their position servos and sensors are; the tool's boxes
    ``tool_1`` on.

    :param arm: which
    :param tool: ``"peg"`` or ``"pocket"``
    :param scene: MJCF without an arm
    """
    spec = mujoco.MjSpec.from_file(str(scene))
    body, reach = spec.worldbody, (0.0, 0.0, ARM_HEIGHT)
    lengths = [*arm.links, arm.mount]
    for i, (length, offset) in enumerate(zip(lengths, arm.offsets, strict=True), start=1):
        turned = [np.cos(offset / 2), 0, 0, np.sin(offset / 2)]
        body = body.add_body(name=f"link_{i}", pos=reach, quat=turned)
        joint, reach = f"joint_{i}", (length, 0.0, 0.0)
        body.add_joint(name=joint, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1], armature=0.02)
        _add_link(body, i, length)
        servo = spec.add_actuator(name=joint, target=joint)
        servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
        servo.set_to_position(kp=200, kv=10 / 3)
        spec.add_sensor(
            name=joint,
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joint,
        )
    hand = body.add_body(name="hand", pos=reach)
    for i, (place, size) in enumerate(TOOLS[tool], start=1):
        hand.add_geom(
            name=f"tool_{i}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=place,
            size=size,
            mass=0.05,
            material="hand",
            contype=1,
        )
    hand.add_geom(
        name="shaft",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        fromto=[0.01, 0, -0.07, 0.01, 0, 0],
        size=[0.006, 0, 0],
        material="steel",
    )
    return spec.compile()


def _add_link(body: mujoco.MjsBody, number: int, length: float) -> None:
    """Draw a joint and the bar behind it; its mass keeps the servo honest."""
    body.add_geom(
        name=f"joint_{number}",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[0.02, 0.018, 0],
        material="joint",
        mass=0.05,
    )
    if length > 0:
        body.add_geom(
            name=f"link_{number}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[0, 0, 0, length, 0, 0],
            size=[0.012, 0, 0],
            material="steel",
            mass=0.3,
        )


class PlanarArmTask(MujocoTask):
    """A skill of the 3-DoF and the 4-DoF arm; the reward is minus a final distance in m.

    A subclass names its scene and tool, draws contexts and says where the tool goes (`_way`). What
    is to come to the target, the context, is the thing that is moved, or the peg's tip where there
    is none.

    :param arm: ``"3dof"`` or ``"4dof"``
    :param n_threads: of the simulator; by default one per core
    :raises TaskError: no such arm
    """

    context_names: ClassVar[tuple[str, ...]] = ("target x [m]", "target y [m]")
    error_unit = "m"
    trajectory_names: tuple[str, ...]  # as many as the arm has joints
    exploration_scale: tuple[float, ...]
    frame_every: ClassVar[float] = 4
    #: MJCF of the scene, and the tool that the arm holds
    scene_file: ClassVar[str]
    tool: ClassVar[str] = "peg"
    #: x and y of the thing that is moved, at first, in m; None: the peg's tip is moved
    thing: ClassVar[tuple[float, float] | None] = None
    #: a rollout succeeds with a final distance of at most this, in m
    tolerance: ClassVar[float]
    #: low and high corner of the contexts
    limits: ClassVar[tuple[tuple[float, float], tuple[float, float]]]
    #: part of the time after which the tool is at the first pose of its way
    approach_share: ClassVar[float] = 0.5

    def __init__(self, arm: str = "4dof", n_threads: int | None = None) -> None:
        self.arm, self.kinematics = arm, PlanarArm.named(arm)
        n = self.kinematics.n_joints
        self.trajectory_names = tuple(f"joint {i} [rad]" for i in range(1, n + 1))
        self.exploration_scale = (0.1,) * n
        low, high = (np.array(corner, np.float32) for corner in self.limits)
        self.context_space = spaces.Box(low, high)
        self.trajectory_space = spaces.Box(-JOINT_LIMIT, JOINT_LIMIT, (T, n), np.float32)
        scene = Path(__file__).with_name(self.scene_file)
        super().__init__(arm_model(self.kinematics, self.tool, scene), SUBSTEPS, n_threads)
        self._joints = tuple(f"joint_{i}" for i in range(1, n + 1))
        self._solutions = ContextCache(self._refine, CACHED)

    # -- what a skill supplies -----------------------------------------------------------------

    @abstractmethod
    def _way(self, context: FloatArray, aim: FloatArray) -> FloatArray:
        """Return the tool's poses from the end of the approach on, shape (K, 3) in m, m, rad.

        :param context: shape (2,)
        :param aim: where the expert aims at: the context, corrected by what it missed before
        """

    # -- what all share ------------------------------------------------------------------------

    @property
    def reward_range(self) -> tuple[float, float]:
        """As far away as counts, and at the target."""
        return -FARTHEST, 0.0

    def initial_trajectory(self, context: ArrayLike) -> FloatArray:
        """Return the start pose, held, shape (T, D) in rad.

        :param context: shape (2,) in m
        """
        self.check_context(context)
        return np.tile(self.kinematics.start, (T, 1))

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Return the expert's trajectory, shape (T, D) in rad.

        It moves through joint space to where the skill begins, and then leads the tool along a
        line. It tries its plan in simulation and corrects its aim by the error it sees. Both arms
        lead the tool the same way, each by its own joints.

        :param context: shape (2,) in m
        :param mode: ``"default"``, the only one
        :raises TaskError: out of the arm's reach
        """
        self.check_mode(mode)
        return self._solutions[self.check_context(context)].copy()

    def _refine(self, context: FloatArray) -> FloatArray:
        aim, best, least = context, None, np.inf
        for _ in range(REFINEMENTS):
            way = self._way(context, aim)
            plan = approach_and_line(self.kinematics, way, self.approach_share, T)
            miss = context - self._at(self._run(context[None], plan[None]))[0, -1]
            error = float(np.linalg.norm(miss))
            if error < least:
                best, least = plan, error
            if error <= 0.3 * self.tolerance:
                break
            aim = aim + miss
        if best is None or least > self.tolerance:
            raise TaskError(
                f"the expert comes no nearer to {context.round(4).tolist()} m than {least:.3f} m; "
                f"{self.tolerance} m are wanted."
            )
        return best

    def _initial_state(self, context: FloatArray) -> FloatArray:
        qpos = np.zeros(self.model.nq)
        start = (*self.kinematics.start, *(self.thing or ()))
        for name, value in zip((*self._joints, *OBJECT), start, strict=False):
            qpos[self.model.joint(name).qposadr[0]] = value
        return self.executor.initial_state(qpos)

    def _follow(self, trajectories: FloatArray) -> FloatArray:
        return limit_speed(np.array(self.kinematics.start), trajectories, FASTEST)

    def _controls(self, contexts: FloatArray, followed: FloatArray) -> FloatArray:
        return interpolate(np.array(self.kinematics.start), followed, SUBSTEPS)

    def _at(self, log: SensorLog) -> FloatArray:
        """Return the path of what is to come to the target, shape (N, T, 2) in m."""
        if self.thing is not None:
            return readings(log, OBJECT)
        pose = self.kinematics.tool_pose(readings(log, self._joints))
        ahead = np.stack([np.cos(pose[..., 2]), np.sin(pose[..., 2])], axis=-1)
        return pose[..., :2] + PEG * ahead

    def _measure(self, contexts: FloatArray, trajectories: FloatArray, log: SensorLog) -> Measured:
        path, outcomes = self._at(log), {}
        distance = np.linalg.norm(path[:, -1] - contexts, axis=1)
        if self.thing is not None:
            moved = np.linalg.norm(path - np.array(self.thing), axis=2).max(axis=1)
            outcomes = {"touched": (moved > TOUCHED).astype(np.float64)}
        return Measured(
            executed=readings(log, self._joints),
            terms={"goal": -np.minimum(distance, FARTHEST)},
            successes=distance <= self.tolerance,
            paths={"tip" if self.thing is None else "object": path},
            outcomes=outcomes,
        )

    def _drawn(self, context: FloatArray, states: FloatArray) -> tuple[mujoco.MjModel, FloatArray]:
        """Show the target at its place."""
        return self._with_target(context), states

    def _with_target(self, context: FloatArray) -> mujoco.MjModel:
        """Return the model with the body ``target`` at the context, facing away from the base."""
        model, bearing = copy.deepcopy(self.model), np.arctan2(context[1], context[0])
        model.body("target").pos[:2] = context
        model.body("target").quat[:] = [np.cos(bearing / 2), 0, 0, np.sin(bearing / 2)]
        return model


def readings(log: SensorLog, names: tuple[str, ...]) -> FloatArray:
    """Return the readings of scalar sensors side by side, shape (N, T, number of names).

    :param log: of those sensors
    :param names: of the sensors
    """
    return np.concatenate([log.readings[name] for name in names], axis=2)
