"""`ArmTask`: a trajectory bandit for an arm given as MJCF: lead the tip through via-poses."""

import copy
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral
from typing import ClassVar

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from benchmark_envs.arguments import as_numbers
from benchmark_envs.cache import ContextCache
from benchmark_envs.exceptions import TaskError
from benchmark_envs.executor import SensorLog
from benchmark_envs.motion import interpolate
from benchmark_envs.mujoco_task import MujocoTask
from benchmark_envs.robots.arguments import asked, check_positive, names, vector
from benchmark_envs.robots.arm import Arm
from benchmark_envs.robots.expert import follow
from benchmark_envs.robots.motion_limits import MotionLimits
from benchmark_envs.robots.via_poses import ViaPose, check_way
from benchmark_envs.rollouts import FloatArray, Measured

#: from a context of shape (C,) to where the tip is to pass
Way = Callable[[FloatArray], Sequence[ViaPose]]
#: from a context of shape (C,) to a position of shape (3,) in m
Place = Callable[[FloatArray], ArrayLike]

FARTHEST = 2.0  # m; a distance counts no more than this, so that the reward is bounded
CACHED = 1024  # answers of the expert
SCALES = {"rad": 0.05, "m": 0.02}  # with which a search may begin, by the joint's unit


class ArmTask(MujocoTask):
    """An arm's joints over time, as the action; the tip is to pass via-poses when they are due.

    Reward: minus the mean distance in m of the tip from those via-poses that count, each at its
    time. Success: every one of them is at most ``tolerance`` away. The expert leads the tip in
    straight lines (`follow`), and raises where it cannot. Executed by the servos of `Arm`, in
    MuJoCo, with all contacts of the file; ``paths`` has the tip and the watched bodies.

    Another reward is a subclass that overrides `_measure`; see ``docs/your_robot.md``.

    >>> from benchmark_envs.robots import PEG_ARM
    >>> arm = Arm.from_mjcf(PEG_ARM, tip="peg_tip", start=[0, -0.3, 1.6, 0, 1.7, 0])
    >>> def way(hole):
    ...     return [ViaPose([*hole, 0.12], at=0.5, counts=False), ViaPose([*hole, 0.08])]
    >>> task = ArmTask(
    ...     arm, way, context_names=["x [m]", "y [m]"], context_low=[0.4, -0.2],
    ...     context_high=[0.6, 0.2], duration=1.0, n_time_points=50, n_threads=1,
    ... )  # fmt: skip
    >>> at_rest = task.initial_trajectory([0.5, 0.1])  # task.demonstrate needs mink
    >>> rollouts = task.simulate([0.5, 0.1], at_rest)
    >>> rollouts.successes.tolist(), rollouts.executed.shape, task.trajectory_names[0]
    ([False], (1, 50, 6), 'turn [rad]')

    :param arm: that moves
    :param way: via-poses of a context
    :param context_names: what each entry of a context means, with its unit, length C
    :param context_low: of the contexts, shape (C,)
    :param context_high: of the contexts, shape (C,)
    :param placed: where bodies of the file stand in a context, by their names
    :param watched: bodies whose paths are told
    :param duration: of a trajectory, in s
    :param n_time_points: T
    :param tolerance: of a success, in m
    :param limits: that the expert's trajectories have to keep; None: none but the joints' ranges
    :param n_threads: of the simulator; by default one per core
    :raises TaskError: bounds that are no box, no such body, a time or tolerance that is not
        positive, functions that return no way or no place, or via-poses all out of reach
    """

    reward_terms: ClassVar[Mapping[str, str]] = {
        "way": "minus the mean distance of the tip from the via-poses when they are due [m]"
    }
    error_unit = "m"
    context_names: tuple[str, ...]
    trajectory_names: tuple[str, ...]  # as many as the arm has joints
    exploration_scale: tuple[float, ...]
    frame_every: ClassVar[float] = 2

    def __init__(
        self,
        arm: Arm,
        way: Way,
        *,
        context_names: Sequence[str],
        context_low: ArrayLike,
        context_high: ArrayLike,
        placed: Mapping[str, Place] | None = None,
        watched: Sequence[str] = (),
        duration: float = 2.0,
        n_time_points: int = 100,
        tolerance: float = 0.02,
        limits: MotionLimits | None = None,
        n_threads: int | None = None,
    ) -> None:
        check_positive("duration", duration, "s")
        check_positive("tolerance", tolerance, "m")
        whole = isinstance(n_time_points, Integral) and n_time_points >= 2
        for name, given, kind, fits in (
            ("n_time_points", n_time_points, "a whole number >= 2", whole),
            ("arm", arm, "an Arm, such as Arm.from_mjcf(path, tip=...)", isinstance(arm, Arm)),
            ("limits", limits, "MotionLimits or None", isinstance(limits, MotionLimits | None)),
            ("placed", placed, "a dictionary by body", isinstance(placed or {}, Mapping)),
        ):
            if not fits:
                raise TaskError(f"{name} is {given!r}; it must be {kind}.")
        self.arm, self.way, self.limits, self.tolerance = arm, way, limits, tolerance
        self.context_low, self.context_high = context_low, context_high
        self.placed, self.watched = dict(placed or {}), names("watched", watched)
        self.n_time_points = n_time_points
        self.context_names, self.trajectory_names = names("context_names", context_names), arm.names
        self.exploration_scale = tuple(SCALES[unit] for unit in arm.units)
        self.context_space = _box(context_low, context_high, self.context_names)
        shape = (n_time_points, arm.n_joints)
        self.trajectory_space = spaces.Box(
            np.broadcast_to(arm.low, shape).astype(np.float32),
            np.broadcast_to(arm.high, shape).astype(np.float32),
        )
        step = duration / n_time_points
        model, substeps = arm.simulated(step, self.watched)
        for body in self.placed:
            if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body) < 0:
                raise TaskError(f"placed names '{body}', which is no body of '{arm.path}'.")
        super().__init__(model, substeps, n_threads)
        self._try()
        self._answers = ContextCache(self._answer, CACHED)

    @property
    def reward_range(self) -> tuple[float, float]:
        """As far away as counts, and no distance at all."""
        return -FARTHEST, 0.0

    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw a context from the whole space, shape (C,).

        :param rng: the generator to draw from
        """
        return rng.uniform(self.context_space.low, self.context_space.high)

    def initial_trajectory(self, context: ArrayLike) -> FloatArray:
        """Return the start posture, held, shape (T, D).

        :param context: shape (C,)
        """
        self.check_context(context)
        return np.tile(self.arm.start, (self.n_time_points, 1))

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Return the expert's trajectory, shape (T, D).

        :param context: shape (C,)
        :param mode: ``"default"``, the only one
        :raises TaskError: mink is not installed, a via-pose is out of reach within the joints'
            ranges, or the limits are exceeded; the message names where and by how much
        """
        self.check_mode(mode)
        return self._answers[self.check_context(context)].copy()

    def _try(self) -> None:
        """Ask the user's functions in the lowest, the middle and the highest context.

        :raises TaskError: a function that returns no way or no place, limits of another number, or
            via-poses that lie out of reach in all of them
        """
        low, high = (
            end.astype(np.float64) for end in (self.context_space.low, self.context_space.high)
        )
        base, reach = self.arm.reach()
        beyond = []
        for context in (low, (low + high) / 2, high):
            for body, place in self.placed.items():
                name = f"placed['{body}']"
                vector(f"what {name} returns", asked(name, place, context), 3)
            way = check_way(asked("way", self.way, context))
            far = [
                float(np.linalg.norm(np.subtract(each.position, base)))
                for each in way
                if each.counts
            ]
            beyond.append(max(far) - reach)
        if min(beyond) > self.tolerance:
            raise TaskError(
                f"via-poses lie out of reach in the context {low.tolist()}, in {high.tolist()} and "
                f"midway, by at least {min(beyond):.3g} m: {self.arm.tip} comes at most "
                f"{reach:.3g} m from {base.round(3).tolist()} m. Bring them nearer, in m."
            )
        if self.limits is not None:
            rest = np.tile(self.arm.start, (2, 1))
            self.limits.check(rest, self.dt, self.trajectory_names)

    def _answer(self, context: FloatArray) -> FloatArray:
        way = check_way(self.way(context))
        share = np.arange(1, self.n_time_points + 1) / self.n_time_points
        joints = follow(self.arm, way, share, self.dt)
        for each, t in zip(way, self._due(way), strict=True):
            wanted = np.asarray(each.position, np.float64)
            miss = float(np.linalg.norm(self.arm.tip_position(joints[t]) - wanted))
            if miss > self.tolerance:
                raise TaskError(
                    f"the expert comes no nearer to {wanted.round(4).tolist()} m at "
                    f"{each.at:g} of the duration than {miss:.3g} m, {self.tolerance:g} m are "
                    f"wanted: it lies out of the reach of {self.arm.tip}, in context "
                    f"{context.round(4).tolist()}, or too far for the time."
                )
        if self.limits is not None:
            before = self.arm.start[None]
            self.limits.check(np.concatenate([before, joints]), self.dt, self.trajectory_names)
        return joints

    def _due(self, way: Sequence[ViaPose]) -> list[int]:
        """Return the time point at which each via-pose is due."""
        return [max(0, round(each.at * self.n_time_points) - 1) for each in way]

    def _initial_state(self, context: FloatArray) -> FloatArray:
        qpos = self.model.qpos0.copy()
        for name, value in zip(self.arm.joints, self.arm.start, strict=True):
            qpos[self.model.joint(name).qposadr[0]] = value
        return self.executor.initial_state(qpos)

    def _model(self, context: FloatArray) -> mujoco.MjModel:
        if not self.placed:
            return self.model
        model = copy.deepcopy(self.model)
        for body, place in self.placed.items():
            model.body(body).pos[:] = place(context)
        return model

    def _controls(self, contexts: FloatArray, followed: FloatArray) -> FloatArray:
        return interpolate(self.arm.start, followed, self.executor.substeps)

    def _measure(self, contexts: FloatArray, trajectories: FloatArray, log: SensorLog) -> Measured:
        executed = np.concatenate([log.readings[name] for name in self.arm.joints], axis=2)
        paths = {name: log.readings[name] for name in ("tip", *self.watched)}
        judged = [self._judge(c, tip) for c, tip in zip(contexts, paths["tip"], strict=True)]
        return Measured(
            executed=executed,
            terms={"way": -np.array([miss for miss, _ in judged])},
            successes=np.array([success for _, success in judged]),
            paths=paths,
        )

    def _judge(self, context: FloatArray, tip: FloatArray) -> tuple[float, bool]:
        """Return how far the tip is on average from the via-poses that count, and a success.

        :param context: shape (C,)
        :param tip: its path, shape (T, 3) in m
        """
        way = check_way(self.way(context))
        counting = [(t, each) for t, each in zip(self._due(way), way, strict=True) if each.counts]
        wanted = np.array([each.position for _, each in counting])
        misses = np.linalg.norm(tip[[t for t, _ in counting]] - wanted, axis=1)
        allowed = [each.tolerance or self.tolerance for _, each in counting]
        return float(np.minimum(misses, FARTHEST).mean()), bool((misses <= allowed).all())


def _box(low: ArrayLike, high: ArrayLike, names: tuple[str, ...]) -> spaces.Box:
    rule = f"a number for each of {list(names)}"
    pairs = (("context_low", low), ("context_high", high))
    ends = [as_numbers(name, given, rule).astype(np.float32) for name, given in pairs]
    fit = all(end.shape == (len(names),) and np.isfinite(end).all() for end in ends)
    if not names or not fit or not (ends[0] < ends[1]).all():
        raise TaskError(
            f"context_low is {low} and context_high {high}; each needs a number for each of "
            f"{list(names)}, finite, and the low one must be smaller."
        )
    return spaces.Box(ends[0], ends[1])
