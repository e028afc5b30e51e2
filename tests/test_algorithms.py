"""The SB3 contract, for every algorithm: learn, predict, save, load, resume, callbacks, logs.

What `sb3_nmp.check_algorithm` asks of any algorithm stands in tests/test_check_algorithm.py.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from stable_baselines3.common.callbacks import (
    BaseCallback,
    CheckpointCallback,
    EvalCallback,
    StopTrainingOnMaxEpisodes,
)
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from benchmark_envs import TrajectoryVecEnv
from sb3_nmp import ConfigurationError, TrajectoryAlgorithm
from sb3_nmp.common.rollouts import Generation
from tests.registry import ALGORITHMS, ENV_ID, POPULATION

EVERY = pytest.mark.parametrize("algorithm", ALGORITHMS, ids=lambda a: a.__name__)
Algorithm = type[TrajectoryAlgorithm]


def build(algorithm: Algorithm, env: Any = ENV_ID, seed: int | None = 0, **more: Any) -> Any:
    make: Callable[..., Any] = algorithm
    return make("MlpPolicy", env, seed=seed, **{**ALGORITHMS[algorithm], **more})


def vec_env(n_envs: int, **kwargs: Any) -> VecEnv:
    return make_vec_env(ENV_ID, n_envs=n_envs, vec_env_cls=TrajectoryVecEnv, env_kwargs=kwargs)


class Recorder(BaseCallback):
    """Keeps every trajectory and reward, and stops after some steps."""

    def __init__(self, stop_after: int | None = None) -> None:
        super().__init__()
        self.trajectories: list[np.ndarray] = []
        self.rewards: list[float] = []
        self.stop_after = stop_after

    def _on_step(self) -> bool:
        self.trajectories.extend(self.locals["actions"])
        self.rewards.extend(self.locals["rewards"])
        assert self.locals["new_obs"].shape[0] == len(self.locals["dones"])
        return self.stop_after is None or self.n_calls < self.stop_after


def run(model: TrajectoryAlgorithm, budget: int, **kwargs: Any) -> Recorder:
    recorder = Recorder()
    model.learn(budget, callback=recorder, **kwargs)
    return recorder


def assert_same_rollouts(one: Recorder, two: Recorder) -> None:
    np.testing.assert_array_equal(one.trajectories, two.trajectories)
    np.testing.assert_array_equal(one.rewards, two.rewards)


@EVERY
def test_predict_answers_contexts_with_trajectories_inside_the_space(algorithm: Algorithm) -> None:
    model = build(algorithm)
    model.learn(2 * POPULATION)
    context = model.get_env().reset()[0]
    for deterministic in (True, False):
        one, state = model.predict(context, deterministic=deterministic)
        many, _ = model.predict(np.stack([context] * 3), deterministic=deterministic)
        assert state is None
        assert one.shape == model.action_space.shape
        assert many.shape == (3, *model.action_space.shape)
        assert model.action_space.contains(one)
    greedy = [model.predict(context, deterministic=True)[0] for _ in range(2)]
    np.testing.assert_array_equal(*greedy)
    with pytest.raises(ValueError, match="tuple"):
        model.predict((context, {}))


@EVERY
def test_contexts_of_either_precision_are_answered_alike(algorithm: Algorithm) -> None:
    model = build(algorithm).learn(2 * POPULATION)
    space = model.observation_space
    unseen = space.low + np.linspace(0.3, 0.6, 3)[:, None] * (space.high - space.low)
    assert unseen.dtype == np.float64
    answers = [model.predict(each, deterministic=True)[0] for each in (unseen, np.float32(unseen))]
    np.testing.assert_array_equal(*answers)


@EVERY
def test_one_environment_and_a_batch_of_them_give_the_same_bits(algorithm: Algorithm) -> None:
    single = run(build(algorithm, vec_env(1)), 4 * POPULATION)
    for n_envs in (2, POPULATION):
        assert_same_rollouts(single, run(build(algorithm, vec_env(n_envs)), 4 * POPULATION))


@EVERY
@pytest.mark.parametrize("cut", [2 * POPULATION, 2 * POPULATION + 3])
def test_an_interrupted_and_resumed_run_equals_an_uninterrupted_one(
    algorithm: Algorithm, cut: int, tmp_path: Path
) -> None:
    """Also where the interruption falls into the middle of a generation."""
    whole = run(build(algorithm), 4 * POPULATION)

    first = build(algorithm)
    begun = run(first, cut)
    first.save(tmp_path / "model.zip")
    if hasattr(first, "save_replay_buffer"):
        first.save_replay_buffer(tmp_path / "buffer.npz")
    np.random.default_rng().random()
    th.manual_seed(12345)  # the global generators must not matter

    shown = {k: v for k, v in ALGORITHMS[algorithm].items() if k == "demonstrations"}
    loaded = algorithm.load(tmp_path / "model.zip", env=gym.make(ENV_ID), **shown)
    if hasattr(loaded, "load_replay_buffer"):
        loaded.load_replay_buffer(tmp_path / "buffer.npz")  # pyright: ignore
    resumed = run(loaded, 4 * POPULATION - cut, reset_num_timesteps=False)
    assert loaded.num_timesteps == 4 * POPULATION
    np.testing.assert_array_equal([*begun.trajectories, *resumed.trajectories], whole.trajectories)


@EVERY
def test_a_loaded_model_predicts_the_same(algorithm: Algorithm, tmp_path: Path) -> None:
    model = build(algorithm)
    model.learn(2 * POPULATION)
    context = model.get_env().reset()
    model.save(tmp_path / "model")
    loaded = algorithm.load(tmp_path / "model")
    np.testing.assert_array_equal(
        model.predict(context, deterministic=True)[0],
        loaded.predict(context, deterministic=True)[0],
    )
    model.policy.save(tmp_path / "policy")
    policy = type(model.policy).load(tmp_path / "policy")
    np.testing.assert_array_equal(
        model.predict(context, deterministic=True)[0],
        policy.predict(context, deterministic=True)[0],
    )
    for key, value in model.policy.state_dict().items():
        assert th.equal(loaded.policy.state_dict()[key], value), key


@EVERY
def test_the_saved_model_is_small(algorithm: Algorithm, tmp_path: Path) -> None:
    """Demonstrations and rollouts are saved apart."""
    model = build(algorithm)
    model.learn(4 * POPULATION)
    model.save(tmp_path / "model.zip")
    assert (tmp_path / "model.zip").stat().st_size < 600_000


@EVERY
def test_the_budget_is_never_overshot(algorithm: Algorithm) -> None:
    for n_envs, budget, spent in ((1, POPULATION + 3, POPULATION + 3), (4, 11, 8)):
        model = build(algorithm, vec_env(n_envs))
        assert len(run(model, budget).rewards) == model.num_timesteps == spent


@EVERY
def test_a_callback_can_stop_the_run_and_nothing_is_lost(algorithm: Algorithm) -> None:
    model = build(algorithm)
    recorder = Recorder(stop_after=3)
    model.learn(5 * POPULATION, callback=recorder)
    assert model.num_timesteps == 3
    rest = run(model, 2 * POPULATION - 3, reset_num_timesteps=False)
    whole = run(build(algorithm), 2 * POPULATION)
    np.testing.assert_array_equal([*recorder.trajectories, *rest.trajectories], whole.trajectories)


@EVERY
def test_sb3_callbacks_work(algorithm: Algorithm, tmp_path: Path) -> None:
    model = build(algorithm, vec_env(1))
    model.learn(
        3 * POPULATION,
        callback=[
            CheckpointCallback(POPULATION, str(tmp_path / "checkpoints"), save_replay_buffer=True),
            EvalCallback(vec_env(1), eval_freq=POPULATION, n_eval_episodes=1, verbose=0),
        ],
    )
    saved = list((tmp_path / "checkpoints").glob("rl_model_*_steps.zip"))
    assert len(saved) == 3
    assert algorithm.load(saved[0]).num_timesteps % POPULATION == 0
    model = build(algorithm)
    model.learn(3 * POPULATION, callback=StopTrainingOnMaxEpisodes(5))
    assert model.num_timesteps == 5


@EVERY
def test_the_log_holds_sb3_keys_and_success_rate(algorithm: Algorithm, tmp_path: Path) -> None:
    model = build(algorithm)
    model.set_logger(configure(str(tmp_path), ["csv"]))
    model.learn(3 * POPULATION)
    model.logger.close()
    header = (tmp_path / "progress.csv").read_text().splitlines()[0].split(",")
    expected = {
        "rollout/ep_rew_mean",
        "rollout/ep_len_mean",
        "rollout/success_rate",
        "time/fps",
        "time/iterations",
        "time/time_elapsed",
        "time/total_timesteps",
        "train/n_updates",
    }
    assert expected <= set(header)
    assert len((tmp_path / "progress.csv").read_text().splitlines()) == 1 + 3


@EVERY
@pytest.mark.filterwarnings("ignore:rich is experimental")
def test_tensorboard_and_progress_bar(algorithm: Algorithm, tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    model = build(algorithm, tensorboard_log=str(tmp_path))
    model.learn(POPULATION, progress_bar=True)
    folders = [path.name for path in tmp_path.iterdir()]
    assert folders == [f"{algorithm.__name__}_1"]
    assert list((tmp_path / folders[0]).glob("events.out.tfevents*"))


@EVERY
def test_sb3_wrappers_and_evaluation_work(algorithm: Algorithm) -> None:
    env = VecNormalize(vec_env(4), norm_obs=False, norm_reward=False)
    model = build(algorithm, env)
    model.learn(2 * POPULATION)
    rewards, lengths = evaluate_policy(
        model, vec_env(2), n_eval_episodes=2, return_episode_rewards=True
    )
    assert lengths == [1, 1]
    assert rewards[0] == rewards[1]  # pyright: ignore[reportIndexIssue]


@EVERY
def test_an_environment_can_be_exchanged(algorithm: Algorithm) -> None:
    model = build(algorithm)
    model.learn(POPULATION)
    model.set_env(vec_env(1))
    model.learn(POPULATION)
    assert model.num_timesteps == POPULATION


@EVERY
def test_a_population_that_does_not_fit_is_refused(algorithm: Algorithm) -> None:
    with pytest.raises(ConfigurationError, match=r"population of 8 does not fit 5 .*multiple of 5"):
        build(algorithm, vec_env(5))
    with pytest.raises(ConfigurationError, match="total_timesteps is 3"):
        build(algorithm, vec_env(4)).learn(3)


@EVERY
def test_environments_of_another_kind_are_refused(algorithm: Algorithm) -> None:
    with pytest.raises(ConfigurationError, match=r"no environment 'nmp/Botles-v0'.*nmp/Bottles-v0"):
        build(algorithm, "nmp/Botles-v0")
    with pytest.raises(ConfigurationError, match="has no policy 'CnnPolicy'; it has MlpPolicy"):
        algorithm("CnnPolicy", ENV_ID)  # pyright: ignore[reportCallIssue]
    with pytest.raises(ConfigurationError, match=r"needs \(T, D\)"):
        build(algorithm, "Pendulum-v1")

    class Endless(gym.Wrapper):
        def step(self, action: Any) -> Any:
            observation, reward, _, truncated, info = self.env.step(action)
            return observation, reward, False, truncated, info

    with pytest.raises(ConfigurationError, match="went on after its first step"):
        build(algorithm, Endless(gym.make(ENV_ID))).learn(POPULATION)


@EVERY
def test_contexts_may_vary(algorithm: Algorithm) -> None:
    model = build(algorithm, vec_env(4, random_bottles=True))
    model.learn(3 * POPULATION)
    contexts = np.stack([model.get_env().reset()[0] for _ in range(3)])
    assert len(np.unique(contexts, axis=0)) == 3
    assert model.predict(contexts, deterministic=True)[0].shape == (3, *model.action_space.shape)


@EVERY
def test_a_generation_is_complete_and_in_order(
    algorithm: Algorithm, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = build(algorithm, vec_env(2))
    seen: list[Generation] = []
    learn_from = model._end_generation
    monkeypatch.setattr(model, "_end_generation", lambda g: seen.append(g) or learn_from(g))
    recorder = run(model, 2 * POPULATION)
    assert [len(g.rewards) for g in seen] == [POPULATION, POPULATION]
    sent = np.concatenate([g.trajectories for g in seen])
    np.testing.assert_array_equal(sent, recorder.trajectories)
