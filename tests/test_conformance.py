"""What SB3's own tests check of its algorithms, asked of all of ours.

`tests/test_algorithms.py` has the contract of the loop; this file goes through SB3's test_predict,
test_save_load, test_callbacks, test_logger, test_monitor, test_vec_normalize, test_vec_check_nan,
test_train_eval_mode and test_utils.
"""

import io
import json
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch as th
from stable_baselines3.common.callbacks import (
    BaseCallback,
    CallbackList,
    CheckpointCallback,
    EvalCallback,
    EveryNTimesteps,
    LogEveryNTimesteps,
    StopTrainingOnNoModelImprovement,
    StopTrainingOnRewardThreshold,
)
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import configure
from stable_baselines3.common.monitor import Monitor, load_results
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecCheckNan,
    VecMonitor,
    VecNormalize,
    sync_envs_normalization,
)

from tests.registry import ALGORITHMS, ENV_ID, POPULATION
from tests.test_algorithms import EVERY, Algorithm, assert_same_rollouts, build, run, vec_env

BUDGET = POPULATION + 3


@cache
def trained(algorithm: Algorithm) -> Any:
    """A model that has learned a little, for tests that leave it as it is."""
    return build(algorithm, vec_env(1, n_threads=1)).learn(2 * POPULATION)


@lru_cache(maxsize=1)
def contexts() -> Any:
    space = gym.make(ENV_ID).observation_space
    space.seed(0)
    return np.stack([space.sample() for _ in range(3)])


# -- predict ---------------------------------------------------------------------------------------


@EVERY
def test_predict_keeps_the_shapes_of_gymnasium_and_of_vectorised_environments(
    algorithm: Algorithm,
) -> None:
    """SB3's test_predict: from either kind of environment, and both in turn."""
    model = trained(algorithm)
    single, many = gym.make(ENV_ID, n_threads=1), vec_env(2, n_threads=1)
    observation, _ = single.reset()
    action, state = model.predict(observation, deterministic=True)
    assert state is None and isinstance(action, np.ndarray) and action.dtype == np.float32
    assert single.action_space.contains(action)
    batch, _ = model.predict(many.reset(), deterministic=False)
    assert batch.shape == (2, *model.action_space.shape)
    many.step(batch)
    np.testing.assert_array_equal(model.predict(observation, deterministic=True)[0], action)
    assert model.predict(contexts()[:1])[0].shape == (1, *model.action_space.shape)


@EVERY
@pytest.mark.parametrize("device", ["cpu", "auto", th.device("cpu")])
def test_devices_are_given_as_in_sb3(algorithm: Algorithm, device: Any, tmp_path: Path) -> None:
    model = build(algorithm, device=device)
    assert model.device.type in ("cpu", "cuda")
    assert model.policy.device.type == model.device.type
    assert all(p.device.type == model.device.type for p in model.policy.state_dict().values())


@EVERY
def test_the_policy_is_in_evaluation_mode_outside_of_training(algorithm: Algorithm) -> None:
    policy = trained(algorithm).policy
    assert not policy.training
    before = {name: value.clone() for name, value in policy.state_dict().items()}
    policy.predict(contexts())
    assert all(th.equal(value, before[name]) for name, value in policy.state_dict().items())


@EVERY
def test_evaluate_policy_agrees_with_the_environment(algorithm: Algorithm) -> None:
    model, env = trained(algorithm), Monitor(gym.make(ENV_ID, n_threads=1))
    seen: list[float] = []
    mean, spread = evaluate_policy(
        model, env, n_eval_episodes=2, callback=lambda now, _: seen.append(now["reward"])
    )
    context, _ = env.reset()
    _, reward, *_ = env.step(model.predict(context, deterministic=True)[0])
    assert mean == pytest.approx(reward, abs=1e-5) and spread == 0.0  # Monitor rounds
    assert seen == pytest.approx([reward, reward], abs=1e-5)


# -- save and load ---------------------------------------------------------------------------------


@EVERY
def test_parameters_are_got_set_and_refused_where_they_do_not_match(algorithm: Algorithm) -> None:
    model, other = trained(algorithm), build(algorithm, seed=5)
    parameters = model.get_parameters()
    assert "policy" in parameters
    other.set_parameters(parameters, exact_match=True)
    asked = contexts()
    np.testing.assert_array_equal(
        other.predict(asked, deterministic=True)[0], model.predict(asked, deterministic=True)[0]
    )
    with pytest.raises(ValueError, match=r"missing|Names of parameters"):
        other.set_parameters({}, exact_match=True)
    with pytest.raises(ValueError, match="invalid"):
        other.set_parameters({"no such object": {}}, exact_match=False)


@EVERY
def test_a_model_is_saved_to_open_files_folders_to_be_made_and_paths(
    algorithm: Algorithm, tmp_path: Path
) -> None:
    model, asked = trained(algorithm), contexts()
    expected = model.predict(asked, deterministic=True)[0]
    held = io.BytesIO()
    model.save(held)
    held.seek(0)
    for path in (tmp_path / "new" / "folder" / "model", str(tmp_path / "model.zip")):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("warnings.warn", lambda *_, **__: None)  # SB3 tells of new folders
            model.save(path)
        loaded = algorithm.load(path)
        np.testing.assert_array_equal(loaded.predict(asked, deterministic=True)[0], expected)
    loaded = algorithm.load(held)
    np.testing.assert_array_equal(loaded.predict(asked, deterministic=True)[0], expected)


@EVERY
def test_replay_buffers_are_kept_in_open_files_and_new_folders(
    algorithm: Algorithm, tmp_path: Path
) -> None:
    model = trained(algorithm)
    if not hasattr(model, "save_replay_buffer"):
        pytest.skip(f"{algorithm.__name__} has none")
    other, held = build(algorithm), io.BytesIO()
    model.save_replay_buffer(held)
    held.seek(0)
    other.load_replay_buffer(held)
    np.testing.assert_array_equal(other.replay_buffer.rewards, model.replay_buffer.rewards)
    model.save_replay_buffer(tmp_path / "new" / "buffer")
    other.load_replay_buffer(tmp_path / "new" / "buffer")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["buffer"]


@EVERY
def test_attributes_are_left_out_and_taken_in_when_a_model_is_saved(
    algorithm: Algorithm, tmp_path: Path
) -> None:
    model = build(algorithm)
    model.extra = 3
    model.save(tmp_path / "without", exclude=["extra"])
    assert not hasattr(algorithm.load(tmp_path / "without"), "extra")
    model.save(tmp_path / "with")
    assert algorithm.load(tmp_path / "with").extra == 3  # pyright: ignore
    assert algorithm.load(tmp_path / "with", custom_objects={"extra": 4}).extra == 4  # pyright: ignore


@EVERY
def test_a_seed_repeats_environments_as_well(algorithm: Algorithm) -> None:
    first, second = (
        run(build(algorithm, vec_env(2, random_bottles=True, n_threads=1), seed=2), POPULATION)
        for _ in range(2)
    )
    assert_same_rollouts(first, second)


@EVERY
def test_a_loaded_model_follows_the_seed_that_it_is_given(
    algorithm: Algorithm, tmp_path: Path
) -> None:
    """Another seed is another search; without one it goes on, whether or not its file has one."""
    build(algorithm, seed=0).save(tmp_path / "model")
    build(algorithm, seed=0).save(tmp_path / "seedless", exclude=["seed"])

    load: Any = algorithm.load

    def searched(name: str, **seed: int) -> list[np.ndarray]:
        model = load(tmp_path / name, env=vec_env(1, n_threads=1), **seed)
        return run(model, 2 * POPULATION).trajectories

    kept, other = searched("model"), searched("model", seed=3)
    np.testing.assert_array_equal(kept, searched("seedless"))
    np.testing.assert_array_equal(other, searched("seedless", seed=3))
    assert not np.array_equal(kept, other)


# -- callbacks -------------------------------------------------------------------------------------


class Events(BaseCallback):
    """Notes which of its methods are called, in order."""

    def __init__(self) -> None:
        super().__init__()
        self.called: list[str] = []

    def _on_training_start(self) -> None:
        self.called.append("start")

    def _on_rollout_start(self) -> None:
        self.called.append("(")

    def _on_step(self) -> bool:
        self.called.append(".")
        return True

    def _on_rollout_end(self) -> None:
        self.called.append(")")

    def _on_training_end(self) -> None:
        self.called.append("end")


@EVERY
def test_callbacks_are_called_in_sb3s_order(algorithm: Algorithm) -> None:
    events, counted, called = Events(), Events(), list[int]()
    model = build(algorithm)
    model.learn(
        2 * POPULATION,
        callback=CallbackList([events, EveryNTimesteps(5, counted), LogEveryNTimesteps(4)]),
    )
    generation = "(" + POPULATION * "." + ")"
    assert "".join(events.called) == "start" + 2 * generation + "end"
    assert counted.called.count(".") == 2 * POPULATION // 5
    model.learn(3, callback=lambda now, _: called.append(now["self"].num_timesteps) or True)
    assert called == [1, 2, 3]


@EVERY
def test_evaluation_keeps_the_best_model_and_can_stop_the_run(
    algorithm: Algorithm, tmp_path: Path
) -> None:
    stop = StopTrainingOnRewardThreshold(-1e9)
    evaluation = EvalCallback(
        vec_env(1, n_threads=1), eval_freq=5, n_eval_episodes=1, verbose=0,
        callback_on_new_best=stop, best_model_save_path=str(tmp_path), log_path=str(tmp_path),
        callback_after_eval=StopTrainingOnNoModelImprovement(3),
    )  # fmt: skip
    model = build(algorithm, vec_env(1, n_threads=1)).learn(3 * POPULATION, callback=evaluation)
    assert model.num_timesteps == 5
    best = algorithm.load(tmp_path / "best_model")
    reward = evaluate_policy(best, vec_env(1, n_threads=1), n_eval_episodes=1)[0]
    assert reward == pytest.approx(evaluation.best_mean_reward, abs=1e-5)
    assert np.load(tmp_path / "evaluations.npz")["timesteps"].tolist() == [5]


@EVERY
def test_checkpoints_hold_model_buffer_and_statistics(algorithm: Algorithm, tmp_path: Path) -> None:
    env = VecNormalize(vec_env(1, n_threads=1), norm_obs=False)
    checkpoints = CheckpointCallback(
        POPULATION, str(tmp_path), "run", save_replay_buffer=True, save_vecnormalize=True
    )
    model = build(algorithm, env).learn(POPULATION, callback=checkpoints)
    names = {path.name for path in tmp_path.iterdir()}
    assert {f"run_{POPULATION}_steps.zip", f"run_vecnormalize_{POPULATION}_steps.pkl"} <= names
    has_buffer = hasattr(model, "save_replay_buffer")
    assert (f"run_replay_buffer_{POPULATION}_steps.pkl" in names) == has_buffer


# -- logs ------------------------------------------------------------------------------------------


@EVERY
def test_every_format_of_the_log_is_written(algorithm: Algorithm, tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    model = build(algorithm)
    model.set_logger(configure(str(tmp_path), ["log", "json", "csv", "tensorboard"]))
    model.learn(2 * POPULATION, log_interval=1)
    model.logger.close()
    rows = pd.read_csv(tmp_path / "progress.csv")
    assert rows["time/total_timesteps"].tolist() == [POPULATION, 2 * POPULATION]
    lines = [json.loads(line) for line in (tmp_path / "progress.json").read_text().splitlines()]
    assert lines[-1]["time/iterations"] == 2
    assert "success_rate" in (tmp_path / "log.txt").read_text()
    assert list(tmp_path.glob("events.out.tfevents*"))


@EVERY
def test_the_log_can_be_switched_off_and_printed(
    algorithm: Algorithm, capsys: pytest.CaptureFixture[str]
) -> None:
    build(algorithm, verbose=0).learn(POPULATION)
    assert capsys.readouterr().out == ""
    build(algorithm, vec_env(1, n_threads=1), verbose=1).learn(POPULATION)
    assert "ep_rew_mean" in capsys.readouterr().out


# -- wrappers --------------------------------------------------------------------------------------


@EVERY
def test_monitors_write_one_line_a_rollout(algorithm: Algorithm, tmp_path: Path) -> None:
    env = VecMonitor(
        DummyVecEnv([lambda: gym.make(ENV_ID, n_threads=1)]), str(tmp_path / "run"),
        info_keywords=("is_success",),
    )  # fmt: skip
    model = build(algorithm, VecCheckNan(env, raise_exception=True)).learn(BUDGET)
    env.close()
    written = load_results(str(tmp_path))
    assert len(written) == BUDGET and set(written["l"]) == {1}
    assert set(written["is_success"]) <= {True, False}
    kept = [info["r"] for info in model.ep_info_buffer]
    np.testing.assert_allclose(written["r"], kept, atol=1e-5)


@EVERY
def test_normalised_rewards_change_nothing_that_is_learned(algorithm: Algorithm) -> None:
    env = VecNormalize(vec_env(2, n_threads=1), norm_obs=False, norm_reward=True)
    model = build(algorithm, env)
    normalised = run(model, 2 * POPULATION)
    plain = run(build(algorithm, vec_env(2, n_threads=1)), 2 * POPULATION)
    np.testing.assert_array_equal(normalised.trajectories, plain.trajectories)
    assert model.get_vec_normalize_env() is env and env.ret_rms.count > 2 * POPULATION
    other = VecNormalize(vec_env(1, n_threads=1), norm_obs=False, training=False)
    sync_envs_normalization(model.get_env(), other)
    assert other.ret_rms.mean == env.ret_rms.mean


def test_all_algorithms_are_asked() -> None:
    assert len(ALGORITHMS) >= 9
