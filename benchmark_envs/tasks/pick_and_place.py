"""`nmp/PickAndPlace-v1`: a UR10 carries an object over a tower (thesis 5.2.4).

The thesis gives eight demonstrations, with objects of 2 to 6 cm and towers of 2 to 8 cm, and adapts
the skill to an object of 8 and a tower of 10 cm, and to 9 and 11 cm (`demonstration_contexts` and
`EXTRAPOLATION_CONTEXTS` of `pick_and_place_expert`). With ``field=True``, object and goal can be
anywhere on a field as well.
"""

import math
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from benchmark_envs.arguments import check_flag
from benchmark_envs.cache import ContextCache
from benchmark_envs.exceptions import InvalidContextError
from benchmark_envs.executor import SensorLog
from benchmark_envs.motion import interpolate, limit_speed
from benchmark_envs.mujoco_task import MujocoTask
from benchmark_envs.registry import register_task
from benchmark_envs.rollouts import BoolArray, FloatArray, Measured
from benchmark_envs.tasks.pick_and_place_expert import (
    CLEARANCE,
    CLOSING,
    EXTRAPOLATION_CONTEXTS,
    HOME,
    OPENING,
    demonstration_contexts,
    inverse_kinematics,
    needed_height,
    tool_path,
)
from benchmark_envs.tasks.pick_and_place_layout import (
    FIELD,
    FIELD_NAMES,
    HEIGHT_NAMES,
    HIGHEST,
    LOWEST,
    ROOM,
    Layout,
    draw_field,
)
from benchmark_envs.tasks.pick_and_place_measures import (
    CARRY,
    FINGERS,
    T,
    avoidance_error,
    contact_outcomes,
    grasp_points,
    pose_errors,
)

SUBSTEPS = 6  # of 4.2 ms
TIME_POINT = 0.025  # s; between set-points: a rollout lasts 5 s
JOINTS = ("base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3")
JOINT_LIMIT = 2 * np.pi  # rad; of all joints (Universal Robots' data sheet)
#: rad per time point; 120 degrees per second at base and shoulder, 180 at the others, as there
FASTEST = np.radians([120.0, 120.0, 180.0, 180.0, 180.0, 180.0]) * TIME_POINT
OPEN = 0.0425  # m; of each finger from the middle
PLACE_TOLERANCE = 0.03  # m
FARTHEST = 1.0  # m; no term of the reward counts more, so that it is bounded
TOWER_FOOT = 0.003  # m; contacts below this are the table's, not a touch
TOUCH_MARGIN = 0.005  # m; of the site around the tower that senses touches
ROUNDING = 1e-6  # m; of contexts, which are float32
CACHED_MODELS = 64  # of contexts; 0.1 MB each


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

    With ``field=True`` object and goal are anywhere on a field of 30 x 30 cm, x from 0.47 to 0.77 m
    and y from -0.15 to 0.15 m (the base stands at 0, 0). The tower stands midway between them, its
    broad side across the way, as in the thesis's arrangement. So they must be 0.128 m (along x) to
    0.2 m (aslant) apart, for the open gripper to come down with 1 cm to spare. There, a rollout
    that carried the object to another place than the goal tells so (`Rollouts.achieved_contexts`):
    it would have been right for a goal there, if it passes the tower that would stand in between.

    Set-points are followed at most at the UR10's speed limits (120 degrees/s at base and shoulder,
    180 at the others); ``clipped`` tells where that, or the joints' range, held one back.

    >>> task = PickAndPlaceTask(n_threads=1)
    >>> heights = [0.06, 0.08]  # m; of object and tower
    >>> rollouts = task.simulate(heights, task.demonstrate(heights))
    >>> bool(rollouts.successes[0]), round(float(rollouts.rewards[0]), 2)
    (True, -0.0)

    :param field: let the context say where object and goal are, too: object x, y and goal x, y go
        before the two heights
    :param n_threads: of the simulator; by default one per core
    """

    context_names: tuple[str, ...] = HEIGHT_NAMES
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
    #: for `extrapolation`, shapes (8, 2) and (2, 2) in m; of the thesis's arrangement
    demonstrated_contexts: ClassVar[FloatArray] = demonstration_contexts()
    extrapolation_contexts: ClassVar[FloatArray] = EXTRAPOLATION_CONTEXTS

    def __init__(self, field: bool = False, n_threads: int | None = None) -> None:
        self.field = self.tells_achievement = check_flag("field", field)
        low, high = LOWEST, HIGHEST
        if field:
            self.context_names = FIELD_NAMES
            low, high = (np.concatenate([p, p, h]) for p, h in zip(FIELD, (low, high), strict=True))
        self.context_space = spaces.Box(low.astype(np.float32), high.astype(np.float32))
        self.trajectory_space = spaces.Box(-JOINT_LIMIT, JOINT_LIMIT, (T, len(JOINTS)), np.float32)
        super().__init__(self.spec.compile(), SUBSTEPS, n_threads)
        self._models = ContextCache(self._compile, CACHED_MODELS)
        _, minus_kp, minus_kv = self.model.actuator_biasprm[: len(JOINTS), :3].T
        self._lead = minus_kv / minus_kp  # s; then the servos follow a set-point's speed exactly

    @cached_property
    def spec(self) -> mujoco.MjSpec:
        """The model's source, of which each context's model is compiled."""
        return mujoco.MjSpec.from_file(str(Path(__file__).with_suffix(".xml")))

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process or a copy needs: the source is read anew."""
        return {name: value for name, value in self.__dict__.items() if name != "spec"}

    @property
    def reward_range(self) -> tuple[float, float]:
        """All three distances at their bound; and none."""
        return -3 * FARTHEST, 0.0

    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw heights uniformly, shape (2,); with ``field``, places too (`draw_field`), (6,) in m.

        :param rng: the generator to draw from
        """
        return draw_field(rng) if self.field else rng.uniform(LOWEST, HIGHEST)

    def check_context(self, context: ArrayLike) -> FloatArray:
        """Return the context as `Task.check_context` does, where the tower leaves the gripper room.

        :param context: shape (C,) in m
        :raises InvalidContextError: see there; or object and goal are too near to each other
        """
        checked = super().check_context(context)
        room = float(Layout.of(checked[None]).room[0])
        if room < ROOM - ROUNDING:
            least = 2 * (ROOM - room) + np.linalg.norm(checked[2:4] - checked[:2])
            raise InvalidContextError(
                f"object and goal are {np.linalg.norm(checked[2:4] - checked[:2]):.3f} m apart, "
                f"but in that direction must be at least {least:.3f} m: between them stands the "
                "tower, and the open gripper needs room on both sides. `sample_context` draws "
                "contexts that have it."
            )
        return checked

    def initial_trajectory(self, context: ArrayLike) -> FloatArray:
        """Return the home pose, held, shape (T, 6) in rad.

        :param context: shape (C,) in m
        """
        self.check_context(context)
        return np.tile(HOME, (T, 1))

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Return the expert's trajectory, which always succeeds, shape (T, 6) in rad.

        It carries at a habitual height, and higher only where tower and object need it.

        :param context: shape (C,) in m
        :param mode: ``"default"``, the only one
        """
        self.check_mode(mode)
        return inverse_kinematics(tool_path(self.check_context(context), T))

    def _model(self, context: FloatArray) -> mujoco.MjModel:
        """Return the model with the context's heights, and with its place marked.

        :param context: shape (C,) in m
        """
        model = self._models[context]
        model.opt.gravity[:] = self.model.opt.gravity
        return model

    def _compile(self, context: FloatArray) -> mujoco.MjModel:
        layout = Layout.of(context[None])
        heights = layout.heights[0]
        for name, height in zip(("object", "tower"), heights / 2, strict=True):
            self.spec.geom(name).size[2] = self.spec.body(name).pos[2] = height
        touch = self.spec.site("tower")
        touch.size[2] = heights[1] / 2 + (TOUCH_MARGIN - TOWER_FOOT) / 2
        touch.pos[2] = (TOUCH_MARGIN + TOWER_FOOT) / 2
        for mark in ("place", "place_centre"):  # seen in pictures alone
            self.spec.geom(mark).pos[:2] = layout.places[0]
        return self.spec.compile()

    def _initial_state(self, context: FloatArray) -> FloatArray:
        """Arm at home, gripper open, object and tower upright at their places, all at rest."""
        layout, qpos = Layout.of(context[None]), self.model.qpos0.copy()
        for name, value in zip(JOINTS + FINGERS, [*HOME, OPEN, OPEN], strict=True):
            qpos[self.model.joint(name).qposadr[0]] = value
        places = {"object": layout.objects[0], "tower": layout.towers[0]}
        for (name, place), height in zip(places.items(), layout.heights[0], strict=True):
            address = self.model.joint(name).qposadr[0]
            qpos[address : address + 3] = *place, height / 2
        half, tower = layout.turns[0] / 2, self.model.joint("tower").qposadr[0]
        qpos[tower + 3 : tower + 7] = math.cos(half), 0.0, 0.0, math.sin(half)
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
        layout = Layout.of(contexts)
        paths = {name: log.readings[f"{name}_position"] for name in ("tool", "object", "tower")}
        grasp = grasp_points(log, layout)
        errors = pose_errors(paths["tool"], log.readings["flange_position"], grasp, layout)
        happened = contact_outcomes(log, layout)
        end = paths["object"][:, -1, :2]
        carried = happened["grasped"] & ~happened["touched_tower"] & ~happened["toppled"]
        return Measured(
            executed=np.concatenate([log.readings[name] for name in JOINTS], axis=2),
            terms={name: -np.minimum(error, FARTHEST) for name, error in errors.items()},
            successes=carried & (np.linalg.norm(end - layout.places, axis=1) <= PLACE_TOLERANCE),
            paths=paths,
            outcomes={name: np.where(log.diverged, 0.0, did) for name, did in happened.items()},
            achieved_contexts=self._achieved(contexts, end, paths["tool"], carried),
        )

    def _achieved(
        self, contexts: FloatArray, end: FloatArray, tool: FloatArray, carried: BoolArray
    ) -> FloatArray | None:
        """Return the contexts whose goal is where the object came to stand, shape (N, 6) in m.

        The tower would then have stood elsewhere, too: it must have been passed high enough there.

        :param contexts: shape (N, C) in m
        :param end: where the object came to rest, shape (N, 2) in m
        :param tool: path of the tool point, shape (N, T, 3) in m
        :param carried: whether it was, without touching the tower, shape (N,)
        """
        if not self.field:
            return None
        achieved = np.column_stack([contexts[:, :2], end, contexts[:, 4:]])
        layout = Layout.of(achieved)
        lacks = avoidance_error(tool[:, CARRY], layout.crossings, needed_height(layout.heights))
        clear = (lacks < CLEARANCE) & (layout.room >= ROOM)
        return self.within_contexts(achieved, carried & clear)
