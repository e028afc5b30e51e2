"""`nmp-bench run --backend ray` on a local cluster of two nodes."""

import dataclasses
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from results.cli import main
from results.harness import cluster
from results.harness.record_files import read_records
from results.harness.specification import Algorithm
from results.harness.suite import Recipe
from results.one_context.protocol import OneContext
from tests.results_fakes import suite_of

ray = pytest.importorskip("ray")
FAKES = {
    "Hill": Algorithm("hill", "tests.results_fakes:HillClimber"),
    "Broken": Algorithm("broken", "tests.results_fakes:Broken"),
}


@pytest.fixture(scope="module")
def nodes() -> Iterator[Any]:
    """Return a cluster of two nodes of one core, which RAY_ADDRESS names."""
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))
        patch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        local = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
        local.add_node(num_cpus=1)
        patch.setenv(cluster.ADDRESS, str(local.address))
        yield local
        ray.shutdown()
        local.shutdown()


@pytest.fixture(autouse=True)
def fake_suite() -> Iterator[None]:
    recipe = Recipe(FAKES, {"nmp/Bottles-v0": {}}, 12, 4, (OneContext(),))
    with suite_of({"fakes": recipe}):
        yield


def run(folder: Path, *more: str) -> int:
    return main(["run", "--suite", "fakes", "--seeds", "4", "--out", str(folder), *more])


def test_a_cluster_gives_what_processes_give_and_skips_what_is_there(
    nodes: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path / "ray", "--backend", "ray") == 0
    assert run(tmp_path / "here", "--workers", "1") == 0
    there, here = (read_records(tmp_path / name).records for name in ("ray", "here"))
    assert len(there) == len(here) == 8
    for one, other in zip(there, here, strict=True):
        assert one.specification == other.specification
        assert (one.outcome, one.reason) == (other.outcome, other.reason)
        if one.finished:
            assert dataclasses.asdict(one.measured) == dataclasses.asdict(other.measured)
            assert one.provenance.commit == other.provenance.commit
            assert one.provenance.machine == other.provenance.machine
    capsys.readouterr()
    assert run(tmp_path / "ray", "--backend", "ray", "--algorithms", "Hill") == 0
    assert "4 of 4 runs are finished" in capsys.readouterr().out


def test_work_of_a_node_that_goes_away_is_done_elsewhere(nodes: Any) -> None:
    added = nodes.add_node(num_cpus=2)

    def slow(place: int) -> int:
        import time

        time.sleep(1.0)
        return place**2

    found = {}
    for place, result in cluster.on_cluster(slow, range(8), None):
        found[place] = result
        if added is not None:
            nodes.remove_node(added, allow_graceful=False)
            added = None
    assert found == {place: place**2 for place in range(8)}


def test_work_that_kills_its_process_is_told_and_spares_the_others(nodes: Any) -> None:
    def deadly(place: int) -> int:
        import os

        if place == 1:
            os._exit(1)
        return place

    found = dict(cluster.on_cluster(deadly, range(3), 2))
    assert found[0] == 0 and found[2] == 2
    assert isinstance(found[1], Exception)


def test_what_is_missing_is_told_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(cluster.ADDRESS, "127.0.0.1:1")
    assert run(tmp_path, "--backend", "ray") == 2
    told = capsys.readouterr().err
    assert "no Ray cluster answers at RAY_ADDRESS=127.0.0.1:1" in told
    assert told.count("\n") == 1
    monkeypatch.setitem(sys.modules, "ray", None)
    assert run(tmp_path, "--backend", "ray") == 2
    assert "pip install sb3-nmp[ray]" in capsys.readouterr().err
