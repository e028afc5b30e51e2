"""What records keep of a rollout is enough to repeat it bit for bit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark_envs import make_task
from results.harness.greedy import exact
from results.harness.machine import Machine, machine
from results.harness.provenance import provenance
from results.harness.record_files import read_record, write_record
from results.harness.records import RunRecord
from results.harness.runner import execute
from results.harness.specification import Algorithm, RunSpecification
from results.one_context.protocol import OneContext

ALGORITHMS = {
    "hill": Algorithm("hill", "tests.results_fakes:HillClimber"),
    "reps": Algorithm("reps", "baselines:REPS"),
    "ga": Algorithm("ga", "baselines:GA"),
}


@pytest.mark.parametrize("name", ALGORITHMS)
@pytest.mark.parametrize("task", ["nmp/Bottles-v0", "nmp/Push-v0"])
def test_a_rollout_of_a_record_gives_its_reward_to_the_bit(
    name: str, task: str, tmp_path: Path
) -> None:
    run = RunSpecification(name, ALGORITHMS[name], task, 1001, 60, OneContext())
    path = tmp_path / "run.json"
    write_record(path, RunRecord(run.record, provenance(), "finished", execute(run)))
    record = read_record(path)
    context = record.measured.context
    assert context is not None
    simulator = make_task(task, n_threads=1)
    kept = record.measured.rollouts
    for rollout in kept.values():
        again = simulator.simulate(context.values, np.array(rollout.trajectory, np.float32))
        assert float(again.rewards[0]) == rollout.reward
        assert bool(again.successes[0]) == rollout.success
    assert ("solving" in kept) == record.curve["greedy_success"][-1]


def test_numbers_are_kept_without_loss_and_short_where_single_precision_holds_them() -> None:
    rng = np.random.default_rng(0)
    single = rng.standard_normal((50, 2)).astype(np.float32)
    kept = exact(single.astype(np.float64))
    assert (np.array(kept, np.float32) == single).all()
    assert max(len(repr(value)) for row in kept for value in row) < 16


def test_a_record_tells_what_decides_its_last_bits() -> None:
    here = machine()
    assert here == machine() and here.architecture and here.features
    assert here == replace(here, cpu="the same under another name")
    assert here != replace(here, features=here.features[:-1])
    assert isinstance(provenance().machine, Machine)
