import gc
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from results.exceptions import BenchmarkError, SettingsClashError
from results.harness.counters import RolloutCounters
from results.harness.environments import RunTask
from results.harness.progress import run_with_progress
from results.harness.provenance import provenance
from results.harness.record_files import read_record, read_records
from results.harness.records import Result
from results.harness.resume import plan_runs
from results.harness.runner import execute, record_of, run_plan
from results.harness.specification import Algorithm, RunSpecification, plain
from results.one_context.protocol import OneContext
from results.report.frames import curves_frame
from tests.results_fakes import Remembered

TASK = "nmp/Bottles-v0"


def run_of(
    seed: int, name: str = "HillClimber", budget: int = 12, **settings: float
) -> RunSpecification:
    algorithm = Algorithm(name.lower(), f"tests.results_fakes:{name}", settings)
    return RunSpecification(name, algorithm, TASK, seed, budget, OneContext())


def do(folder: Path, *runs: RunSpecification, overwrite: bool = False, workers: int = 1) -> int:
    return run_with_progress(plan_runs(folder, runs, overwrite), workers)


@pytest.fixture(scope="module")
def result() -> Result:
    return execute(run_of(0))


def test_curve_has_a_row_a_rollout_and_its_best_never_falls(result: Result):
    curve = result.measured.curve
    assert curve["rollouts"] == list(range(1, 13))
    assert (np.diff(curve["best_reward"]) >= 0).all()
    assert (result.seconds.training or 0) > 0


def test_a_row_sees_the_update_of_its_generation(result: Result):
    """The hill climber's greedy reward is the best of the complete generations, updates and all."""
    curve = result.measured.curve
    complete = [5 * (count // 5) for count in curve["rollouts"]]
    expected = [curve["best_reward"][count - 1] for count in complete if count]
    assert curve["greedy_reward"][4:] == pytest.approx(expected)


def test_equal_seeds_give_equal_curves(result: Result):
    assert execute(run_of(0)).measured == result.measured
    assert execute(run_of(1)).measured.curve != result.measured.curve


def test_the_context_is_drawn_by_the_runs_seed():
    settings = {"random_bottles": True}
    runs = [RunTask(TASK, seed, 5, settings=settings) for seed in (0, 0, 1)]
    first, again, other = (np.array(OneContext().prepare(run).env.reset()) for run in runs)
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_a_record_describes_itself(tmp_path: Path):
    assert do(tmp_path, run_of(0, sigma=0.1)) == 0
    record = read_record(tmp_path / "hillclimber_bottles-v0_seed-000.json")
    assert record.specification == run_of(0, sigma=0.1).record
    assert record.specification.settings == {"sigma": 0.1}
    assert record.specification.algorithm == "hillclimber"
    assert record.provenance.packages["numpy"] == np.__version__
    greedy = record.measured.rollouts["greedy"]
    assert np.shape(greedy.trajectory) == np.shape(greedy.executed or []) == (200, 2)
    assert record.task.trajectory_names == ("hand x [m]", "hand y [m]")
    curves = curves_frame([record])
    assert len(curves) == 12 and curves["seed"].unique().tolist() == [0]


def test_a_run_leaves_no_model_behind():
    gc.disable()  # what Python would collect sooner or later
    try:
        assert record_of(run_of(0, "Remembered"), provenance()).finished
    finally:
        gc.enable()
    assert len(Remembered.alive) == 0


def test_finished_runs_are_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    do(tmp_path, run_of(0))
    before = (tmp_path / f"{run_of(0).stem}.json").stat().st_mtime_ns
    assert do(tmp_path, run_of(0), run_of(1)) == 0
    assert "1 of 2 runs are finished" in capsys.readouterr().out
    assert (tmp_path / f"{run_of(0).stem}.json").stat().st_mtime_ns == before
    assert len(read_records(tmp_path).records) == 2


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (lambda: run_of(0, budget=13), "budget = 12"),
        (lambda: run_of(1, budget=13), "budget = 12"),
        (lambda: run_of(0, sigma=0.1), "settings.sigma = its default"),
        (lambda: run_of(0, "Broken", budget=13), "budget = 12"),
    ],
)
def test_other_settings_clash(tmp_path: Path, other: Callable[[], RunSpecification], named: str):
    do(tmp_path, run_of(0))
    with pytest.raises(SettingsClashError, match=named) as caught:
        do(tmp_path, other())
    assert "--out" in str(caught.value) and "--overwrite" in str(caught.value)
    assert len(read_records(tmp_path).records) == 1


def test_overwrite_replaces_the_runs_asked_for_and_no_others(tmp_path: Path):
    do(tmp_path, run_of(0), run_of(1))
    with pytest.raises(SettingsClashError, match="seed 1, with budget"):
        do(tmp_path, run_of(0, budget=13), overwrite=True)
    assert do(tmp_path, run_of(0, budget=13), run_of(1, budget=13), overwrite=True) == 0
    assert {r.specification.budget for r in read_records(tmp_path).records} == {13}


def test_a_run_that_spends_more_than_its_budget_fails():
    why = r"spendthrift spent 17 rollouts of 12: .*check_algorithm"
    with pytest.raises(BenchmarkError, match=why):
        execute(run_of(0, "Spendthrift"))


def test_a_failed_run_keeps_its_reason_and_is_tried_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    assert do(tmp_path, run_of(0, "Broken"), run_of(1, "Broken")) == 0
    assert "1 of 2 runs failed" in capsys.readouterr().err
    failed = read_record(tmp_path / f"{run_of(0, 'Broken').stem}.failed.json")
    assert failed.error is not None and failed.reason == "RuntimeError: the matrix is singular"
    assert "_end_generation" in failed.error.traceback

    monkeypatch.setattr("tests.results_fakes.Broken._end_generation", lambda *_: None)
    assert do(tmp_path, run_of(0, "Broken"), run_of(1, "Broken")) == 0
    assert [record.outcome for record in read_records(tmp_path).records] == ["finished"] * 2


def test_all_runs_failing_is_an_error(tmp_path: Path):
    assert do(tmp_path, run_of(0, "Broken")) == 1
    assert do(tmp_path, run_of(0, "NoSuchClass")) == 1


def test_interruption_keeps_finished_runs_and_says_how_to_resume(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    runs = [run_of(seed, "Interrupted") for seed in range(3)]
    assert do(tmp_path, *runs) == 130
    assert "1 of 3 runs are finished" in capsys.readouterr().err
    assert len(read_records(tmp_path).records) == 1
    assert plan_runs(tmp_path, runs).todo == tuple(runs[1:])


def test_rollouts_are_counted_while_the_runs_go_on(tmp_path: Path):
    plan = plan_runs(tmp_path, [run_of(0), run_of(0, "Broken")])
    with RolloutCounters(2) as counters:
        totals = [counters.total() for _ in run_plan(plan, 1, counters)]
    assert totals == [12, 24]


def test_ctrl_c_ends_worker_processes_quietly(tmp_path: Path, result: Result):
    """The terminal sends SIGINT to the command and its workers alike."""
    script = (
        "import signal, sys\n"
        "from pathlib import Path\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # background jobs ignore it
        "from results.harness.resume import plan_runs\n"
        "from results.harness.progress import run_with_progress\n"
        "from tests.test_results_runner import run_of\n"
        "runs = [run_of(0, budget=5), run_of(1, budget=10**5), run_of(2, budget=10**5)]\n"
        "sys.exit(run_with_progress(plan_runs(Path(sys.argv[1]), runs), 2))\n"
    )
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    process = subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path)],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    deadline = time.monotonic() + 120
    while not list(tmp_path.glob("*.json")) and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "interrupted. 1 of 3 runs are finished" in errors
    assert "Traceback" not in errors
    assert [path.name for path in tmp_path.iterdir()] == [f"{run_of(0).stem}.json"]
    (finished,) = read_records(tmp_path).records
    assert finished.curve["best_reward"] == result.measured.curve["best_reward"][:5]


def test_infinite_settings_are_kept_as_text() -> None:
    assert plain({"temperature": float("inf"), "beta": 0.3}) == {"temperature": "inf", "beta": 0.3}
