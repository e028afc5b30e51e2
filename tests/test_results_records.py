"""Records: written whole, read with types, refused in a sentence; tables need nothing else."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from results.exceptions import RecordError
from results.harness import progress
from results.harness.progress import run_with_progress
from results.harness.record_files import read_record, read_records, write_record
from results.harness.records import ContextRecord, RolloutRecord, RunRecord, SuiteRecord, labels_of
from results.harness.resume import plan_runs
from tests.records_fakes import curve_of, failed_run, finished_run, specification
from tests.test_results_runner import run_of


def example(label: str = "A", seed: int = 0) -> RunRecord:
    line = [[0.1 * i, 0.5] for i in range(5)]
    return finished_run(
        specification(label, seed, suite=SuiteRecord("s", ("B", "A"))),
        curve_of([-5.0, -1.0, -1.0, -1.0], [False, True, True, True]),
        context=ContextRecord((0.5,)),
        rollouts={"greedy": RolloutRecord(line, line, True)},
    )


def test_a_record_is_read_as_it_was_written(tmp_path: Path) -> None:
    for number, record in enumerate((example(), failed_run(specification("B", 1)))):
        path = tmp_path / f"{number}.json"
        write_record(path, record)
        assert read_record(path) == record


def test_a_record_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    write_record(path, example())
    with pytest.raises(ValueError):
        write_record(path, finished_run(specification("A", 0), {"rollouts": [float("nan")]}))
    assert read_record(path) == example()
    assert list(tmp_path.iterdir()) == [path]


def changed(**entries: object) -> str:
    path_free = json.loads(json.dumps(_builtins(example())))
    return json.dumps(path_free | entries)


def _builtins(record: RunRecord) -> dict[str, object]:
    import msgspec

    return {"format": 2, **msgspec.to_builtins(record)}


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("{", "Input data was truncated"),
        ("[]", "Expected `object`"),
        ('{"format": 99}', "format 99.*update sb3-nmp"),
        ('{"format": 1, "specification": {}}', "format 1, from before this format"),
        (changed(outcome="lost"), "Invalid enum value"),
        (changed(result=None), "without its finished part"),
        (changed(specification=None), r"\$\.specification"),
    ],
)
def test_an_unreadable_file_is_named_with_its_way_out(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "foreign.json"
    path.write_text(text)
    with pytest.raises(RecordError, match=why) as caught:
        read_record(path)
    assert "foreign.json" in str(caught.value)
    assert "remove the file" in str(caught.value).lower()


def test_the_other_runs_stay_usable(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A damaged run is told about and not done again, hence status 1; the rest goes on."""
    write_record(tmp_path / "a.json", example())
    damaged = tmp_path / f"{run_of(1).stem}.json"
    damaged.write_text("{")
    held = read_records(tmp_path)
    assert held.records == [example()] and list(held.unreadable) == [damaged]
    (tmp_path / "a.json").unlink()
    assert run_with_progress(plan_runs(tmp_path, [run_of(0), run_of(1)]), 1) == 1
    assert damaged.name in capsys.readouterr().err
    assert run_with_progress(plan_runs(tmp_path, [run_of(0)]), 1) == 0, "which does not ask for it"
    assert run_with_progress(plan_runs(tmp_path, [run_of(1)]), 1) == 1
    assert damaged.read_text() == "{"
    assert run_with_progress(plan_runs(tmp_path, [run_of(1)], overwrite=True), 1) == 0
    assert read_record(damaged).finished


def test_an_interrupted_command_counts_the_runs_that_cannot_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(progress, "run_plan", interrupted)
    (tmp_path / f"{run_of(1).stem}.json").write_text("{")
    assert run_with_progress(plan_runs(tmp_path, [run_of(0), run_of(1)]), 1) == 130
    assert "interrupted. 0 of 2 runs are finished" in capsys.readouterr().err


def test_a_run_of_an_algorithm_that_is_gone_is_still_told_about(tmp_path: Path) -> None:
    from results.reports import report_for

    gone = finished_run(specification("Gone", 0), curve_of([-1.0], [True]))
    write_record(tmp_path / "gone.json", gone)
    records = read_records(tmp_path).records
    report = report_for(records)
    assert "| Gone | 1 |" in report.tables(report.frame(records), labels_of(records)).markdown()


def test_rows_stand_in_the_suites_order_and_those_not_run_are_shown() -> None:
    assert labels_of([example("A"), example("C")]) == ["B", "A", "C"]


SCRIPT = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {"benchmark_envs", "baselines", "sb3_nmp", "torch", "mujoco"}:
            raise ImportError(f"{name} is not to be imported")
        if name.startswith("results.suites") or name == "results.algorithms":
            raise ImportError(f"{name} is not to be imported")

sys.meta_path.insert(0, Refuse())
from pathlib import Path
from results.harness.record_files import read_records
from results.harness.records import labels_of
from results.report.figure_style import save_figures
from results.reports import figures, report_for

folder = Path(sys.argv[1])
records = read_records(folder).records
report, labels = report_for(records), labels_of(records)
print(report.tables(report.frame(records), labels).markdown())
print(save_figures(folder, figures(records, labels)))
"""


def test_a_table_and_a_figure_need_records_alone(tmp_path: Path) -> None:
    """Tasks, algorithms and suites cannot be imported in this process."""
    for seed in range(2):
        write_record(tmp_path / f"{seed}.json", example(seed=seed))
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(tmp_path)],
        capture_output=True, text=True, cwd=Path(__file__).parents[1], check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "| A | 2 |" in done.stdout and "not run" in done.stdout
    assert {path.name for path in tmp_path.glob("*.png")} == {
        "curves_bottles-v0.png",
        "rollouts_bottles-v0.png",
    }
