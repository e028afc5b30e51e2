"""What two users of one thing do to each other: threads, files of one name, rows and studies."""

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from stable_baselines3.common.env_util import make_vec_env

from benchmark_envs import TrajectoryEnv, TrajectoryVecEnv, make_task
from benchmark_envs.cache import ContextCache
from results.adaptation.summary import _numbers
from results.exceptions import BenchmarkError
from results.harness.progress import run_with_progress
from results.harness.provenance import provenance
from results.harness.record_files import read_records
from results.harness.records import RunRecord
from results.harness.resume import clear, finished_path, plan_runs
from results.harness.runner import execute, written
from results.harness.suite import make_suite
from results.leaderboard import verify
from results.leaderboard.boards import DATA
from results.outside import make_recipe
from results.suites.quick import RECIPE
from results.tuning.plan import Trial, TuningPlan
from results.tuning.study import StudySummary, study_path
from sb3_nmp import ConfigurationError, Demonstrations, FileFormatError
from sb3_nmp.zoo.entries import demonstrations
from tests.test_results_runner import do, run_of


def in_threads(work: Any, n: int = 2) -> None:
    errors: list[Exception] = []

    def guarded(number: int) -> None:
        try:
            work(number)
        except Exception as error:  # told below, in the test's own thread
            errors.append(error)

    threads = [threading.Thread(target=guarded, args=(number,)) for number in range(n)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []


def test_threads_share_a_task() -> None:
    task: Any = make_task("nmp/Push-v0", n_threads=1)
    rng = np.random.default_rng(0)
    context = task.sample_context(rng)
    begin = task.initial_trajectory(context)
    time = np.linspace(0, 6, len(begin))[:, None]
    tried = begin + 0.03 * rng.normal(size=(2, 1, begin.shape[1])) * np.sin(time)
    expected = [task.simulate(context, each).rewards for each in tried]
    wrong: list[int] = []

    def simulate(number: int) -> None:
        for _ in range(30):
            found = task.simulate(context, tried[number]).rewards
            if not np.array_equal(found, expected[number]):
                wrong.append(number)

    in_threads(simulate)
    assert wrong == []


def test_threads_share_a_cache_that_is_full() -> None:
    cache = ContextCache(lambda context: float(context.sum()), size=2)

    def ask(number: int) -> None:
        for value in range(3000):
            context = np.array([float((value + number) % 7)])
            assert cache[context] == context[0]

    in_threads(ask, 3)
    assert len(cache) == 2


def test_a_rollout_that_was_fetched_is_not_used_in_the_next_context() -> None:
    task: Any = make_task("nmp/Bottles-v0", n_threads=1, random_bottles=True)
    env = TrajectoryEnv(task)
    first, _ = env.reset(seed=0)
    trajectory = task.initial_trajectory(first)
    env.prefetch(task.simulate(first, task.demonstrate(first)))
    second, _ = env.reset()
    good = task.demonstrate(first)
    reward = env.step(good)[1]
    assert reward == pytest.approx(float(task.simulate(second, good).rewards[0]))
    assert trajectory.shape == good.shape


def test_pictures_are_of_the_rollout_that_is_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    task: Any = make_task("nmp/Bottles-v0", n_threads=1)
    context = task.sample_context(np.random.default_rng(0))
    seen: list[Any] = []
    monkeypatch.setattr(task, "_follow", lambda followed: seen.append(followed) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        task.frames(context, task.initial_trajectory(context) + 5.0)
    assert seen[0].max() <= task.trajectory_space.high.max()


def test_the_zoos_expert_shows_the_task_that_the_environments_have() -> None:
    made = {"random_bottles": True, "n_threads": 1}
    settings: Any = {"env_kwargs": made, "vec_env_cls": TrajectoryVecEnv}
    env = make_vec_env("nmp/Bottles-v0", n_envs=1, **settings)
    shown = demonstrations(3, env, 0)
    assert isinstance(shown, Demonstrations)
    task = gym.make("nmp/Bottles-v0", random_bottles=True)
    expected = Demonstrations.from_task(task, 3, seed=0)
    np.testing.assert_array_equal(shown.contexts, expected.contexts)
    assert len(np.unique(shown.contexts, axis=0)) == 3
    with pytest.raises(ConfigurationError, match="demonstrations is True"):
        demonstrations(True, env, 0)


def test_runs_of_one_file_are_refused() -> None:
    (label, algorithm), *_ = RECIPE.algorithms.items()
    twice = replace(RECIPE, algorithms={label: algorithm, f"{label}+": algorithm})
    with pytest.raises(BenchmarkError, match="would both be written to"):
        make_suite("twice", twice)
    signs = replace(RECIPE, variants={"+1": {}, "-1": {}})
    with pytest.raises(BenchmarkError, match="would both be written to"):
        make_suite("signs", signs)
    with pytest.raises(BenchmarkError, match="would both be written to"):
        make_suite("names", make_recipe("nmp/ViaPoints-v0", ["ga", "baselines:GA"], []))


def test_classes_of_one_name_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("mine_one", "mine_two"):
        program = "from baselines import GA\n\n\nclass Mine(GA):\n    pass\n"
        (tmp_path / f"{name}.py").write_text(program)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(BenchmarkError, match="would both be called 'Mine'"):
        make_recipe("nmp/ViaPoints-v0", ["mine_one:Mine", "mine_two:Mine"], [])


def test_a_run_whose_result_is_no_number_has_failed_and_the_others_go_on(tmp_path: Path) -> None:
    run = run_of(0)
    result = execute(run)
    rewards = [float("nan"), *result.measured.curve["greedy_reward"][1:]]
    curve = {**result.measured.curve, "greedy_reward": rewards}
    broken = replace(result, measured=replace(result.measured, curve=curve))
    outcome = written(run, tmp_path, RunRecord(run.record, provenance(), "finished", broken))
    assert not outcome.record.finished
    (kept,) = read_records(tmp_path).records
    assert kept.error is not None and "JSON" in kept.error.message
    assert run_with_progress(plan_runs(tmp_path, [run, run_of(1)]), 1) == 0


def test_a_run_that_another_process_has_finished_is_not_removed(tmp_path: Path) -> None:
    run = run_of(0)
    plan = plan_runs(tmp_path, [run])
    assert do(tmp_path, run) == 0  # meanwhile
    clear(plan)
    assert finished_path(tmp_path, run).exists()
    clear(plan_runs(tmp_path, [run], overwrite=True))
    assert not finished_path(tmp_path, run).exists()


PLAN = TuningPlan("rivals", "nmp/Bottles-v0", {}, 10, (1000,), 3)


def test_a_study_that_is_done_anew_takes_the_place_of_the_old_one(tmp_path: Path) -> None:
    old, new = (Trial({}, 5.0),), (Trial({}, 4.0),)
    StudySummary("GA", "ga", PLAN, {}, old).write(tmp_path)
    kept = StudySummary("GA", "ga", PLAN, {}, new).keep(tmp_path)
    assert kept.exists() and not study_path(tmp_path, "rivals", "GA").exists()


def test_runs_that_were_compared_with_a_published_count_are_counted() -> None:
    runs = pd.DataFrame(
        {
            "greedy_rollouts": [5.0, 7.0, 40.0],
            "best_rollouts": [5.0, 7.0, 40.0],
            "training_seconds": [1.0] * 3,
            "budget": [50] * 3,
            "seed": [0, 1, 2],
            "published": [np.nan, 18.0, 18.0],
            "own_error": [0.1] * 3,
            "own_solved": [True] * 3,
        }
    )
    assert _numbers(runs)["solved_within_published"] == 2
    assert "solved_within_published" not in _numbers(runs.assign(published=np.nan))


def test_a_row_in_the_place_of_another_is_told(tmp_path: Path) -> None:
    folder = tmp_path / "via-points"
    folder.mkdir()
    committed = DATA / "via-points"
    for ending in ("json", "npz"):
        for name in ("rc-nmp", "ga"):
            content = (committed / f"rc-nmp.{ending}").read_bytes()
            (folder / f"{name}.{ending}").write_bytes(content)
    moved = "belongs into another file than"
    assert any(moved in each for each in verify.verify_row(folder / "ga.json").problems)
    assert not any(moved in each for each in verify.verify_row(folder / "rc-nmp.json").problems)


@pytest.mark.parametrize("name", ["Demonstration", "episode", "traj_id", "frame", "frame_index"])
def test_a_column_that_numbers_rows_is_no_joint(name: str, tmp_path: Path) -> None:
    path = tmp_path / "shown.csv"
    path.write_text(f"{name},context,q\n1,0,0\n1,0,1\n2,1,5\n2,1,6\n")
    with pytest.raises(FileFormatError, match=f"column '{name}', which would be a dimension"):
        Demonstrations.from_csv(path)
