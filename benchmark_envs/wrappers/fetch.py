"""gymnasium-robotics' Fetch tasks as trajectory bandits, and scripted experts for them.

Shape letters: T time points, D dimensions of a set-point, C context.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from benchmark_envs.exceptions import TaskError
from benchmark_envs.motion import minimum_jerk
from benchmark_envs.rollouts import FloatArray
from benchmark_envs.wrappers.context_source import ContextSource
from benchmark_envs.wrappers.controllers import PositionController
from benchmark_envs.wrappers.trajectory_action import TrajectoryActionWrapper

Array = NDArray[Any]

GAIN = 20.0  # an action of 1 moves the set-point of the gripper by 0.05 m
REACH = np.array([0.25, 0.25, 0.2])  # m; how far set-points lie from where the gripper begins
LOWEST = 0.41  # m; of set-points over a table, on which objects lie at 0.42 m
LIFT = 0.45  # m; the highest goal of pick-and-place above an object on the table
SCALE, GRIP_SCALE = 0.1, 0.5  # m, and of the fingers' command, at which a search begins
T = 50  # time points, which is the Fetch tasks' max_episode_steps


@dataclass(frozen=True)
class FetchTask:
    """What the bandit of a Fetch task looks like.

    :param goal: entries of the goal that vary
    :param has_object: whether the object's x and y are part of the context
    :param grips: whether the gripper opens and closes, the fourth entry of a set-point
    :param shoots: whether goals lie where the gripper cannot reach
    """

    goal: tuple[int, ...]
    has_object: bool = True
    grips: bool = False
    shoots: bool = False


TASKS = {
    "FetchReach": FetchTask((0, 1, 2), has_object=False),
    "FetchPush": FetchTask((0, 1)),
    "FetchSlide": FetchTask((0, 1), shoots=True),
    "FetchPickAndPlace": FetchTask((0, 1, 2), grips=True),
}


def fetch_env(env_id: str, reward_type: str = "dense", **settings: Any) -> TrajectoryActionWrapper:  # noqa: ANN401
    """Build a Fetch task as a trajectory bandit.

    A trajectory holds 50 set-points of the gripper, x, y and z in m, 25 a second; for
    pick-and-place also the fingers' command, from -1 (close) to 1 (open). The context is the goal,
    and the object's x and y in m where there is an object. The reward is the last step's: minus the
    final distance in m (``"dense"``), or 0 within 0.05 m and -1 elsewhere (``"sparse"``).
    ``achieved_context`` is where the gripper or the object ended.

    :param env_id: such as ``"FetchReach-v4"``; also FetchPush, FetchSlide and FetchPickAndPlace
    :param reward_type: ``"dense"`` or ``"sparse"``
    :param settings: further arguments of ``gym.make``, such as ``render_mode``
    :raises TaskError: another environment or type of reward, or gymnasium-robotics is not installed
    """
    task = _fetch_task(env_id)
    if reward_type not in ("dense", "sparse"):  # the environment would take any as dense
        raise TaskError(f"reward_type is {reward_type!r}; it must be 'dense' or 'sparse'.")
    env = gym.make(env_id, reward_type=reward_type, **settings)
    source = _source(env.unwrapped, task)
    start = np.array(env.get_wrapper_attr("initial_gripper_xpos"), np.float64)
    low, high, scale = start - REACH, start + REACH, np.full(3, SCALE)
    if task.has_object:
        low[2], high[2] = LOWEST, LOWEST + REACH[2]
    if task.grips:
        low, high = np.append(low, -1.0), np.append(high, 1.0)
        high[2], scale = LOWEST + REACH[2] + LIFT, np.append(scale, GRIP_SCALE)
    return TrajectoryActionWrapper(
        env,
        context=source,
        controller=PositionController(gripper, GAIN, fill=() if task.grips else (0.0,)),
        low=low,
        high=high,
        returns="last",
        initial=gripper_and_fingers if task.grips else gripper,
        exploration_scale=scale,
    )


def gripper(observation: dict[str, Array]) -> Array:
    """Return where the gripper is, x, y and z in m.

    :param observation: of a Fetch task
    """
    return observation["observation"][:3]


def gripper_and_fingers(observation: dict[str, Array]) -> Array:
    """Return where the gripper is, x, y and z in m, and that its fingers are half open.

    :param observation: of a Fetch task
    """
    return np.append(gripper(observation), 0.0)


class FetchExpert:
    """A scripted expert of FetchReach, FetchPush and FetchPickAndPlace.

    FetchReach: a straight line, with the minimum-jerk profile, in 30 of the 50 time points.
    FetchPush: over the object, down behind it, and straight on to the goal. FetchPickAndPlace: over
    the object with open fingers, down, close, and straight on to the goal.

    >>> expert = FetchExpert("FetchReach-v4")  # doctest: +SKIP
    >>> Demonstrations.from_task(expert, 20, seed=0).trajectories.shape  # doctest: +SKIP
    (20, 50, 3)

    :param env_id: of the Fetch task
    :raises TaskError: another environment, or gymnasium-robotics is not installed
    """

    def __init__(self, env_id: str) -> None:
        self.task = _fetch_task(env_id)
        if self.task.shoots:
            raise TaskError(f"there is no expert for {env_id}: it would have to aim a slide.")
        self.env = fetch_env(env_id)
        self.env.reset(seed=0)
        self.start = self.env.initial_trajectory()[0, :3]

    def sample_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw a context as the environment does, shape (C,).

        :param rng: the generator to draw from
        """
        return self.env.reset(seed=int(rng.integers(2**31)))[0].astype(np.float64)

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Return a trajectory that solves a context, shape (T, D).

        :param context: shape (C,)
        :param mode: there is only ``"default"``
        :raises TaskError: another mode
        """
        if mode not in (None, "default"):
            raise TaskError(f"no mode '{mode}' of the expert; there is only 'default'.")
        c = self.env.source.check(context).astype(np.float64)
        n_goal = len(self.task.goal)
        goal, thing = c[:n_goal], c[n_goal:]
        if not self.task.has_object:
            return _through([(0, self.start), (30, goal)])
        table = float(self.env.env.get_wrapper_attr("height_offset"))
        if self.task.grips:
            return _pick(self.start, np.append(thing, table), goal)
        return _push(self.start, np.append(thing, table), np.append(goal, table))


def _push(start: FloatArray, thing: FloatArray, goal: FloatArray) -> FloatArray:
    """Return the way over an object, down behind it, and on to the goal, shape (T, 3)."""
    way = (goal - thing) / max(float(np.linalg.norm(goal - thing)), 1e-6)
    behind, end = thing - 0.08 * way, goal - 0.035 * way
    high = np.array([0.0, 0.0, 0.12])
    steps = [(0, start), (4, start + high), (13, behind + high), (19, behind), (44, end)]
    return _through(steps)


def _pick(start: FloatArray, thing: FloatArray, goal: FloatArray) -> FloatArray:
    """Return the way to an object, its grasp, and the way to the goal, shape (T, 4)."""
    high = np.array([0.0, 0.0, 0.1])
    path = _through([(0, start), (11, thing + high), (18, thing), (24, thing), (42, goal)])
    fingers = np.where(np.arange(T) < 18, 1.0, -1.0)
    return np.column_stack([path, fingers])


def _through(points: list[tuple[int, FloatArray]]) -> FloatArray:
    """Return minimum-jerk moves from point to point, at rest in each, shape (T, D).

    :param points: at which time points to be where; the last one is held
    """
    times = np.arange(T)
    path = np.repeat(points[0][1][None], T, axis=0)
    for (begin, before), (end, after) in pairwise(points):
        share = minimum_jerk((times - begin) / (end - begin))[:, None]
        path = np.where(times[:, None] >= begin, before + share * (after - before), path)
    return path


def _fetch_task(env_id: str) -> FetchTask:
    """Return what a Fetch task's bandit looks like, after registering gymnasium-robotics.

    :raises TaskError: another environment, or gymnasium-robotics is not installed
    """
    name = str(env_id).split("-v")[0].removesuffix("Dense")
    if name not in TASKS:
        raise TaskError(
            f"'{env_id}' is no Fetch task; there are {', '.join(TASKS)}, such as 'FetchReach-v4'."
        )
    try:
        import gymnasium_robotics
    except ImportError as error:
        raise TaskError(
            "the Fetch tasks need gymnasium-robotics: pip install 'sb3-nmp[robotics]'."
        ) from error
    gym.register_envs(gymnasium_robotics)
    return TASKS[name]


def _source(base: Any, task: FetchTask) -> ContextSource:  # noqa: ANN401
    """Return where the context of a Fetch task is read, and how it is set.

    :param base: the unwrapped environment
    :param task: what its bandit looks like
    """
    start, indices = np.array(base.initial_gripper_xpos, np.float64), list(task.goal)
    low = start + base.target_offset - base.target_range
    high = start + base.target_offset + base.target_range
    if task.has_object:
        low[2], high[2] = base.height_offset, base.height_offset + LIFT
    low, high = low[indices], high[indices]
    if task.has_object:
        low = np.concatenate([low, start[:2] - base.obj_range])
        high = np.concatenate([high, start[:2] + base.obj_range])
    space = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
    told = _Told(task)
    return ContextSource(told.read, space, _Place(task), told.achieved)


@dataclass(frozen=True)
class _Told:
    """What observations of a Fetch task tell; methods, unlike local functions, can be pickled.

    :param task: what its bandit looks like
    """

    task: FetchTask

    def read(self, observation: dict[str, Array]) -> Array:
        """Return the context, shape (C,).

        :param observation: the first one
        """
        where = observation["achieved_goal"][:2] if self.task.has_object else np.zeros(0)
        return np.concatenate([observation["desired_goal"][list(self.task.goal)], where])

    def achieved(self, context: Array, observation: dict[str, Array]) -> Array:
        """Return the context in which the rollout would have been right, shape (C,).

        :param context: in which it began, shape (C,)
        :param observation: the last one
        """
        indices = list(self.task.goal)
        return np.concatenate([observation["achieved_goal"][indices], context[len(indices) :]])


@dataclass(frozen=True)
class _Place:
    """Puts a Fetch task that was just reset into a context.

    :param task: what its bandit looks like
    """

    task: FetchTask

    def __call__(self, env: gym.Env[Any, Any], context: Array) -> dict[str, Array]:
        """Set the goal, and the object's x and y; return the observation.

        :param env: the environment
        :param context: shape (C,)
        """
        base: Any = env.unwrapped
        indices = list(self.task.goal)
        if self.task.has_object:
            base.goal[2] = base.height_offset
        base.goal[indices] = context[: len(indices)]
        if self.task.has_object:
            name = "object0:joint"
            pose = base._utils.get_joint_qpos(base.model, base.data, name)
            pose[:2] = context[len(indices) :]
            base._utils.set_joint_qpos(base.model, base.data, name, pose)
        base.data.qacc_warmstart[:] = 0.0  # so that the rollout does not depend on what was before
        base._mujoco.mj_forward(base.model, base.data)
        return base._get_obs()
