"""Contracts that every registered task keeps; a new task is covered by being registered."""

from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv

import benchmark_envs
from benchmark_envs import (
    InvalidContextError,
    InvalidTrajectoryError,
    RenderingUnavailableError,
    Task,
    TaskError,
    TrajectoryVecEnv,
    UnknownTaskError,
    make_task,
    task_ids,
)

TASKS = pytest.mark.parametrize("task_id", task_ids())


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


@TASKS
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
def test_a_batch_gives_the_same_bits_as_single_rollouts_on_one_and_two_threads(
    task_id: str,
) -> None:
    contexts, trajectories = batch(make_task(task_id), 5)
    together = make_task(task_id, n_threads=2).simulate(contexts, trajectories)
    task = make_task(task_id, n_threads=1)
    for i in range(5):
        alone = task.simulate(contexts[i], trajectories[i])
        np.testing.assert_array_equal(alone.executed[0], together.executed[i])
        assert alone.rewards[0] == together.rewards[i]


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


@TASKS
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


@TASKS
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


@TASKS
def test_the_last_rollout_is_rendered_to_frames(task_id: str) -> None:
    env = gym.make(task_id, render_mode="rgb_array_list")
    context, _ = env.reset()
    task: Task = env.unwrapped.task  # pyright: ignore[reportAttributeAccessIssue]
    assert env.unwrapped.render() is None
    env.step(task.demonstrate(context))
    try:
        frames: Any = env.unwrapped.render()
    except RenderingUnavailableError as error:
        pytest.skip(str(error))
    assert len(frames) >= 25
    assert all(f.shape == frames[0].shape and f.dtype == np.uint8 for f in frames)
    assert np.std(frames[0]) > 10, "the picture is not blank"
    assert any((f != frames[0]).any() for f in frames), "something moves"
