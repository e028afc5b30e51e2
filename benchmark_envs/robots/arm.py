"""`Arm`: a robot's MJCF file, the joints that move, and the tip that is to be led."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from benchmark_envs.exceptions import TaskError
from benchmark_envs.robots.arguments import as_path, checked_ranges, names, vector
from benchmark_envs.rollouts import FloatArray

Frame = Literal["site", "body", "geom"]
#: an example: an arm of six hinges that holds a peg, and a block with a hole
PEG_ARM = Path(__file__).parent / "examples" / "peg_arm.xml"
HINGE, SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
UNITS = {HINGE: "rad", SLIDE: "m"}
#: of a servo that holds a joint, critically damped: fast beside the motions of an arm
SERVO_HZ = 12.0
LONGEST_STEP = 0.002  # s; of the simulation
WAY_ROUND = np.pi  # rad; how far a hinge without limits may turn from its start, to either side


class Arm:
    """An arm given as MJCF; its file stays as it is.

    The arm's joints are those between the world and the tip, or those of them that are named. All
    other joints of the same robot, such as fingers or a base, are held where the file has them. The
    file's actuators, sensors, keyframes and tendons give way to a position servo and a sensor for
    each joint, gravity on the robot is compensated, and welds to mocap bodies are cut: files differ
    in all these, and many robots come without an actuator.

    >>> arm = Arm.from_mjcf(PEG_ARM, tip="peg_tip")
    >>> arm.joints[:3], arm.units[:3], arm.start[:3].round(2).tolist()
    (('turn', 'shoulder', 'elbow'), ('rad', 'rad', 'rad'), [0.0, 0.0, 1.35])
    >>> arm.tip_position(arm.start).round(2).tolist()
    [0.55, 0.0, 0.65]

    :param path: of the MJCF file
    :param tip: name of the site, body or geom that is to be led
    :param joints: their names, from the base on; all between world and tip by default
    :param start: joint angles in rad, or m, shape (D,); by default the middle of each range, and
        the file's reference for joints without one
    :param ranges: low and high end by joint, where the file has none or narrower ones are wanted
    :param axis: the tip's own axis that `ViaPose.axis` directs
    :raises TaskError: no such file, tip or joint, joints that are no hinges or slides, or a start
        outside the ranges
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        tip: str,
        joints: Sequence[str] | None = None,
        start: ArrayLike | None = None,
        ranges: Mapping[str, tuple[float, float]] | None = None,
        axis: ArrayLike = (0.0, 0.0, 1.0),
    ) -> None:
        self.path, self.tip, self.axis = as_path(path), tip, vector("axis", axis, 3)
        if not self.axis.any():
            raise TaskError(f"axis is {axis}; it must be a direction, such as (0, 0, 1).")
        whole = self._compiled(self._spec())
        self.frame: Frame = _frame_of(whole, tip)
        chain = _chain(whole, self.frame, tip)
        self.joints = tuple(chain if joints is None else _chosen(names("joints", joints), chain))
        self._held = tuple(name for name in _robots_joints(whole, chain) if name not in self.joints)
        kinds = [int(whole.joint(name).type[0]) for name in self.joints]
        _check_kinds(self.joints, kinds)
        self.units = tuple(UNITS[mujoco.mjtJoint(kind)] for kind in kinds)
        given = checked_ranges(ranges, self.joints)
        self.start, self.low, self.high = _start_and_ranges(whole, self.joints, start, given)
        #: without other things that move: its generalised positions are the arm's joints
        self.kinematic = self._kinematic_model()

    @classmethod
    def from_mjcf(
        cls,
        path: str | os.PathLike[str],
        tip: str,
        **more: Any,  # noqa: ANN401
    ) -> "Arm":
        """Return the arm of a file.

        :param path: of the MJCF file
        :param tip: name of the site, body or geom that is to be led
        :param more: the class's other arguments
        """
        return cls(path, tip, **more)

    @property
    def n_joints(self) -> int:
        """D."""
        return len(self.joints)

    @property
    def names(self) -> tuple[str, ...]:
        """The joints with their units, such as ``"elbow [rad]"``."""
        return tuple(f"{name} [{unit}]" for name, unit in zip(self.joints, self.units, strict=True))

    def tip_position(self, joints: ArrayLike) -> FloatArray:
        """Return where the tip is, shape (3,) in m.

        :param joints: shape (D,)
        """
        return self.tip_pose(joints)[0]

    def tip_pose(self, joints: ArrayLike) -> FloatArray:
        """Return where the tip is in m, and where its axis points, shape (2, 3).

        :param joints: shape (D,)
        :raises TaskError: another shape, or a value that is not finite
        """
        data = self._placed(joints)
        tip = getattr(data, self.frame)(self.tip)
        turned = np.array(tip.xmat).reshape(3, 3) @ self.axis
        return np.array([tip.xpos, turned], np.float64)

    def _placed(self, joints: ArrayLike) -> mujoco.MjData:
        data = mujoco.MjData(self.kinematic)
        data.qpos[:] = vector("joints", joints, self.n_joints)
        mujoco.mj_kinematics(self.kinematic, data)
        return data

    def reach(self) -> tuple[FloatArray, float]:
        """Return the first joint's place, shape (3,) in m, and how far from it the tip comes, in m.

        At most: all links in a line, and all slides out, which the joints' ranges may not allow.
        """
        data = self._placed(self.start)
        places = np.vstack([data.xanchor, self.tip_position(self.start)])
        slides = (self.high - self.low)[[unit == "m" for unit in self.units]]
        links = np.linalg.norm(np.diff(places, axis=0), axis=1)
        return places[0], float(links.sum() + slides.sum())

    def simulated(self, dt: float, watched: Sequence[str] = ()) -> tuple[mujoco.MjModel, int]:
        """Return the model that is simulated, and its steps per time point.

        It has a position servo for each joint, in their order, and as sensors ``clock``, each
        joint's position by its name, ``tip`` and each watched body's position by its name.

        :param dt: between time points, in s
        :param watched: bodies whose positions are to be told
        :raises TaskError: no such body
        """
        spec = self._prepared()
        n_steps = int(np.ceil(dt / LONGEST_STEP))
        spec.option.timestep = dt / n_steps
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        bodies = [body.name for body in spec.bodies]
        for name in watched:
            if name not in bodies:
                raise TaskError(f"no body '{name}' to be watched; there are {_listed(bodies)}.")
        self._add_servos(spec)
        if "overview" not in [camera.name for camera in spec.cameras]:
            self._add_camera(spec)
        _add_sensors(spec, self.joints, (self.frame, self.tip), watched)
        return self._compiled(spec), n_steps

    def _add_servos(self, spec: mujoco.MjSpec) -> None:
        """Hold each joint by a critically damped spring, as stiff as its inertia at the start asks.

        What the file says of damping in these joints belongs to its own way to drive them.
        """
        model, data = self.kinematic, mujoco.MjData(self.kinematic)
        data.qpos[:] = self.start
        mujoco.mj_forward(model, data)
        inertia = np.zeros((model.nv, model.nv))
        for column, unit in zip(inertia, np.eye(model.nv), strict=True):
            mujoco.mj_mulM(model, data, column, unit)
        fast = 2 * np.pi * SERVO_HZ
        for name, mass in zip(self.joints, np.diag(inertia), strict=True):
            joint = spec.joint(name)
            joint.damping, joint.stiffness = 0 * joint.damping, 0 * joint.stiffness
            servo = spec.add_actuator(name=name, target=name)
            servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
            servo.set_to_position(kp=mass * fast**2, kv=2 * mass * fast)

    def _add_camera(self, spec: mujoco.MjSpec) -> None:
        """Look at the whole scene from its front, right and above."""
        center, extent = self.kinematic.stat.center, float(self.kinematic.stat.extent)
        place = np.array([1.3, -1.3, 0.9])
        right, up = np.array([1.0, 1.0, 0.0]), np.array([-0.9, 0.9, 2.6])
        camera = spec.worldbody.add_camera(name="overview", pos=center + extent * place)
        camera.alt.type = mujoco.mjtOrientation.mjORIENTATION_XYAXES
        camera.alt.xyaxes = [*right, *up]

    def _spec(self) -> mujoco.MjSpec:
        if not self.path.is_file():
            raise TaskError(f"there is no MJCF file '{self.path}'.")
        try:
            return mujoco.MjSpec.from_file(str(self.path))
        except ValueError as error:
            raise TaskError(f"MuJoCo cannot read '{self.path}': {_one_line(error)}") from error

    def _compiled(self, spec: mujoco.MjSpec) -> mujoco.MjModel:
        try:
            return spec.compile()
        except ValueError as error:
            raise TaskError(
                f"MuJoCo cannot make a model of '{self.path}': {_one_line(error)}"
            ) from error

    def _prepared(self) -> mujoco.MjSpec:
        """Return the file's scene with nothing but this arm's joints left in the robot."""
        spec = self._spec()
        mocap = {body.name for body in spec.bodies if body.mocap}
        tied = [e for e in spec.equalities if {e.name1, e.name2} & (mocap | set(self._held))]
        for element in [*spec.actuators, *spec.sensors, *spec.keys, *spec.tendons, *tied]:
            spec.delete(element)
        for name in self._held:
            spec.delete(spec.joint(name))
        root = spec.joint(self.joints[0]).parent
        while root.parent is not None and root.parent.name != "world":
            root = root.parent
        for body in [root, *root.find_all("body")]:
            body.gravcomp = 1
        return spec

    def _kinematic_model(self) -> mujoco.MjModel:
        spec = self._prepared()
        for joint in list(spec.joints):
            if joint.name not in self.joints:
                spec.delete(joint)
        for body in spec.bodies:
            for joint in list(body.joints):
                if joint.type == mujoco.mjtJoint.mjJNT_FREE:
                    spec.delete(joint)
        for name, low, high in zip(self.joints, self.low, self.high, strict=True):
            joint = spec.joint(name)
            joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, [low, high]
        return self._compiled(spec)


def _frame_of(model: mujoco.MjModel, tip: str) -> Frame:
    kinds: tuple[Frame, ...] = ("site", "body", "geom")
    known: list[str] = []
    for kind in kinds:
        count = getattr(model, {"site": "nsite", "body": "nbody", "geom": "ngeom"}[kind])
        names = [getattr(model, kind)(i).name for i in range(count)]
        if tip in names and tip:
            return kind
        known += [name for name in names if name]
    raise TaskError(f"no site, body or geom '{tip}'; there are {_listed(known)}.")


def _chain(model: mujoco.MjModel, frame: Frame, tip: str) -> list[str]:
    """Return the joints between the world and the tip, from the world on."""
    of_tip = getattr(model, frame)(tip)
    body = int(of_tip.id if frame == "body" else of_tip.bodyid[0])
    chain: list[str] = []
    while body:
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        own = [model.joint(i).name for i in range(first, first + count)]
        chain, body = own + chain, int(model.body_parentid[body])
    if not chain:
        raise TaskError(f"no joint lies between the world and '{tip}', so it cannot be led.")
    if not all(chain):
        raise TaskError(f"a joint between the world and '{tip}' has no name; give it one.")
    return chain


def _chosen(joints: Sequence[str], chain: list[str]) -> list[str]:
    for name in joints:
        if name not in chain:
            raise TaskError(
                f"'{name}' is no joint between the world and the tip; there are {_listed(chain)}."
            )
    if not joints or len(set(joints)) != len(joints):
        raise TaskError(f"joints is {list(joints)}; name each once, at least one of {chain}.")
    return sorted(joints, key=chain.index)


def _robots_joints(model: mujoco.MjModel, chain: list[str]) -> list[str]:
    """Return all joints of the tree of bodies to which the chain belongs."""
    root = int(model.body_rootid[int(model.joint(chain[0]).bodyid[0])])
    return [
        model.joint(i).name
        for i in range(model.njnt)
        if model.body_rootid[int(model.jnt_bodyid[i])] == root
    ]


def _check_kinds(joints: Sequence[str], kinds: Sequence[int]) -> None:
    for name, kind in zip(joints, kinds, strict=True):
        if kind not in (HINGE, SLIDE):
            raise TaskError(
                f"the joint '{name}' is no hinge and no slide; name the joints that are to move by "
                "joints=[...]."
            )


def _start_and_ranges(
    model: mujoco.MjModel,
    joints: Sequence[str],
    start: ArrayLike | None,
    ranges: Mapping[str, tuple[float, float]],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return where the joints begin and the ends of their ranges, each of shape (D,)."""
    given = None if start is None else vector("start", start, len(joints))
    found = np.zeros((3, len(joints)))
    for i, name in enumerate(joints):
        joint, reference = model.joint(name), float(model.qpos0[model.joint(name).qposadr[0]])
        limited = name in ranges or bool(model.jnt_limited[joint.id])
        ends = ranges.get(name, tuple(joint.range))
        begin = given[i] if given is not None else (sum(ends) / 2 if limited else reference)
        if not limited and joint.type[0] == SLIDE:
            raise TaskError(f"the slide '{name}' has no range; give ranges={{'{name}': (a, b)}}.")
        low, high = ends if limited else (begin - WAY_ROUND, begin + WAY_ROUND)
        if not low <= begin <= high:
            unit = UNITS[mujoco.mjtJoint(int(joint.type[0]))]
            raise TaskError(
                f"the joint '{name}' begins at {begin:.4g}; its range is [{low:.4g}, {high:.4g}] "
                f"{unit}: give another start, or ranges={{'{name}': (a, b)}}."
            )
        found[:, i] = begin, low, high
    return found[0], found[1], found[2]


def _add_sensors(
    spec: mujoco.MjSpec, joints: Sequence[str], tip: tuple[Frame, str], watched: Sequence[str]
) -> None:
    sensor, kind = mujoco.mjtSensor, mujoco.mjtObj
    spec.add_sensor(name="clock", type=sensor.mjSENS_CLOCK)
    for name in joints:
        spec.add_sensor(
            name=name, type=sensor.mjSENS_JOINTPOS, objtype=kind.mjOBJ_JOINT, objname=name
        )
    frame, tip_name = tip
    frames = {"site": kind.mjOBJ_SITE, "body": kind.mjOBJ_XBODY, "geom": kind.mjOBJ_GEOM}
    places = [("tip", frames[frame], tip_name)]
    places += [(name, kind.mjOBJ_XBODY, name) for name in watched]
    for name, of, what in places:
        spec.add_sensor(name=name, type=sensor.mjSENS_FRAMEPOS, objtype=of, objname=what)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".") + "."


def _listed(names: Sequence[str]) -> str:
    some = [name for name in names if name][:12]
    return ", ".join(some) + (", ..." if len(names) > len(some) else "")
