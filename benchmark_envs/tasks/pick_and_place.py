"""`nmp/PickAndPlace-v1`: a UR10 carries an object over a tower (thesis 5.2.4).

The thesis gives eight demonstrations, with objects of 2 to 6 cm and towers of 2 to 8 cm, and adapts
the skill to an object of 8 and a tower of 10 cm, and to 9 and 11 cm (`demonstration_contexts` and
`EXTRAPOLATION_CONTEXTS` of `pick_and_place_expert`).
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from benchmark_envs.cache import ContextCache
from benchmark_envs.executor import SensorLog
from benchmark_envs.motion import interpolate, limit_speed
from benchmark_envs.mujoco_task import MujocoTask
from benchmark_envs.registry import register_task
from benchmark_envs.rollouts import BoolArray, FloatArray, Measured
from benchmark_envs.tasks.pick_and_place_expert import (
    CLOSING,
    EXTRAPOLATION_CONTEXTS,
    GRASP_DEPTH,
    HALF_OBJECT,
    HALF_TOWER,
    HOME,
    OBJECT,
    OPENING,
    PLACE,
    TOOL_LENGTH,
    TOWER,
    demonstration_contexts,
    inverse_kinematics,
    needed_height,
    tool_path,
)

T = 200
SUBSTEPS = 6  # of 4.2 ms
TIME_POINT = 0.025  # s; between set-points: a rollout lasts 5 s
JOINTS = ("base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3")
FINGERS = ("finger_left", "finger_right")
JOINT_LIMIT = 2 * np.pi  # rad; of all joints (Universal Robots' data sheet)
#: rad per time point; 120 degrees per second at base and shoulder, 180 at the others, as there
FASTEST = np.radians([120.0, 120.0, 180.0, 180.0, 180.0, 180.0]) * TIME_POINT
LOW = np.array([0.02, 0.02])  # m; heights of object and tower that gripper and expert can take
HIGH = np.array([0.09, 0.11])  # m
OPEN = 0.0425  # m; of each finger from the middle
PLACE_TOLERANCE = 0.03  # m
UPRIGHT = math.cos(math.radians(15))  # an object that leans more does not stand
LIFTED = 0.01  # m; above the table: an object between the fingers has been grasped
FARTHEST = 1.0  # m; no term of the reward counts more, so that it is bounded
TOWER_FOOT = 0.003  # m; contacts below this are the table's, not a touch
TOUCH_MARGIN = 0.005  # m; of the site around the tower that senses touches
CACHED_MODELS = 64  # of contexts; 0.1 MB each

#: the first and the last time point of a phase of the gripper's script
CLOSES, OPENS = (slice(round(a * T), round(b * T)) for a, b in (CLOSING, OPENING))
#: while the object is in the gripper
CARRY = slice(CLOSES.stop - 1, OPENS.start + 1)


@register_task("nmp/PickAndPlace-v1")
class PickAndPlaceTask(MujocoTask):
    """A UR10 with a two-finger gripper, a box to carry, a tower that can fall, and a place.

    The trajectory holds the six joint angles; the gripper follows a fixed script in time. What is
    grasped, touched and dropped is decided by contacts: ``outcomes`` tells ``grasped`` (both
    fingers touched the object while it was lifted), ``touched_tower`` (by the object or the
    robot), ``dropped`` (grasped, but no longer held when the gripper opened) and ``toppled`` (the
    object does not stand at the end).

    Reward: ``grasp + avoid + place``, each minus a distance in m, at most 1 m (thesis: "the sum of
    minus distances to obstacle avoidance and grasp points"), taken from the executed motion:

    - ``grasp``: of the gripper to where it stands upright with its tool point on the object's
      axis, 1 cm below its top: the root mean square over its two ends (tool point and flange) and
      over the time in which the fingers close. Where the object is then counts: it may have been
      pushed or knocked over on the way to it;
    - ``place``: the same to an object that stands at its place, while the fingers open;
    - ``avoid``: of the tool's way in between to three points over the tower, at which the object
      clears it by 2 cm (over its middle, and where the object's edge meets the tower's), summed;
      to be higher costs nothing.

    At 0 the object is picked up, clears the tower and is put down. Of 640 rollouts of the expert
    with smooth noise, 99 % succeeded above -0.04, 54 % between -0.06 and -0.08, 2 % below -0.15.
    A stop between the fingers keeps an object's top at most 18 mm above the tool point: without
    it, demonstrations of 6 cm objects grip taller ones in the middle and so carry their lower end
    over a tower that they should hit.

    Success: grasped, tower not touched, and the object stands within 0.03 m of its place.

    Set-points are followed at most at the UR10's speed limits (120 degrees/s at base and shoulder,
    180 at the others); ``clipped`` tells where that, or the joints' range, held one back.
    The film is three times faster than the rollout.

    >>> task = PickAndPlaceTask(n_threads=1)
    >>> heights = [0.06, 0.08]  # m; of object and tower
    >>> rollouts = task.simulate(heights, task.demonstrate(heights))
    >>> bool(rollouts.successes[0]), round(float(rollouts.rewards[0]), 2)
    (True, -0.0)

    :param n_threads: of the simulator; by default one per core
    """

    context_names: ClassVar[tuple[str, ...]] = ("object height [m]", "tower height [m]")
    trajectory_names: ClassVar[tuple[str, ...]] = tuple(f"{name} [rad]" for name in JOINTS)
    # Less than 2 degrees of the joints that raise and lower the tool, and a third of that of the
    # others: with smooth noise of 0.5, 1 and 2 degrees the expert succeeds in 100, 72, 13 %.
    exploration_scale: ClassVar[tuple[float, ...]] = (0.01, 0.03, 0.03, 0.03, 0.01, 0.01)
    reward_terms: Mapping[str, str] = {
        "grasp": "minus the gripper's distance to its pose at the object while it closes [m]",
        "place": "minus the gripper's distance to its pose at the place while it opens [m]",
        "avoid": "minus the distances of the carry to three points over the tower, summed [m]",
    }
    error_unit: str = "m"
    frame_every: ClassVar[float] = 5
    #: for `extrapolation`, shapes (8, 2) and (2, 2) in m
    demonstrated_contexts: ClassVar[FloatArray] = demonstration_contexts()
    extrapolation_contexts: ClassVar[FloatArray] = EXTRAPOLATION_CONTEXTS

    def __init__(self, n_threads: int | None = None) -> None:
        self.context_space = spaces.Box(LOW.astype(np.float32), HIGH.astype(np.float32))
        self.trajectory_space = spaces.Box(-JOINT_LIMIT, JOINT_LIMIT, (T, len(JOINTS)), np.float32)
        self.spec = mujoco.MjSpec.from_file(str(Path(__file__).with_suffix(".xml")))
        super().__init__(self.spec.compile(), SUBSTEPS, n_threads)
        self._models = ContextCache(self._compile, CACHED_MODELS)
        _, minus_kp, minus_kv = self.model.actuator_biasprm[: len(JOINTS), :3].T
        self._lead = minus_kv / minus_kp  # s; then the servos follow a set-point's speed exactly

    @property
    def reward_range(self) -> tuple[float, float]:
        """All three distances at their bound; and none."""
        return -3 * FARTHEST, 0.0

    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw heights of object and tower uniformly, shape (2,) in m.

        :param rng: the generator to draw from
        """
        return rng.uniform(LOW, HIGH)

    def initial_trajectory(self, context: ArrayLike) -> FloatArray:
        """Return the home pose, held, shape (T, 6) in rad.

        :param context: heights of object and tower, shape (2,) in m
        """
        self.check_context(context)
        return np.tile(HOME, (T, 1))

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Return the expert's trajectory, which always succeeds, shape (T, 6) in rad.

        It carries at a habitual height, and higher only where tower and object need it.

        :param context: heights of object and tower, shape (2,) in m
        :param mode: ``"default"``, the only one
        """
        self.check_mode(mode)
        return inverse_kinematics(tool_path(self.check_context(context), T))

    def _model(self, context: FloatArray) -> mujoco.MjModel:
        """Return the model with the context's heights.

        :param context: shape (2,) in m
        """
        model = self._models[context]
        model.opt.gravity[:] = self.model.opt.gravity
        return model

    def _compile(self, context: FloatArray) -> mujoco.MjModel:
        for name, height in zip(("object", "tower"), context / 2, strict=True):
            self.spec.geom(name).size[2] = self.spec.body(name).pos[2] = height
        touch = self.spec.site("tower")
        touch.size[2] = context[1] / 2 + (TOUCH_MARGIN - TOWER_FOOT) / 2
        touch.pos[2] = (TOUCH_MARGIN + TOWER_FOOT) / 2
        return self.spec.compile()

    def _initial_state(self, context: FloatArray) -> FloatArray:
        """Arm at home, gripper open, object and tower upright at their places, all at rest."""
        qpos = self.model.qpos0.copy()
        for name, value in zip(JOINTS + FINGERS, [*HOME, OPEN, OPEN], strict=True):
            qpos[self.model.joint(name).qposadr[0]] = value
        for name, place, height in zip(("object", "tower"), (OBJECT, TOWER), context, strict=True):
            address = self.model.joint(name).qposadr[0]
            qpos[address : address + 3] = *place, height / 2
        return self.executor.initial_state(qpos)

    def _follow(self, trajectories: FloatArray) -> FloatArray:
        """Hold the joints to their speed, beginning at home."""
        return limit_speed(HOME, trajectories, FASTEST)

    def _controls(self, contexts: FloatArray, followed: FloatArray) -> FloatArray:
        """Set-points with velocity feed-forward, and the gripper's, shape (N, T * SUBSTEPS, 7)."""
        positions = interpolate(HOME, followed, SUBSTEPS)
        rates = np.diff(positions, axis=1, append=positions[:, -1:]) / self.model.opt.timestep
        time = np.arange(1, T * SUBSTEPS + 1) / (T * SUBSTEPS)
        grip = np.interp(time, [*CLOSING, *OPENING], [OPEN, 0.0, 0.0, OPEN])
        fingers = np.broadcast_to(grip[:, None], (len(positions), T * SUBSTEPS, 1))
        return np.concatenate([positions + self._lead * rates, fingers], axis=2)

    def _measure(self, contexts: FloatArray, trajectories: FloatArray, log: SensorLog) -> Measured:
        paths = {name: log.readings[f"{name}_position"] for name in ("tool", "object", "tower")}
        grasp = grasp_points(log, contexts)
        errors = pose_errors(paths["tool"], log.readings["flange_position"], grasp, contexts)
        happened = contact_outcomes(log, contexts)
        placed = np.linalg.norm(paths["object"][:, -1, :2] - PLACE, axis=1)
        failed = happened["touched_tower"] | happened["toppled"] | ~happened["grasped"]
        return Measured(
            executed=np.concatenate([log.readings[name] for name in JOINTS], axis=2),
            terms={name: -np.minimum(error, FARTHEST) for name, error in errors.items()},
            successes=~failed & (placed <= PLACE_TOLERANCE),
            paths=paths,
            outcomes={name: np.where(log.diverged, 0.0, did) for name, did in happened.items()},
        )


def grasp_points(log: SensorLog, contexts: FloatArray) -> FloatArray:
    """Return the point of the object to take it at, when the fingers begin to close, (N, 3) in m.

    :param log: of the sensors of the object's position and axis
    :param contexts: heights of object and tower, shape (N, 2) in m
    """
    position, axis = (
        log.readings[f"object_{name}"][:, CLOSES.start - 1] for name in ("position", "axis")
    )
    return position + (contexts[:, :1] / 2 - GRASP_DEPTH) * axis


def pose_errors(
    tool: FloatArray, flange: FloatArray, grasp: FloatArray, contexts: FloatArray
) -> dict[str, FloatArray]:
    """Return the distances that are the reward's terms, each of shape (N,) in m.

    :param tool: path of the tool point, shape (N, T, 3) in m
    :param flange: path of the arm's last flange, shape (N, T, 3) in m
    :param grasp: `grasp_points`, shape (N, 3) in m
    :param contexts: heights of object and tower, shape (N, 2) in m
    """
    place = np.column_stack([np.tile(PLACE, (len(contexts), 1)), contexts[:, 0] - GRASP_DEPTH])
    errors: dict[str, FloatArray] = {}
    for name, where, phase in (("grasp", grasp, CLOSES), ("place", place, OPENS)):
        wanted = where[:, None].copy()
        square = np.sum((tool[:, phase] - wanted) ** 2, axis=2)
        wanted[..., 2] += TOOL_LENGTH
        square += np.sum((flange[:, phase] - wanted) ** 2, axis=2)
        errors[name] = np.sqrt(square.mean(axis=1) / 2)
    errors["avoid"] = avoidance_error(tool[:, CARRY], needed_height(contexts))
    return errors


def avoidance_error(paths: FloatArray, needed: FloatArray) -> FloatArray:
    """Return how far ways pass below or beside the points over the tower, shape (N,) in m.

    The sum over three points: above the tower's middle, and half a tower and half an object
    before and behind it. A way is made of straight lines. Each of them is judged where it is
    nearest to the point as seen from above, by the distance there; being higher costs nothing.

    :param paths: of the tool point, shape (N, K, 3) in m
    :param needed: the points' height, shape (N,) in m
    """
    edge = HALF_TOWER + HALF_OBJECT
    begin, line = paths[:, :-1, None], np.diff(paths, axis=1)[:, :, None]
    points = TOWER + np.array([[0.0, -edge], [0.0, 0.0], [0.0, edge]])  # (3, 2)
    square = np.maximum(np.sum(line[..., :2] ** 2, axis=-1), 1e-12)
    share = np.sum((points - begin[..., :2]) * line[..., :2], axis=-1) / square
    nearest = begin + np.clip(share, 0.0, 1.0)[..., None] * line  # (N, K - 1, 3, 3)
    beside = nearest[..., :2] - points
    below = np.maximum(0.0, needed[:, None, None] - nearest[..., 2])
    distance = np.sqrt(np.sum(beside**2, axis=-1) + below**2)
    return distance.min(axis=1).sum(axis=1)


def contact_outcomes(log: SensorLog, contexts: FloatArray) -> dict[str, BoolArray]:
    """Return what contacts made of grasp, carry and placing, each of shape (N,).

    :param log: of the sensors of touches, and of the object's position and axis
    :param contexts: heights of object and tower, shape (N, 2) in m
    """
    left, right = (log.readings[f"{name}_touch"][..., 0] > 0 for name in FINGERS)
    held = left & right
    lifted = log.readings["object_position"][..., 2] - contexts[:, :1] / 2 > LIFTED
    grasped = np.logical_or.reduce((held & lifted)[:, CARRY], axis=1)
    return {
        "grasped": grasped,
        "touched_tower": log.peaks["tower_touch"].max(axis=(1, 2)) > 0,
        "dropped": grasped & ~held[:, OPENS.start],
        "toppled": log.readings["object_axis"][:, -1, 2] < UPRIGHT,
    }
