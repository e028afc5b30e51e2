"""`nmp-bench run --together`: runs of one algorithm side by side in a process."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from results.cli import main
from results.exceptions import BenchmarkError
from results.harness.progress import run_with_progress
from results.harness.record_files import read_records
from results.harness.records import RunRecord
from results.harness.resume import plan_runs
from results.harness.runner import groups
from results.harness.specification import Algorithm, RunSpecification
from results.leaderboard.rows import claim_of
from results.one_context.protocol import OneContext
from results.one_context.summary import frame
from results.report.footnotes import origins

TASK, BUDGET = "nmp/Bottles-v0", 45


def run_of(seed: int, label: str = "RC-NMP", path: str = "sb3_nmp:RCNMP") -> RunSpecification:
    return RunSpecification(label, Algorithm("any", path), TASK, seed, BUDGET, OneContext())


def done(folder: Path, *runs: RunSpecification, n_together: int) -> list[RunRecord]:
    """Do runs in one worker, which works in this process, and return their records."""
    run_with_progress(plan_runs(folder, runs), 1, n_together=n_together)
    return read_records(folder).records


@pytest.fixture(scope="module")
def runs() -> list[RunSpecification]:
    return [run_of(seed) for seed in (300, 301, 302)]


@pytest.fixture(scope="module")
def beside(
    runs: list[RunSpecification], tmp_path_factory: pytest.TempPathFactory
) -> list[RunRecord]:
    return done(tmp_path_factory.mktemp("beside"), *runs, n_together=3)


def test_runs_side_by_side_are_the_runs_by_themselves(
    runs: list[RunSpecification], beside: list[RunRecord], tmp_path: Path
):
    """In the third generation bottles magnify what rounding changed."""
    alone = done(tmp_path, *runs, n_together=1)
    assert [record.n_together for record in (*alone, *beside)] == [1, 1, 1, 3, 3, 3]
    for one, other in zip(alone, beside, strict=True):
        assert one.specification == other.specification
        assert one.curve["rollouts"] == other.curve["rollouts"]
        difference = np.abs(np.subtract(one.curve["best_reward"], other.curve["best_reward"]))
        assert difference.max() < 1e-3
        lines = [np.array(record.measured.rollouts["greedy"].trajectory) for record in (one, other)]
        assert np.abs(lines[0] - lines[1]).max() < 1e-5


def test_a_record_and_a_table_tell_of_it(beside: list[RunRecord]):
    told = [note for note in origins(frame(beside)) if "--together" in note]
    assert len(told) == 1 and "RC-NMP" in told[0] and "rounding" in told[0].lower()
    with pytest.raises(BenchmarkError, match="2 other runs"):
        claim_of(beside[0])


def test_the_seconds_of_runs_side_by_side_are_those_that_passed(tmp_path: Path):
    begin = time.perf_counter()
    records = done(tmp_path, *(run_of(seed) for seed in range(3)), n_together=3)
    passed = time.perf_counter() - begin
    took = [(each.seconds.training or 0) + each.seconds.evaluation for each in records]
    assert 0.5 * passed < sum(took) < passed


def test_runs_that_train_nothing_are_runs_by_themselves(tmp_path: Path):
    runs = [run_of(seed, "GA", "baselines:GA") for seed in range(2)]
    records = done(tmp_path, *runs, n_together=2)
    assert [record.n_together for record in records] == [1, 1]
    assert not any("--together" in note for note in origins(frame(records)))


def test_a_run_that_fails_leaves_its_neighbours_alone(tmp_path: Path):
    runs = [run_of(seed, "Broken", "tests.results_fakes:Broken") for seed in range(3)]
    records = done(tmp_path, *runs, n_together=3)
    ended = {record.specification.seed: record.finished for record in records}
    assert ended == {0: False, 1: True, 2: False}


def test_every_worker_has_a_group_and_groups_are_of_one_algorithm():
    todo = [run_of(0), run_of(0, "GA"), run_of(1), run_of(1, "GA"), run_of(2)]
    assert groups(todo, 1, 2) == [[0], [1], [2], [3], [4]]
    assert groups(todo, 25, 1) == [[0, 2, 4], [1, 3]]
    assert groups(todo, 25, 2) == [[0, 2], [1], [3], [4]]
    assert groups(todo, 2, 1) == [[0, 2], [1, 3], [4]]
    fifty = [run_of(seed) for seed in range(50)]
    sizes = [len(group) for group in groups(fifty, 24, 2)]
    assert sizes == [13, 13, 12, 12]
    for change in ({"task": "nmp/Push-v0"}, {"variant": "other"}, {"budget": 7}):
        assert groups([run_of(0), replace(run_of(1), **change)], 25, 1) == [[0], [1]]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--together", "0"], "--together is 0"),
        (["--together", "2", "--backend", "ray"], "leave one of them out"),
    ],
)
def test_what_cannot_be_is_said(
    options: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    asked = ["run", "--suite", "quick", "--seeds", "1", "--out", str(tmp_path / "runs")]
    assert main([*asked, *options]) == 2
    assert told in capsys.readouterr().err
