"""Adaptation far beyond a set of demonstrations: split, protocol, report and Table 5.2."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from benchmark_envs import TaskError, extrapolation, make_task
from results.adaptation.figures import figures
from results.adaptation.protocol import Extrapolation
from results.adaptation.summary import frame
from results.cli import main
from results.exceptions import BenchmarkError
from results.harness.environments import RunTask
from results.harness.record_files import read_records, write_record
from results.harness.records import (
    ContextRecord,
    ProtocolRecord,
    RolloutRecord,
    RunRecord,
    SuiteRecord,
    labels_of,
)
from results.harness.runner import execute
from results.harness.specification import Algorithm, RunSpecification
from results.reports import report_for
from results.suites import find_recipe
from results.thesis.table_5_2 import mean_joint_errors
from results.thesis.table_5_2 import table as table_5_2
from tests.records_fakes import finished_run, specification

PICK, POURING = "nmp/PickAndPlace-v1", "nmp/Pouring-v1"


def record(task: str, target: int, seed: int, curve: dict[str, list[Any]]) -> RunRecord:
    """A finished run of ACNMP: a demonstration at first, the expert's answer at last."""
    shown, context = extrapolation(task, target)
    physics = make_task(task)
    first, last = (physics.initial_trajectory(c) for c in (shown[0], context))
    if task == PICK:  # pouring is about amounts alone, and its expert has to simulate
        first, last = physics.demonstrate(shown[0]), physics.demonstrate(context)
    recipe = find_recipe("pick-and-place" if task == PICK else "pouring")
    asked = specification(
        "ACNMP", seed, task, 18, ProtocolRecord("extrapolation", {}, target, f"context {target}"),
        SuiteRecord("", (), recipe.checkpoints, recipe.published),
    )  # fmt: skip
    rollouts = {"greedy": last, "untrained": first, "expert": last}
    return finished_run(
        asked,
        curve,
        RunTask(task, 0, 1).task_record,
        context=ContextRecord(tuple(context.tolist())),
        rollouts={name: RolloutRecord(path.tolist()) for name, path in rollouts.items()},
    )


def curve(errors: list[float]) -> dict[str, list[Any]]:
    """A curve whose error is given at 0, 1, 2, ... rollouts; below 27 is a success."""
    rewards = [-float(error) for error in errors]
    solved = [bool(error <= 27) for error in errors]
    return {
        "rollouts": list(range(len(errors))),
        "best_reward": [None, *rewards[1:]],
        "best_success": solved,
        "any_success": solved,
        "greedy_reward": list(rewards),
        "greedy_success": solved,
    }


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    falling = [842.0, *np.linspace(800, 5, 18)]
    for suite, records in {
        "pick-and-place": [record(PICK, t, s, curve([30.0, 1.0])) for t in (0, 1) for s in (0, 1)],
        "pouring": [record(POURING, 0, s, curve([e + s for e in falling])) for s in (0, 1, 2)],
    }.items():
        (tmp_path / suite).mkdir()
        for i, made in enumerate(records):
            write_record(tmp_path / suite / f"{i}.json", made)
    return tmp_path


def test_the_split_holds_the_thesis_contexts() -> None:
    shown, context = extrapolation(POURING, 0)
    assert shown.shape == (16, 2) and context.tolist() == [1400, 1322]
    assert shown[:, 0].min() == 850 and shown[:, 0].max() == 950
    shown, context = extrapolation(PICK, 0)
    assert shown.shape == (8, 2) and context.tolist() == [0.08, 0.10]
    context[:] = 0
    assert extrapolation(PICK, 0)[1].tolist() == [0.08, 0.10], "a copy"


def test_the_split_names_what_exists() -> None:
    with pytest.raises(TaskError, match=r"no extrapolation context 2; they are numbered 0 to 1"):
        extrapolation(PICK, 2)
    with pytest.raises(TaskError, match=r"Push-v0 has no numbered contexts to extrapolate to"):
        extrapolation("nmp/Push-v0", 0)


def test_a_run_is_shown_the_demonstrations_and_begins_with_the_untrained_answer() -> None:
    short = {"pretraining": _short_pretraining(), "population_size": 1}
    algorithm = Algorithm("acnmp", "sb3_nmp:ACNMP", short)
    run = RunSpecification("ACNMP", algorithm, PICK, 3, 2, Extrapolation(1))
    done = execute(run).measured
    assert done.curve["rollouts"][0] == 0
    assert done.context is not None and done.context.values == (0.09, 0.11)
    assert np.shape(done.rollouts["untrained"].trajectory) == (200, 6)
    assert run.stem.endswith("pickandplace-v1_target-01_seed-003")
    size = len(json.dumps(msgspec.to_builtins(done)))
    assert size < 120_000, "records are small, though they hold the demonstrations"


def _short_pretraining() -> object:
    from sb3_nmp.models.cnmp_training import CNMPPretraining

    return CNMPPretraining(n_steps=30)


def test_each_context_has_a_table_of_its_own(folder: Path) -> None:
    records = read_records(folder / "pick-and-place").records
    report = report_for(records)
    text = report.tables(report.frame(records), labels_of(records)).markdown()
    assert "context 0: object height [m] 0.08, tower height [m] 0.1" in text
    assert "context 1: object height [m] 0.09, tower height [m] 0.11" in text
    assert "within 100" not in text  # these runs had fewer rollouts
    assert "error [m] at 0 |" in text
    with pytest.raises(BenchmarkError, match="--reference has no meaning for extrapolation runs"):
        figures(records, ["ACNMP"], [Path("x.npy")])


def test_the_suites_tell_their_checkpoints() -> None:
    assert find_recipe("pouring").checkpoints == (0, 6, 12, 18)
    assert find_recipe("push").published == 130


def test_errors_are_reported_at_the_tasks_own_checkpoints(folder: Path) -> None:
    runs = frame(read_records(folder / "pouring").records)
    assert runs["error_0"].tolist() == [842, 843, 844]
    assert runs["error_18"].tolist() == [5, 6, 7]
    assert "error_40" not in runs


def test_joint_errors_are_mean_absolute_degrees() -> None:
    expert = np.zeros((4, 2))
    tried = np.radians([[[1.0, -2.0]] * 4, [[3.0, 0.0]] * 4])
    np.testing.assert_allclose(mean_joint_errors(tried, expert), [2.0, 1.0])


def test_table_5_2_stands_beside_the_thesis(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["table", "table-5.2", "--runs", str(folder)]) == 0
    assert "Written" in capsys.readouterr().out
    lines = (folder / "table-5.2.md").read_text().splitlines()
    (row,) = (line for line in lines if line.startswith("| CNMP 8 and 10 cm"))
    assert "| 0/2 |" in row and "(8.88)" in row
    (row,) = (line for line in lines if line.startswith("| ACNMP 9 and 11 cm"))
    assert "| 2/2 | 0.00 (0.99) | 0.00 (0.51) |" in row
    (row,) = (line for line in lines if line.startswith("| 18 | 27 |"))
    assert row == "| 18 | 27 | – | 6 (worst 7) |", "these records tell no raw errors"


def test_table_5_2_tells_what_to_run(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(BenchmarkError, match=r"--suite pick-and-place.* and .*--suite pouring"):
        table_5_2(tmp_path / "none")
    only = tmp_path / "only"
    only.mkdir()
    (only / "pouring").symlink_to(folder / "pouring")
    page = table_5_2(only)
    assert page.tables[0].title.startswith("Table 5.2, right")
    (missing,) = (section for section in page.sections if section.title == "Missing runs")
    assert "--suite pick-and-place" in missing.lines[0]


def test_curves_have_a_panel_for_each_context(folder: Path) -> None:
    for suite, panels in (("pick-and-place", 2), ("pouring", 1)):
        records = read_records(folder / suite).records
        (figure,) = figures(records, ["ACNMP"]).values()
        visible = [axes for axes in figure.axes if axes.get_visible()]
        assert len(visible) == 2 * panels  # errors, and below them successes
        assert visible[0].lines[0].get_xydata().shape[0] >= 2  # type: ignore[union-attr]
