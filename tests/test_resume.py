"""Interrupted, loaded and resumed runs equal uninterrupted ones, also where contexts are drawn."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from stable_baselines3.common.callbacks import CheckpointCallback
from stable_baselines3.common.vec_env import DummyVecEnv

from baselines import BO, GA, REPS
from benchmark_envs import make_task
from results.cli import main
from sb3_nmp import (
    ACNMP,
    RCNMP,
    ConfigurationError,
    Demonstrations,
    FileFormatError,
    ResumeWarning,
    UnknownArgumentError,
)
from sb3_nmp.common import stream
from tests.registry import ALGORITHMS, DEMONSTRATIONS, ENV_ID, POPULATION
from tests.test_algorithms import EVERY, Algorithm, Recorder, build, run, vec_env

BUDGET = 4 * POPULATION


def drawing(n_envs: int) -> Any:
    """Environments that draw their contexts."""
    return vec_env(n_envs, random_bottles=True, n_threads=1)


def checkpoint(folder: Path, steps: int) -> tuple[Path, Path]:
    return (
        folder / f"rl_model_{steps}_steps.zip",
        folder / f"rl_model_replay_buffer_{steps}_steps.pkl",
    )


def load(algorithm: Algorithm, files: tuple[Path, Path], env: Any, **changes: Any) -> Any:
    """Load as a client does that knows no algorithm of ours."""
    model: Any = algorithm.load(files[0], env=env, **changes)
    if hasattr(model, "load_replay_buffer"):
        model.load_replay_buffer(files[1], truncate_last_traj=True)
    return model


@EVERY
def test_a_run_in_a_stream_of_contexts_resumes_exactly_from_checkpoints(
    algorithm: Algorithm, tmp_path: Path
) -> None:
    """Also in the middle of a generation, and from a model that was loaded and saved again."""
    whole = Recorder()
    checkpoints = CheckpointCallback(5, str(tmp_path), save_replay_buffer=True)
    build(algorithm, drawing(2)).learn(BUDGET, callback=[whole, checkpoints])
    for steps in (10, 20):
        model = load(algorithm, checkpoint(tmp_path, steps), drawing(2))
        model.save(tmp_path / "again")
        model = load(algorithm, (tmp_path / "again", checkpoint(tmp_path, steps)[1]), drawing(2))
        rest = run(model, BUDGET - steps, reset_num_timesteps=False)
        np.testing.assert_array_equal(rest.trajectories, whole.trajectories[steps:])
        np.testing.assert_array_equal(rest.rewards, whole.rewards[steps:])
        assert model.num_timesteps == BUDGET


KILLED = """
import os, signal, sys
from stable_baselines3.common.callbacks import BaseCallback, CallbackList, CheckpointCallback
from tests.registry import ALGORITHMS
from tests.test_algorithms import build
from tests.test_resume import drawing

kind = next(each for each in ALGORITHMS if each.__name__ == sys.argv[2])

class Killer(BaseCallback):
    def _on_step(self):
        if self.num_timesteps == 21:
            os.kill(os.getpid(), signal.SIGKILL)
        return True

checkpoints = CheckpointCallback(10, sys.argv[1], save_replay_buffer=True)
build(kind, drawing(1)).learn(100, callback=CallbackList([checkpoints, Killer()]))
"""


RESUMED = """
import sys
from pathlib import Path
from tests.registry import ALGORITHMS
from tests.test_resume import BUDGET, checkpoint, drawing, load

folder, kind = Path(sys.argv[1]), next(a for a in ALGORITHMS if a.__name__ == sys.argv[2])
model = load(kind, checkpoint(folder, 20), drawing(1))
model.learn(BUDGET - 20, reset_num_timesteps=False).save(folder / "resumed")
"""


def in_another_process(program: str, *arguments: str) -> int:
    """Run a program that imports from these tests, and return its exit status."""
    path = os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])
    environment = {**os.environ, "PYTHONPATH": path}
    return subprocess.run([sys.executable, "-c", program, *arguments], env=environment).returncode


@pytest.mark.parametrize(("kind", "algorithm"), [("acnmp", ACNMP), ("rcnmp", RCNMP), ("ga", GA)])
def test_a_run_that_was_killed_is_resumed_elsewhere_exported_and_replayed(
    kind: str, algorithm: Algorithm, tmp_path: Path
) -> None:
    """The trajectory in the file is that of a run that nobody killed, and earns what it earns."""
    name = algorithm.__name__
    assert in_another_process(KILLED, str(tmp_path), name) == -signal.SIGKILL
    assert not checkpoint(tmp_path, 30)[0].exists()
    assert in_another_process(RESUMED, str(tmp_path), name) == 0
    context, out = drawing(1).reset()[0], tmp_path / "skill.csv"
    source = [ENV_ID, "--model", str(tmp_path / "resumed.zip"), "--algorithm", kind]
    asked = ["--context", *map(str, context), "--out", str(out)]
    assert main(["export", *source, *asked]) == 0
    model = build(algorithm, drawing(1))
    whole = run(model, BUDGET)
    again = load(algorithm, checkpoint(tmp_path, 20), drawing(1))
    rest = run(again, BUDGET - 20, reset_num_timesteps=False)
    np.testing.assert_array_equal(rest.trajectories, whole.trajectories[20:])
    own, _ = model.predict(context, deterministic=True)
    read = Demonstrations.from_csv(out)
    np.testing.assert_array_equal(read.trajectories[0], own)
    replayed, expected = (
        make_task(ENV_ID).simulate(read.contexts, trajectories[None]).rewards
        for trajectories in (read.trajectories[0], own)
    )
    np.testing.assert_array_equal(replayed, expected)


def test_a_second_call_of_learn_resumes_alike_whether_or_not_it_counts_anew(tmp_path: Path) -> None:
    model = build(REPS, drawing(1)).learn(POPULATION)
    model.save(tmp_path / "model")
    loaded = REPS.load(tmp_path / "model", env=drawing(1))
    one, two = run(model, POPULATION), run(loaded, POPULATION)
    np.testing.assert_array_equal(one.trajectories, two.trajectories)
    assert loaded.num_timesteps == POPULATION


def test_an_environment_given_after_loading_goes_on_too(tmp_path: Path) -> None:
    whole = run(build(REPS, drawing(1)), 2 * POPULATION)
    build(REPS, drawing(1)).learn(POPULATION + 3).save(tmp_path / "model")
    loaded = REPS.load(tmp_path / "model")
    loaded.set_env(drawing(1))
    rest = run(loaded, POPULATION - 3, reset_num_timesteps=False)
    np.testing.assert_array_equal(rest.trajectories, whole.trajectories[POPULATION + 3 :])


@pytest.mark.parametrize("n_envs", [2, 4])
def test_no_context_is_drawn_again_with_another_number_of_environments(
    n_envs: int, tmp_path: Path
) -> None:
    seen: list[np.ndarray] = []

    class Contexts(Recorder):
        def _on_step(self) -> bool:
            seen.extend(self.locals["contexts"])
            return True

    model = build(REPS, drawing(1))
    model.learn(POPULATION, callback=Contexts())
    model.save(tmp_path / "model")
    loaded = REPS.load(tmp_path / "model", env=drawing(n_envs))
    loaded.learn(POPULATION, callback=Contexts(), reset_num_timesteps=False)
    assert len(np.unique(np.round(seen, 6), axis=0)) == len(seen) == 2 * POPULATION


def test_generators_of_any_kind_go_on_where_they_were() -> None:
    class Drawn(gym.Env[Any, Any]):
        observation_space = spaces.Box(0.0, 1.0, (1,))
        action_space = spaces.Box(0.0, 1.0, (2, 1))

        def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
            super().reset(seed=seed)
            return self.np_random.random(1, np.float32), {}

    env = DummyVecEnv([Drawn])
    for bits in (np.random.MT19937(1), np.random.Philox(1), np.random.PCG64(1)):
        env.set_attr("np_random", np.random.Generator(bits))
        before = stream.generator_states(env)
        waiting = np.array(env.reset())
        saved: stream.Stream = {"before": before, "now": stream.generator_states(env)}
        follow = [np.array(env.reset()) for _ in range(3)]
        env.seed(0)
        np.testing.assert_array_equal(stream.resume(env, saved), waiting)
        np.testing.assert_array_equal([np.array(env.reset()) for _ in range(3)], follow)


def test_a_file_cannot_name_other_functions_as_generators() -> None:
    saved: stream.Stream = {"before": None, "now": [{"bit_generator": "test", "state": {}}]}
    with pytest.raises(FileFormatError, match="names 'test' as its environments' generator"):
        stream.resume(vec_env(1), saved)


# -- what is told instead of going on silently -----------------------------------------------------


@EVERY
def test_a_generation_that_does_not_fit_the_environments_begins_anew(
    algorithm: Algorithm, tmp_path: Path
) -> None:
    model = build(algorithm, vec_env(1)).learn(POPULATION + 3)
    model.save(tmp_path / "model")
    buffer = tmp_path / "buffer"
    if hasattr(model, "save_replay_buffer"):
        model.save_replay_buffer(buffer)
    loaded = load(algorithm, (tmp_path / "model", buffer), vec_env(4))
    with pytest.warns(ResumeWarning, match="3 of 8 rollouts .* among 4 environments"):
        loaded.learn(POPULATION, reset_num_timesteps=False)
    assert loaded.num_timesteps == 2 * POPULATION + 3


@pytest.mark.parametrize("algorithm", [RCNMP, GA, ACNMP], ids=lambda a: a.__name__)
def test_a_replay_buffer_that_was_not_loaded_is_missed(
    algorithm: Algorithm, tmp_path: Path
) -> None:
    model = build(algorithm, vec_env(1)).learn(POPULATION)
    if len(model.replay_buffer) == 0:
        first = DEMONSTRATIONS[:1]
        model.replay_buffer.add(first.contexts, first.trajectories, np.zeros(1))
    n = len(model.replay_buffer)
    model.save(tmp_path / "model")
    loaded = algorithm.load(tmp_path / "model", env=vec_env(1))
    with pytest.warns(ResumeWarning, match=f"had {n} rollouts .* load_replay_buffer"):
        loaded.learn(1, reset_num_timesteps=False)
    loaded.learn(1, reset_num_timesteps=False)  # told once


@pytest.mark.parametrize("algorithm", [ACNMP, BO], ids=lambda a: a.__name__)
def test_demonstrations_that_are_learned_again_come_back_with_the_model(
    algorithm: Algorithm, tmp_path: Path
) -> None:
    build(algorithm).save(tmp_path / "model")
    loaded: Any = algorithm.load(tmp_path / "model", env=vec_env(1))
    loaded.learn(POPULATION)
    assert loaded.demonstrations == DEMONSTRATIONS
    build(algorithm).policy.save(tmp_path / "policy")
    policy: Any = type(loaded.policy).load(tmp_path / "policy")
    assert policy.shown.demonstrations() == DEMONSTRATIONS


# -- populations and environments ------------------------------------------------------------------


@EVERY
@pytest.mark.parametrize("n_envs", [4, 7])
def test_default_populations_fit_any_number_of_environments(
    algorithm: Algorithm, n_envs: int
) -> None:
    small = {k: v for k, v in ALGORITHMS[algorithm].items() if k != "population_size"}
    make: Any = algorithm
    model = make("MlpPolicy", vec_env(n_envs, n_threads=1), seed=0, **small)
    before = make("MlpPolicy", ENV_ID, seed=0, **small).population_size
    assert before <= model.population_size < before + n_envs
    assert model.population_size % n_envs == 0
    assert model.learn(n_envs).num_timesteps == n_envs


def test_what_loading_can_change_and_what_it_cannot(tmp_path: Path) -> None:
    build(REPS, n_bases=6).learn(POPULATION).save(tmp_path / "reps")
    build(RCNMP).save(tmp_path / "rcnmp")
    loaded = REPS.load(tmp_path / "reps", env=vec_env(1), population_size=4, n_bases=6)
    loaded.learn(4, reset_num_timesteps=False)
    assert loaded.population_size == 4 and loaded._n_updates == 2
    assert RCNMP.load(tmp_path / "rcnmp", stats_window_size=7)._stats_window_size == 7
    with pytest.raises(UnknownArgumentError, match="REPS has no argument 'n_sampled'"):
        REPS.load(tmp_path / "reps", n_sampled=8)
    with pytest.raises(ConfigurationError, match="population_size is '8'; it must be a whole"):
        REPS.load(tmp_path / "reps", population_size="8")
    with pytest.raises(ConfigurationError, match="n_bases is 9, but the model was made with 6"):
        REPS.load(tmp_path / "reps", n_bases=9)
    with pytest.raises(ConfigurationError, match="n_modes is 2, but the model was made with 1"):
        RCNMP.load(tmp_path / "rcnmp", n_modes=2)
    with pytest.raises(ConfigurationError, match="population of 6 does not fit 4"):
        REPS.load(tmp_path / "reps", env=vec_env(4), population_size=6)
