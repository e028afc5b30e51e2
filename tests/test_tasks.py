"""Contracts that every registered task keeps; a new task is covered by being registered.

What `benchmark_envs.check_task` asks of any task stands in tests/test_check_task.py.
"""

import json
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from numpy.typing import ArrayLike
from stable_baselines3.common.env_checker import check_env as sb3_check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv

import benchmark_envs
from benchmark_envs import (
    InvalidContextError,
    InvalidTrajectoryError,
    Measured,
    MujocoTask,
    RenderingUnavailableError,
    Task,
    TaskError,
    TrajectoryVecEnv,
    UnknownTaskError,
    make_task,
    register_task,
    task_ids,
)

TASKS = pytest.mark.parametrize("task_id", task_ids())
#: those with physics; an analytic task has no model that could diverge
MUJOCO_TASKS = pytest.mark.parametrize(
    "task_id", [one for one in task_ids() if isinstance(make_task(one), MujocoTask)]
)

#: settings with which the whole context is drawn
DRAWN_BY: dict[str, dict[str, Any]] = {
    "nmp/Bottles-v0": {"random_bottles": True},
    "nmp/PickAndPlace-v1": {"field": True},
}


def context_of(task: Task, seed: int = 0) -> np.ndarray:
    return task.sample_context(np.random.default_rng(seed))


def batch(task: Task, n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Contexts (n, C), and smooth random trajectories (n, T, D) around the initial ones."""
    rng = np.random.default_rng(seed)
    contexts = np.stack([task.sample_context(rng) for _ in range(n)])
    initial = np.stack([task.initial_trajectory(context) for context in contexts])
    bend = np.sin(np.linspace(0, 2 * np.pi, initial.shape[1]))[None, :, None]
    return contexts, initial + bend * rng.normal(0, 0.08, (n, 1, initial.shape[2]))


@TASKS
def test_spaces_are_finite_and_every_entry_is_named(task_id: str) -> None:
    task = make_task(task_id)
    for space, names in (
        (task.context_space, task.context_names),
        (task.trajectory_space, task.trajectory_names),
    ):
        assert np.isfinite([space.low, space.high]).all()
        assert space.shape[-1] == len(names)
        assert all("[" in name for name in names), "every name carries a unit"


MODEL_ELEMENTS = {
    mujoco.mjtObj.mjOBJ_BODY: "nbody",
    mujoco.mjtObj.mjOBJ_JOINT: "njnt",
    mujoco.mjtObj.mjOBJ_GEOM: "ngeom",
    mujoco.mjtObj.mjOBJ_SITE: "nsite",
    mujoco.mjtObj.mjOBJ_CAMERA: "ncam",
    mujoco.mjtObj.mjOBJ_LIGHT: "nlight",
    mujoco.mjtObj.mjOBJ_PAIR: "npair",
    mujoco.mjtObj.mjOBJ_EQUALITY: "neq",
    mujoco.mjtObj.mjOBJ_ACTUATOR: "nu",
    mujoco.mjtObj.mjOBJ_SENSOR: "nsensor",
    mujoco.mjtObj.mjOBJ_MATERIAL: "nmat",
    mujoco.mjtObj.mjOBJ_TEXTURE: "ntex",
}


@MUJOCO_TASKS
def test_every_element_of_the_model_is_named(task_id: str) -> None:
    task: Any = make_task(task_id)
    model = task.model
    for kind, counter in MODEL_ELEMENTS.items():
        names = [mujoco.mj_id2name(model, kind, i) for i in range(getattr(model, counter))]
        assert all(names), counter
        assert names or counter not in ("ngeom", "nu", "nsensor")


@TASKS
def test_drawn_contexts_lie_in_the_space_and_follow_the_seed(task_id: str) -> None:
    task = make_task(task_id)
    for seed in range(20):
        context = task.check_context(context_of(task, seed))
        np.testing.assert_array_equal(context, context_of(task, seed))


@TASKS
def test_reward_terms_add_up_and_stay_in_range(task_id: str) -> None:
    task = make_task(task_id)
    rollouts = task.simulate(*batch(task, 40))
    np.testing.assert_allclose(sum(rollouts.terms.values()), rollouts.rewards, atol=1e-12)
    low, high = task.reward_range
    assert ((rollouts.rewards >= low) & (rollouts.rewards <= high)).all()


@TASKS
def test_the_expert_succeeds_in_every_mode_and_naive_trajectories_do_not(task_id: str) -> None:
    task = make_task(task_id)
    contexts, _ = batch(task, 40)
    for mode in task.modes:
        expert = np.stack([task.demonstrate(context, mode) for context in contexts])
        assert task.simulate(contexts, expert).successes.mean() >= 0.95
    initial = np.stack([task.initial_trajectory(context) for context in contexts])
    assert not task.simulate(contexts, initial).successes.any()
    noise = np.random.default_rng(0).uniform(
        task.trajectory_space.low, task.trajectory_space.high, (20, *task.trajectory_space.shape)
    )
    assert not task.simulate(contexts[:20], noise).successes.any()


@TASKS
def test_wrong_trajectories_are_refused_by_name_and_rule(task_id: str) -> None:
    task = make_task(task_id)
    context = context_of(task)
    good = task.initial_trajectory(context)
    with pytest.raises(InvalidTrajectoryError, match=r"has shape \(T, D\) = "):
        task.simulate(context, good[:-1])
    broken = good.copy()
    broken[3, 0] = np.nan
    with pytest.raises(InvalidTrajectoryError, match="nan at time point 3, dimension 0"):
        task.simulate(context, broken)
    with pytest.raises(InvalidContextError, match="3 contexts were given for 2 trajectories"):
        task.simulate(np.stack([context] * 3), np.stack([good] * 2))


@TASKS
def test_contexts_outside_the_space_are_refused_with_the_bounds(task_id: str) -> None:
    task = make_task(task_id)
    outside = task.context_space.high.astype(float)
    outside[0] += 1.0
    with pytest.raises(InvalidContextError, match=r"entry 0 .* must lie in \["):
        task.check_context(outside)
    with pytest.raises(InvalidContextError, match="has shape"):
        task.check_context(outside[:-1])
    with pytest.raises(InvalidContextError):
        gym.make(task_id, context=outside)
    with pytest.raises(InvalidContextError):
        gym.make(task_id).reset(options={"context": np.full(outside.shape, np.nan)})


@TASKS
def test_set_points_outside_the_space_are_clipped_and_reported(task_id: str) -> None:
    task = make_task(task_id)
    context = context_of(task)
    trajectory = task.initial_trajectory(context)
    trajectory[-1] = task.trajectory_space.high[-1] + 1.0
    rollouts = task.simulate(context, trajectory)
    assert rollouts.clipped[0] and rollouts.info(0)["clipped"]
    np.testing.assert_allclose(rollouts.trajectories[0, -1], task.trajectory_space.high[-1])


@MUJOCO_TASKS
def test_a_diverging_simulation_gives_the_worst_reward_and_says_so(task_id: str) -> None:
    task = make_task(task_id)
    context = context_of(task)
    expert = task.demonstrate(context)
    model: Any = task.__dict__["model"]
    model.opt.gravity[2] = np.nan
    rollouts = task.simulate(context, expert)
    assert rollouts.diverged[0] and not rollouts.successes[0]
    assert rollouts.rewards[0] == task.reward_range[0]
    assert np.isfinite(rollouts.executed).all()
    healthy = make_task(task_id).simulate(context, expert)
    assert not healthy.diverged[0]


@MUJOCO_TASKS
def test_a_divergence_does_not_spread_to_the_next_rollouts(task_id: str) -> None:
    task = make_task(task_id, n_threads=1)
    contexts, trajectories = batch(task, 2)
    before = task.simulate(contexts, trajectories)
    model: Any = task.__dict__["model"]
    gravity = model.opt.gravity.copy()
    model.opt.gravity[2] = np.nan
    assert task.simulate(contexts, trajectories).diverged.all()
    model.opt.gravity[:] = gravity
    np.testing.assert_array_equal(task.simulate(contexts, trajectories).executed, before.executed)


# -- the Gymnasium and SB3 faces -----------------------------------------------------------------


@TASKS
def test_gymnasium_and_sb3_checkers_accept_the_environment(task_id: str) -> None:
    check_env(gym.make(task_id).unwrapped, skip_render_check=True)
    sb3_check_env(gym.make(task_id).unwrapped, warn=False, skip_render_check=True)


@TASKS
def test_one_episode_is_one_rollout_with_scalar_success(task_id: str) -> None:
    env = gym.make(task_id)
    context, _ = env.reset(seed=3)
    task: Task = env.unwrapped.task  # pyright: ignore[reportAttributeAccessIssue]
    observed, reward, terminated, truncated, info = env.step(task.demonstrate(context))
    assert terminated and not truncated and isinstance(reward, float)
    assert info["is_success"] is True and info["diverged"] is False
    assert info["executed_trajectory"].shape == env.action_space.shape
    terms = [value for key, value in info.items() if key.startswith("reward_")]
    assert sum(terms) == pytest.approx(reward)
    np.testing.assert_array_equal(observed, context)


@TASKS
def test_a_pinned_context_and_the_reset_option_are_followed(task_id: str) -> None:
    middle = (make_task(task_id).context_space.low + make_task(task_id).context_space.high) / 2
    env = gym.make(task_id, context=middle)
    for _ in range(3):
        np.testing.assert_allclose(env.reset()[0], middle)
    other = middle * 0.99
    np.testing.assert_allclose(env.reset(options={"context": other})[0], other, rtol=1e-6)
    np.testing.assert_allclose(env.reset()[0], middle)
    with pytest.raises(TaskError, match="the only one is 'context'"):
        env.reset(options={"target": other})


@TASKS
def test_the_context_that_is_observed_is_the_one_that_is_simulated(task_id: str) -> None:
    """Contexts are float32 in spaces and observations, and nowhere anything else."""
    settings = DRAWN_BY.get(task_id, {})
    env = gym.make(task_id, **settings)
    task: Task = env.unwrapped.task  # pyright: ignore[reportAttributeAccessIssue]
    for seed in range(8):
        observed, _ = env.reset(seed=seed)
        drawn = context_of(task, seed)
        np.testing.assert_array_equal(observed.astype(float), drawn)
        bend = np.sin(np.linspace(0, 3, len(task.times)))[:, None]
        trajectory = (task.demonstrate(drawn) + 0.01 * bend).astype(np.float32)
        first = env.step(trajectory)
        unrounded = drawn + 1e-10  # as a user's float64, nearer to it than to any other float32
        np.testing.assert_array_equal(task.demonstrate(unrounded), task.demonstrate(drawn))
        for context in (observed, observed.astype(float), unrounded):
            again, _ = env.reset(options={"context": context})
            np.testing.assert_array_equal(again, observed)
            assert_same_step(env.step(trajectory), first)
            pinned = gym.make(task_id, context=context, **settings)
            pinned.reset()
            assert_same_step(pinned.step(trajectory), first)
            rollouts = task.simulate(context, trajectory)
            assert rollouts.rewards[0] == first[1]
            np.testing.assert_array_equal(rollouts.contexts[0], observed.astype(float))


def assert_same_step(step: tuple, other: tuple) -> None:
    np.testing.assert_array_equal(step[0], other[0])
    assert step[1] == other[1] and step[4]["is_success"] == other[4]["is_success"]
    np.testing.assert_array_equal(step[4]["executed_trajectory"], other[4]["executed_trajectory"])


@TASKS
def test_stepping_before_reset_is_refused(task_id: str) -> None:
    env = gym.make(task_id).unwrapped
    with pytest.raises(TaskError, match="call reset"):
        env.step(make_task(task_id).trajectory_space.low)


@TASKS
def test_the_batched_vec_env_equals_separate_environments(task_id: str) -> None:
    batched = make_vec_env(task_id, n_envs=3, seed=5, vec_env_cls=TrajectoryVecEnv)
    separate = make_vec_env(task_id, n_envs=3, seed=5, vec_env_cls=DummyVecEnv)
    task = make_task(task_id)
    np.testing.assert_array_equal(batched.reset(), separate.reset())
    for step in range(2):
        actions = batch(task, 3, seed=step)[1].astype(np.float32)
        one, two = batched.step(actions), separate.step(actions)
        for a, b in zip(one[:3], two[:3], strict=True):
            np.testing.assert_array_equal(a, b)
        for a, b in zip(one[3], two[3], strict=True):
            assert a["episode"]["r"] == b["episode"]["r"]
            assert a["is_success"] == b["is_success"]
            np.testing.assert_array_equal(a["executed_trajectory"], b["executed_trajectory"])


@TASKS
def test_the_batched_vec_env_simulates_once_a_step(
    task_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    env = make_vec_env(task_id, n_envs=4, vec_env_cls=TrajectoryVecEnv)
    assert isinstance(env, TrajectoryVecEnv)
    env.reset()
    sizes: list[int] = []
    simulate = Task.simulate
    monkeypatch.setattr(
        Task,
        "simulate",
        lambda self, c, t: sizes.append(len(t)) or simulate(self, c, t),
    )
    env.step(batch(env.task, 4)[1].astype(np.float32))
    assert sizes == [4]


def test_the_batched_vec_env_respects_wrappers_that_change_the_trajectory() -> None:
    class Shift(gym.ActionWrapper):
        def action(self, action: np.ndarray) -> np.ndarray:
            return action + np.float32(0.01)

    kwargs: dict[str, Any] = {"n_envs": 2, "wrapper_class": Shift}
    batched = make_vec_env("nmp/Bottles-v0", vec_env_cls=TrajectoryVecEnv, **kwargs)
    separate = make_vec_env("nmp/Bottles-v0", **kwargs)
    batched.reset()
    separate.reset()
    actions = batch(make_task("nmp/Bottles-v0"), 2)[1].astype(np.float32)
    np.testing.assert_array_equal(batched.step(actions)[1], separate.step(actions)[1])


def test_the_batched_vec_env_refuses_a_mix_of_tasks() -> None:
    with pytest.raises(TaskError, match="holds one task"):
        TrajectoryVecEnv(
            [
                lambda: gym.make("nmp/Bottles-v0"),
                lambda: gym.make("nmp/Bottles-v0", random_bottles=True),
            ]
        )
    with pytest.raises(TaskError, match="holds TrajectoryEnv only"):
        TrajectoryVecEnv([lambda: gym.make("CartPole-v1")])


# -- what a task tells about itself --------------------------------------------------------------


@TASKS
def test_the_terms_and_summands_of_the_reward_are_those_that_are_documented(task_id: str) -> None:
    variants: list[dict[str, Any]] = [{}, {"reward": "goal"}] if task_id == "nmp/Push-v0" else [{}]
    for settings in variants:
        task = make_task(task_id, **settings)
        rollouts = task.simulate(context_of(task), task.initial_trajectory(context_of(task)))
        assert list(rollouts.terms) == list(task.metadata()["reward_terms"])
        assert all(len(meaning) > 10 for meaning in task.reward_terms.values())
        unit = f"[{task.error_unit}]"
        assert all(text.endswith(unit) != (unit == "[]") for text in task.reward_terms.values())
        assert (rollouts.step_rewards is None) == (task.step_reward == "")
        if rollouts.step_rewards is not None:
            assert rollouts.step_rewards.shape == (1, len(task.times))
            assert rollouts.step_rewards.sum() == pytest.approx(rollouts.rewards[0])


@TASKS
def test_a_task_tells_its_time_in_seconds(task_id: str) -> None:
    task: Any = make_task(task_id)
    n_time_points = task.trajectory_space.shape[0]
    if isinstance(task, MujocoTask):
        assert task.dt == pytest.approx(task.executor.substeps * task.model.opt.timestep)
    assert task.times.shape == (n_time_points,) and task.times[0] == task.dt
    assert task.duration == pytest.approx(n_time_points * task.dt)
    assert (np.diff(task.times) > 0).all()


@TASKS
def test_the_metadata_are_plain_json_and_complete(task_id: str) -> None:
    task = make_task(task_id)
    told = task.metadata()
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    assert (told["n_time_points"], told["n_dimensions"]) == task.trajectory_space.shape
    for space in ("context", "trajectory"):
        names, units = told[f"{space}_names"], told[f"{space}_units"]
        assert len(names) == len(units)
        assert all(name.endswith(f" [{unit}]") for name, unit in zip(names, units, strict=True))
    if task.optimum is not None:
        low, high = task.reward_range
        assert low < task.optimum[1] <= high


@TASKS
def test_the_expert_is_recognised_by_its_mode(task_id: str) -> None:
    task = make_task(task_id)
    context = context_of(task)
    for mode in task.modes:
        executed = task.simulate(context, task.demonstrate(context, mode)).executed[0]
        assert task.mode_of(context, executed) in (mode, "")


@TASKS
def test_the_scene_is_plain_json_and_the_expert_keeps_to_what_is_in_it(task_id: str) -> None:
    task = make_task(task_id)
    context = context_of(task, seed=1)
    scene = task.scene(context)
    if scene is None:
        return
    assert json.loads(json.dumps(scene, allow_nan=False)) == scene
    assert set(scene) <= {"limits", "along", "points", "targets", "circles", "ellipses", "boxes"}
    path = task.simulate(context, task.demonstrate(context)).executed[0]
    if "along" in scene:
        x = np.linspace(scene["along"]["low"], scene["along"]["high"], len(path))
        path = np.column_stack([x, path])
    limits = np.array(scene["limits"])
    assert ((path >= limits[:, 0]) & (path <= limits[:, 1])).all()
    for name, point in scene.get("points", {}).items():
        end = path[{"start": 0, "goal": -1}[name]]
        np.testing.assert_allclose(end, point, atol=0.1)
    for target in scene.get("targets", ()):
        assert np.linalg.norm(path - target, axis=1).min() < 0.03
    obstacles = [*scene.get("circles", ()), *scene.get("ellipses", ()), *scene.get("boxes", ())]
    assert obstacles or scene["targets"]
    for circle in scene.get("circles", ()):
        assert np.linalg.norm(path - circle["center"], axis=1).min() > circle["radius"]
    for ellipse in scene.get("ellipses", ()):
        scaled = (path - ellipse["center"]) / ellipse["radii"]
        assert np.linalg.norm(scaled, axis=1).min() > 1
    for box in scene.get("boxes", ()):
        assert not ((path > box["low"]) & (path < box["high"])).all(axis=1).any()


@TASKS
def test_settings_rebuild_the_task_and_threads_are_none_of_them(task_id: str) -> None:
    task = make_task(task_id, n_threads=1)
    assert tuple(task.settings) == task.setting_names() and "n_threads" not in task.settings
    assert json.loads(json.dumps(task.settings)) == task.settings
    assert make_task(task_id, **task.settings).settings == task.settings


def test_environments_of_one_task_may_differ_in_threads_alone() -> None:
    task_id = "nmp/Bottles-v0"
    TrajectoryVecEnv([lambda n=n: gym.make(task_id, n_threads=n) for n in (1, 2)])


def test_a_task_without_physics_is_written_in_a_few_lines_and_diverges_like_any_other() -> None:
    class Reach(Task):
        context_names = ("target [m]",)
        trajectory_names = ("x [m]",)
        exploration_scale = (0.1,)
        reward_terms: Mapping[str, str] = {"distance": "minus the last point's distance [m]"}
        step_reward = "the distance at the last time point [m]"
        context_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        trajectory_space = spaces.Box(-2.0, 2.0, (10, 1), np.float32)
        dt = 0.5

        @property
        def reward_range(self) -> tuple[float, float]:
            return -3.0, 0.0

        def _draw_context(self, rng: np.random.Generator) -> np.ndarray:
            return rng.uniform(-1.0, 1.0, 1)

        def initial_trajectory(self, context: ArrayLike) -> np.ndarray:
            return np.zeros((10, 1))

        def demonstrate(self, context: ArrayLike, mode: str | None = None) -> np.ndarray:
            return np.linspace(0.0, 1.0, 10)[:, None] * self.check_context(context)

        def _execute(self, contexts: np.ndarray, trajectories: np.ndarray) -> Measured:
            distance = np.abs(trajectories[:, -1, 0] - contexts[:, 0])
            steps = np.zeros((len(contexts), 10))
            steps[:, -1] = -distance
            return Measured(
                executed=0.5 * trajectories,
                terms={"distance": -distance},
                successes=distance < 0.1,
                diverged=contexts[:, 0] < 0,
                clipped=contexts[:, 0] > 0.9,
                step_rewards=steps,
            )

    task = Reach()
    contexts = np.array([[0.5], [-0.5], [0.95]])
    rollouts = task.simulate(contexts, [task.demonstrate(c) for c in contexts])
    np.testing.assert_array_equal(rollouts.diverged, [False, True, False])
    np.testing.assert_array_equal(rollouts.successes, [True, False, True])
    np.testing.assert_array_equal(rollouts.clipped, [False, False, True])
    np.testing.assert_allclose(rollouts.rewards, [0.0, -3.0, 0.0], atol=1e-6)
    np.testing.assert_array_equal(rollouts.terms["diverged"], [0.0, -3.0, 0.0])
    np.testing.assert_array_equal(rollouts.executed[1], rollouts.trajectories[1])
    np.testing.assert_array_equal(rollouts.executed[0], rollouts.trajectories[0] / 2)
    assert rollouts.step_rewards is not None
    np.testing.assert_allclose(rollouts.step_rewards.sum(axis=1), rollouts.rewards)
    assert task.settings == {} and task.duration == 5.0 and task.scene([0.5]) is None
    check_env(benchmark_envs.TrajectoryEnv(task), skip_render_check=True)
    with pytest.raises(RenderingUnavailableError, match="Reach draws no pictures"):
        task.frames([0.5], np.zeros((10, 1)))


def test_importing_the_package_loads_no_torch() -> None:
    lines = (
        "import sys, benchmark_envs, gymnasium",
        "gymnasium.make('nmp/Bottles-v0').reset()",
        "heavy = {'torch', 'stable_baselines3', 'pandas', 'scipy'} & set(sys.modules)",
        "assert not heavy, heavy",
        "from benchmark_envs import TrajectoryVecEnv",
        "assert TrajectoryVecEnv.__name__ == 'TrajectoryVecEnv' and 'torch' in sys.modules",
        "assert set(benchmark_envs.__all__) <= set(dir(benchmark_envs)) | {'TrajectoryVecEnv'}",
    )
    subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True)
    with pytest.raises(AttributeError, match="no attribute 'TrajectoryVec'"):
        benchmark_envs.TrajectoryVec  # noqa: B018  # pyright: ignore[reportAttributeAccessIssue]


# -- errors and pictures -------------------------------------------------------------------------


def test_unknown_ids_settings_and_modes_list_what_exists() -> None:
    with pytest.raises(UnknownTaskError, match=r"Did you mean 'nmp/Bottles-v0'\?"):
        make_task("nmp/Botles-v0")
    with pytest.raises(TaskError, match="it has: random_bottles"):
        make_task("nmp/Bottles-v0", bottles=3)
    with pytest.raises(TaskError, match="there are s, reverse_s"):
        task = make_task("nmp/Bottles-v0")
        task.demonstrate(context_of(task), "straight")
    with pytest.raises(TaskError, match="no render mode 'human'"):
        benchmark_envs.TrajectoryEnv("nmp/Bottles-v0", render_mode="human")


def test_what_cannot_be_registered_leaves_nothing_behind() -> None:
    push = type(make_task("nmp/Push-v0"))
    for given, message in (
        (push, "it needs the task's id, such as @register_task"),
        ("my lab/Hit Ball", "Gymnasium's ids look like 'mylab/HitBall-v0'"),
    ):
        with pytest.raises(TaskError, match=message):
            register_task(given)  # type: ignore[arg-type]
    with pytest.raises(TaskError, match="'mylab/Text-v0'; it must be a class of Task"):
        register_task("mylab/Text-v0")(str)  # type: ignore[type-var]
    other = type("Other", (push,), {})
    with pytest.raises(TaskError, match=r"'nmp/Push-v0' is registered twice.*Push.*Other"):
        register_task("nmp/Push-v0")(other)
    assert type(make_task("nmp/Push-v0")) is push
    assert "mylab/Text-v0" not in [*benchmark_envs.task_ids(), *gym.registry]


@TASKS
def test_the_last_rollout_is_rendered_to_frames(task_id: str) -> None:
    try:
        env = gym.make(task_id, render_mode="rgb_array_list")
        context, _ = env.reset()
        first: Any = env.unwrapped.render()
    except RenderingUnavailableError as error:
        pytest.skip(str(error))
    task: Task = env.unwrapped.task  # pyright: ignore[reportAttributeAccessIssue]
    env.step(task.demonstrate(context))
    frames: Any = env.unwrapped.render()
    (begin,) = first
    assert len(frames) >= 25
    assert begin.shape == frames[0].shape and np.abs(frames[0].astype(float) - begin).mean() < 10
    assert len(frames) >= int(task.duration * env.metadata["render_fps"])
    assert all(f.shape == frames[0].shape and f.dtype == np.uint8 for f in frames)
    assert np.std(frames[0]) > 10, "the picture is not blank"
    assert any((f != frames[0]).any() for f in frames), "something moves"
