"""Runs of each protocol, with fakes."""

from collections.abc import Iterator

import numpy as np
import pytest

from results.adaptation.protocol import LeaveOneOut
from results.exceptions import BenchmarkError
from results.harness.environments import RunTask
from results.harness.greedy import changes
from results.harness.protocol import Protocol
from results.harness.records import Measurements
from results.harness.runner import execute
from results.harness.specification import Algorithm, RunSpecification
from results.stream.evaluation import schedule
from results.stream.protocol import Stream
from tests.results_fakes import TARGET_TASK, TARGETS, TargetTask, target_task

ADAPTIVE = Algorithm("adaptive", "tests.results_fakes:Adaptive")
GUESSING = Algorithm("guessing", "tests.results_fakes:Guessing", pretrained=False)
STREAM = Stream(n_demonstrations=4, n_contexts=12, n_test=30)


@pytest.fixture(scope="module", autouse=True)
def task() -> Iterator[TargetTask]:
    with target_task():
        yield TargetTask()


def run_of(
    protocol: Protocol, budget: int = 20, seed: int = 0, algorithm: Algorithm = ADAPTIVE
) -> RunSpecification:
    return RunSpecification("A", algorithm, TARGET_TASK, seed, budget, protocol)


def measured(run: RunSpecification) -> Measurements:
    return execute(run).measured


def place(seed: int = 0) -> RunTask:
    return RunTask(TARGET_TASK, seed, 20)


@pytest.fixture(scope="module")
def held_out() -> Measurements:
    return measured(run_of(LeaveOneOut(9, True)))


@pytest.fixture(scope="module")
def streamed() -> Measurements:
    return measured(run_of(STREAM, 1000))


# -- leave one out -----------------------------------------------------------------------------


def test_nine_targets_are_demonstrated_and_the_tenth_is_pinned(task: TargetTask):
    prepared = LeaveOneOut(3, False).prepare(place())
    shown = prepared.demonstrations
    assert shown is not None and len(shown) == 9
    assert not (shown.contexts == TARGETS[3]).all(axis=1).any()
    assert np.array_equal(shown.trajectories[0], task.demonstrate(shown.contexts[0]))
    assert np.array(prepared.env.reset()) == pytest.approx(TARGETS[[3]])


def test_the_curve_begins_with_the_policy_that_the_demonstrations_gave(
    held_out: Measurements, task: TargetTask
):
    curve = held_out.curve
    assert curve["rollouts"][0] == 0
    assert curve["best_reward"][0] is None and not curve["best_success"][0]
    nearest = task.demonstrate(TARGETS[8])
    expected = task.simulate(TARGETS[9], nearest)
    assert curve["greedy_reward"][0] == pytest.approx(expected.rewards[0], abs=1e-6)


def test_the_curve_ends_with_the_budget_and_keeps_changes_only(held_out: Measurements):
    curve = held_out.curve
    assert curve["rollouts"][-1] == 20
    assert curve["greedy_reward"][-1] > curve["greedy_reward"][0]
    rows = [dict(zip(curve, row, strict=True)) for row in zip(*curve.values(), strict=True)]
    assert changes(rows) == rows


def test_rows_that_change_nothing_are_left_out():
    rows = [{"rollouts": count, "x": x} for count, x in enumerate("aabbb")]
    assert [row["rollouts"] for row in changes(rows)] == [0, 2, 4]
    assert changes(rows[:1]) == rows[:1]


def test_an_algorithm_without_a_policy_begins_with_its_first_rollout():
    record = measured(run_of(LeaveOneOut(9, True), algorithm=GUESSING))
    assert record.curve["rollouts"][0] == 1
    assert "untrained" not in record.rollouts


def test_the_experts_answer_stands_beside_the_policys(held_out: Measurements, task: TargetTask):
    expert = held_out.rollouts["expert"]
    assert np.array(expert.trajectory) == pytest.approx(task.demonstrate(TARGETS[9]), abs=1e-5)
    assert expert.executed is None and "untrained" in held_out.rollouts


def test_demonstrations_are_handed_over():
    shown = LeaveOneOut(0, False).prepare(place()).demonstrations
    assert ADAPTIVE.arguments(shown) == {"demonstrations": shown}
    assert ADAPTIVE.arguments(None) == {}


def test_the_target_is_part_of_the_runs_identity():
    runs = [run_of(LeaveOneOut(target, target == 9)) for target in range(10)]
    assert len({run.stem for run in runs}) == 10
    assert runs[9].stem == "a_fake-targets-v0_target-09_seed-000"
    protocol = runs[9].record.protocol
    assert (protocol.number, protocol.kind) == (9, "extrapolation")
    assert runs[9].name == "A on fake/Targets-v0, target 9, seed 0"


# -- stream ------------------------------------------------------------------------------------


def test_a_stream_ends_where_it_asks_for_more_contexts(streamed: Measurements):
    """Twelve contexts of five rollouts, and one rollout in the thirteenth."""
    assert streamed.more["contexts"] == {"rollouts": [5] * 12, "exhausted": True}
    assert streamed.curve["rollouts"][-1] == 61
    assert streamed.curve["contexts"][-1] == 12


def test_a_stream_ends_with_its_budget():
    record = measured(run_of(STREAM, 23))
    assert record.more["contexts"] == {"rollouts": [5, 5, 5, 5, 3], "exhausted": False}
    assert record.curve["rollouts"][-1] == 23


def test_failures_are_those_of_the_held_out_contexts(streamed: Measurements, task: TargetTask):
    curve = streamed.curve
    shown = STREAM.prepare(place()).demonstrations
    assert shown is not None and len(shown) == 4
    tests = STREAM.test_contexts(task)
    distances = np.linalg.norm(tests[:, None] - shown.contexts, axis=2).min(axis=1)
    assert curve["rollouts"][0] == 0 and curve["contexts"][0] == 0
    assert curve["failure_rate"][0] == pytest.approx(np.mean(distances >= 0.1), abs=0.04)
    assert curve["mean_reward"][0] == pytest.approx(-distances.mean(), abs=1e-5)
    assert curve["failure_rate"][-1] < curve["failure_rate"][0]
    assert (np.diff(curve["rollouts"]) > 0).all()


def test_no_context_of_a_run_is_another_of_it(task: TargetTask):
    """Equal seeds would show the stream's contexts, or try them, beforehand."""
    prepared = STREAM.prepare(place(seed=5))
    assert prepared.demonstrations is not None
    prepared.env.seed(5)
    stream = np.concatenate([np.array(prepared.env.reset()) for _ in range(20)])
    other = STREAM.prepare(place(seed=6)).demonstrations
    assert other is not None
    found = np.concatenate(
        [stream, prepared.demonstrations.contexts, other.contexts, STREAM.test_contexts(task)]
    )
    assert len(np.unique(found.astype(np.float32), axis=0)) == len(found)


def test_test_contexts_are_the_same_for_all_runs(task: TargetTask):
    again = Stream(n_demonstrations=9, n_contexts=5, n_test=30)
    assert np.array_equal(STREAM.test_contexts(task), again.test_contexts(task))


def test_equal_seeds_give_equal_streams(streamed: Measurements):
    assert measured(run_of(STREAM, 1000)).curve == streamed.curve
    assert measured(run_of(STREAM, 1000, seed=1)).curve != streamed.curve


def test_a_stream_without_a_first_policy_begins_later():
    record = measured(run_of(STREAM, 100, algorithm=GUESSING))
    assert record.curve["rollouts"][0] > 0


def test_evaluations_are_dense_at_first_and_within_the_run():
    rollouts, contexts = schedule(10_000, 1000)
    assert rollouts[0] == 20 and rollouts[-1] < 10_000 and 15 < len(rollouts) < 30
    assert contexts[0] == 50 and contexts[-1] < 1000
    assert (np.diff(rollouts) > 0).all() and (np.diff(contexts) > 0).all()
    for budget, n_contexts in ((1, 1), (5, 2)):
        assert (schedule(budget, n_contexts)[0] < budget + 1).all()


@pytest.mark.parametrize(
    ("name", "value"), [("n_demonstrations", -1), ("n_contexts", 0), ("n_test", 0)]
)
def test_a_stream_needs_something_of_each(name: str, value: int):
    with pytest.raises(BenchmarkError, match=f"{name} is {value}; a stream needs at least"):
        Stream(**{name: value})  # pyright: ignore[reportArgumentType]


def test_a_stream_may_show_nothing():
    prepared = Stream(0, 12, 30).prepare(place())
    assert prepared.demonstrations is None
