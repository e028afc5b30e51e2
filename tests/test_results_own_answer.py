"""Records and tables credit the model with its own answer alone, and tell what each row may see."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from results.adaptation.protocol import LeaveOneOut
from results.harness.environments import RunTask
from results.harness.protocol import Protocol
from results.harness.record_files import read_record, write_record
from results.harness.records import Result, RolloutRecord, RunRecord, labels_of
from results.harness.runner import execute
from results.harness.specification import Algorithm, RunSpecification
from results.one_context.protocol import OneContext
from results.report.text_table import TextTable
from results.reports import report_for
from results.stream.evaluation import StreamEvaluation
from results.stream.protocol import Stream
from tests.records_fakes import ORIGIN
from tests.results_fakes import TARGET_TASK, Learner, TargetTask, straight, target_task

STREAM = Stream(n_demonstrations=3, n_contexts=8, n_test=40)
PROTOCOLS: dict[str, Protocol] = {"one context": OneContext(), "adaptation": LeaveOneOut(9, True)}
EVERY = pytest.mark.parametrize("protocol", PROTOCOLS.values(), ids=PROTOCOLS)


@pytest.fixture(scope="module", autouse=True)
def task() -> Iterator[TargetTask]:
    with target_task():
        yield TargetTask()


def done(protocol: Protocol, seed: int = 0, name: str = "Learner", **settings: bool) -> RunRecord:
    algorithm = Algorithm(name.lower(), f"tests.results_fakes:{name}", settings)
    run = RunSpecification(name, algorithm, TARGET_TASK, seed, 8, protocol)
    return RunRecord(run.record, ORIGIN, "finished", execute(run))


def cells(records: list[RunRecord], row: int = 0) -> dict[str, tuple[str, str]]:
    """The cells of a row of the first table, by the names of their columns."""
    report = report_for(records)
    table = report.tables(report.frame(records), labels_of(records)).tables[0]
    assert isinstance(table, TextTable)
    return dict(zip(table.header, table.rows[row], strict=True))


def numbers(records: list[RunRecord]) -> dict[Any, Any]:
    """The first row of the CSV."""
    report = report_for(records)
    return report.summarise(report.frame(records), labels_of(records)).iloc[0].to_dict()


def final(record: RunRecord) -> tuple[bool, bool]:
    """Whether the greedy policy succeeds in the end, and whether the model alone does."""
    own = record.measured.rollouts["own"]
    assert own.success is not None
    return record.curve["greedy_success"][-1], own.success


@EVERY
def test_a_memory_that_is_right_does_not_hide_a_model_that_is_wrong(protocol: Protocol) -> None:
    record = done(protocol, model_is_right=False)
    assert final(record) == (True, False)
    reward = record.measured.rollouts["own"].reward
    assert reward is not None and reward < -0.7, "the model rests, far from the target"
    shown = cells([record])
    assert shown["own answer\nsolved"] == ("0/1", "")
    assert numbers([record])["own_solved"] == 0 and numbers([record])["own_runs"] == 1


@EVERY
def test_a_model_that_is_right_is_seen_behind_a_memory_that_is_wrong(protocol: Protocol) -> None:
    record = done(protocol, model_is_right=True)
    assert final(record) == (False, True)
    assert cells([record])["own answer\nsolved"] == ("1/1", "")
    assert record.measured.rollouts["own"].reward == pytest.approx(0.0, abs=1e-6)


def test_tables_tell_the_own_answers_reward_or_error_in_median() -> None:
    for protocol, column, sign in (
        (OneContext(), "own answer\nreward", 1.0),
        (LeaveOneOut(9, True), "own answer\nerror", -1.0),
    ):
        records = [with_own(done(protocol, seed), seed < 2, -seed - 1.0) for seed in range(3)]
        shown, row = cells(records), numbers(records)
        assert float(shown[column][0]) == sign * -2.0
        assert shown["own answer\nsolved"] == ("2/3", "")
        name = "own_reward_median" if sign > 0 else "own_error_median"
        assert row[name] == sign * -2.0


def with_own(record: RunRecord, success: bool, reward: float) -> RunRecord:
    """The same run with another own answer."""
    assert record.result is not None
    own = replace(record.measured.rollouts["own"], success=success, reward=reward)
    measured = replace(record.measured, rollouts={**record.measured.rollouts, "own": own})
    return replace(record, result=replace(record.result, measured=measured))


def test_mean_errors_are_told_of_the_own_answer_too() -> None:
    record = with_own(done(OneContext()), False, -0.5)
    assert record.result is not None
    told = replace(record.result, task=replace(record.result.task, error_unit="m"))
    header = errors_of(replace(record, result=without_own(told))).header
    assert header[2:] == ("greedy\nall", "best\nall")
    errors = errors_of(replace(record, result=told))
    assert errors.header[2:] == ("greedy\nall", "best\nall", "own\nall")
    assert errors.rows[0][-1] == ("0.5000", "one seed")


def errors_of(record: RunRecord) -> TextTable:
    """The table of mean errors."""
    report = report_for([record])
    return report.tables(report.frame([record]), labels_of([record])).tables[1]


def without_own(result: Result) -> Result:
    kept = {k: rollout for k, rollout in result.measured.rollouts.items() if k != "own"}
    return replace(result, measured=replace(result.measured, rollouts=kept))


def test_a_policy_without_a_model_has_no_answer_of_its_own() -> None:
    record = done(OneContext(), name="HillClimber")
    assert set(record.measured.rollouts) == {"greedy"}
    shown = cells([record])
    assert shown["own answer\nsolved"] == shown["own answer\nreward"] == ("–", "")


# -- what each row may see ---------------------------------------------------------------------


def test_a_record_tells_what_its_algorithm_learns_from() -> None:
    assert done(OneContext()).sees == ("reward", "success")
    shown = [done(LeaveOneOut(9, True))]
    assert shown[0].sees == ("demonstrations", "reward", "success")
    assert cells(shown)["sees"] == ("R S D", "")
    assert numbers(shown)["sees"] == "reward, success, demonstrations"
    assert cells([done(OneContext(), name="HillClimber")])["sees"] == ("R", "")
    assert cells([done(STREAM)])["sees"] == ("R S D", "")


# -- streams -----------------------------------------------------------------------------------


def test_a_streams_own_answers_are_told_apart_from_what_memory_answers(task: TargetTask) -> None:
    """The memory is filled with the answers to a quarter of the held-out contexts."""
    place = RunTask(TARGET_TASK, 0, 8)
    prepared = STREAM.prepare(place)
    evaluation = prepared.evaluation
    assert isinstance(evaluation, StreamEvaluation)
    model = Learner("MlpPolicy", prepared.env, 0, prepared.demonstrations, model_is_right=False)
    known = evaluation.test_contexts[:10]
    memory: Any = model.policy
    memory.elites.update(known, straight(known), np.zeros(10), np.ones(10, bool))
    model.learn(8, callback=evaluation)
    assert evaluation.measured().curve["failure_rate"][-1] == 0.75
    assert evaluation.measured().more["own"] == {"failure_rate": 1.0, "remembered": 0.25}


def test_the_table_of_a_stream_tells_the_own_answers_failures() -> None:
    wrong, right = (done(STREAM, model_is_right=is_right) for is_right in (False, True))
    assert wrong.measured.more["own"] == {"failure_rate": 1.0, "remembered": 0.0}
    assert cells([wrong])["own answer\nfails"] == ("100.0 %", "(0 %)")
    assert cells([right])["own answer\nfails"] == ("0.0 %", "(0 %)")
    assert numbers([right])["own_failure_rate_mean"] == 0.0
    without = done(STREAM, name="Adaptive")
    assert without.measured.more["own"] is None
    assert cells([without])["own answer\nfails"] == ("–", "")


# -- old records -------------------------------------------------------------------------------


@pytest.mark.parametrize("protocol", [*PROTOCOLS.values(), STREAM], ids=[*PROTOCOLS, "stream"])
def test_records_from_before_these_columns_are_read_and_show_nothing(
    protocol: Protocol, tmp_path: Path
) -> None:
    path = tmp_path / "run.json"
    write_record(path, done(protocol))
    held = json.loads(path.read_text())
    del held["result"]["sees"]
    held["result"]["measured"]["more"].pop("own", None)
    rollouts = held["result"]["measured"]["rollouts"]
    rollouts.pop("own", None)
    for rollout in rollouts.values():
        del rollout["reward"]
    path.write_text(json.dumps(held))
    old = read_record(path)
    shown = cells([old])
    last = [name for name in shown if name.startswith("own") or name == "sees"]
    assert len(last) == (2 if protocol is STREAM else 3)
    assert all(shown[name] == ("–", "") for name in last)
    mixed = cells([old, replace(done(protocol, seed=1))])
    assert mixed["sees"] != ("–", "")
    if protocol is not STREAM:
        assert mixed["own answer\nsolved"] == ("1/1", ""), "of one run it is known"


@pytest.mark.parametrize("protocol", [*PROTOCOLS.values(), STREAM], ids=[*PROTOCOLS, "stream"])
def test_notes_explain_the_columns(protocol: Protocol) -> None:
    records = [done(protocol)]
    report = report_for(records)
    text = report.tables(report.frame(records), ["Learner", "Absent"]).markdown()
    assert "own answer: what the model alone answers" in text
    assert "sees: what the algorithm learns from" in text
    (absent,) = (line for line in text.splitlines() if line.startswith("| Absent"))
    assert absent.count("not run") >= 4 and absent.endswith("| – | – | – |")
    assert absent.count("|") == text.splitlines()[2].count("|"), "a cell for each column"


def test_a_rollout_that_was_not_executed_has_no_reward() -> None:
    record = done(LeaveOneOut(9, True))
    expert = record.measured.rollouts["expert"]
    assert expert == RolloutRecord(expert.trajectory)
    assert record.measured.rollouts["greedy"].reward == record.curve["greedy_reward"][-1]
