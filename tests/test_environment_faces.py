"""What Gymnasium's and SB3's own tools ask of our environments: copies, workers, films."""

import copy
import pickle
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import RecordVideo
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecVideoRecorder

from baselines import GA, REPS
from benchmark_envs import RenderingUnavailableError, TaskError, TrajectoryEnv, task_ids
from tests.registry import ENV_ID
from tests.test_algorithms import build, run, vec_env

TASKS = pytest.mark.parametrize("task_id", task_ids())


class Plain(gym.Env[Any, Any]):
    """A trajectory bandit that offers nothing but the interface of Gymnasium."""

    observation_space = spaces.Box(-1.0, 1.0, (1,))
    action_space = spaces.Box(-1.0, 1.0, (5, 2))

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.context = self.np_random.uniform(-1.0, 1.0, 1).astype(np.float32)
        return self.context, {}

    def step(self, action: Any) -> Any:
        return self.context, -float(np.abs(action - self.context).sum()), True, False, {}


@TASKS
def test_sb3s_checker_accepts_every_task(task_id: str) -> None:
    check_env(TrajectoryEnv(task_id, n_threads=1), warn=False, skip_render_check=True)


@TASKS
def test_environments_are_pickled_and_copied_after_a_step(task_id: str) -> None:
    env: Any = gym.make(task_id, n_threads=1)
    context, _ = env.reset(seed=0)
    trajectory = env.unwrapped.initial_trajectory()
    reward = env.step(trajectory)[1]
    for again in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        state = again.unwrapped.np_random.bit_generator.state
        assert state == env.unwrapped.np_random.bit_generator.state
        again.reset(options={"context": context})
        assert again.step(trajectory)[1] == reward


def test_worker_processes_know_the_tasks_and_give_the_same_bits() -> None:
    """Whatever the main module imports: here it is pytest's."""
    workers = make_vec_env(
        ENV_ID, 2, env_kwargs={"random_bottles": True, "n_threads": 1}, vec_env_cls=SubprocVecEnv
    )
    try:
        one = run(build(REPS, workers), 16)
    finally:
        workers.close()
    two = run(build(REPS, vec_env(2, random_bottles=True)), 16)
    np.testing.assert_array_equal(one.trajectories, two.trajectories)


class Workers(DummyVecEnv):
    """Breaks where a worker process would end: when asked for an attribute that is not there."""

    def has_attr(self, attr_name: str) -> bool:
        try:
            super().get_attr(attr_name)
        except AttributeError:
            return False
        return True

    def get_attr(self, attr_name: str, indices: Any = None) -> Any:
        assert self.has_attr(attr_name), attr_name
        return super().get_attr(attr_name, indices)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        assert self.has_attr(method_name), method_name
        return super().env_method(method_name, *args, indices=indices, **kwargs)


def test_plain_environments_are_asked_for_nothing_that_they_do_not_have() -> None:
    for algorithm in (REPS, GA):
        assert build(algorithm, Workers([Plain, Plain])).learn(16).num_timesteps == 16


# -- pictures --------------------------------------------------------------------------------------


def drawn(mode: str = "rgb_array") -> Any:
    env = gym.make(ENV_ID, render_mode=mode, n_threads=1)
    env.reset(seed=0)
    try:
        env.render()
    except RenderingUnavailableError as error:
        pytest.skip(str(error))
    return env


def test_a_film_has_every_episode_and_the_beginning(tmp_path: Path) -> None:
    pytest.importorskip("moviepy")
    env = RecordVideo(drawn(), str(tmp_path / "films"), episode_trigger=lambda _: True)
    for seed in range(2):
        env.reset(seed=seed)
        env.step(env.unwrapped.initial_trajectory())  # pyright: ignore
        assert len(env.recorded_frames) == 2
    env.close()
    names = sorted(path.name for path in (tmp_path / "films").glob("*.mp4"))
    assert names == ["rl-video-episode-0.mp4", "rl-video-episode-1.mp4"]


def test_sb3s_recorder_takes_the_first_picture_before_any_step(tmp_path: Path) -> None:
    pytest.importorskip("moviepy")
    drawn()
    env = VecVideoRecorder(
        DummyVecEnv([lambda: drawn()]), str(tmp_path), lambda step: step == 0, video_length=1
    )
    env.reset()
    for _ in range(2):
        env.step(np.stack(env.env_method("initial_trajectory")))
    env.close()
    assert list(tmp_path.glob("*.mp4"))


def test_without_a_context_nothing_can_be_drawn() -> None:
    with pytest.raises(TaskError, match=r"no context yet: call reset\(\)"):
        TrajectoryEnv(ENV_ID, render_mode="rgb_array").render()


@pytest.mark.parametrize("mode", ["rgb_array", "rgb_array_list"])
@pytest.mark.parametrize("task_id", ["nmp/ViaPoints-v0", "nmp/Obstacles-v0"])
def test_a_task_without_pictures_refuses_a_render_mode_at_once(task_id: str, mode: str) -> None:
    assert gym.make(task_id).metadata["render_modes"] == []
    with pytest.raises(RenderingUnavailableError, match=f"render_mode is '{mode}', and .* leave"):
        gym.make(task_id, render_mode=mode)
    assert make_vec_env(task_id).render_mode is None, "SB3 asks for rgb_array by itself"
    assert "rgb_array" in gym.make(ENV_ID, render_mode=mode).metadata["render_modes"]
