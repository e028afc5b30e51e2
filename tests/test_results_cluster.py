"""`nmp-bench run --backend ray` on a local cluster of two nodes."""

import dataclasses
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from results.cli import main
from results.harness import cluster, runner
from results.harness.record_files import read_records
from results.harness.specification import Algorithm
from results.harness.suite import Recipe, make_suite
from results.one_context.protocol import OneContext
from results.suites import find_recipe
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


def test_work_of_a_node_that_goes_away_is_done_elsewhere(nodes: Any, tmp_path: Path) -> None:
    """Three pieces on three cores wait until a node is gone, so that one of them begins anew."""
    added = nodes.add_node(num_cpus=1)
    began, gone = tmp_path / "began", tmp_path / "gone"
    began.touch()

    def waits(place: int) -> int:
        import time

        with began.open("a") as file:
            file.write("x")
        while not gone.exists():
            time.sleep(0.1)
        return place**2

    def remove() -> None:
        while len(began.read_text()) < 3:
            time.sleep(0.1)
        nodes.remove_node(added, allow_graceful=False)
        time.sleep(4.0)  # its processes end with it
        gone.touch()

    with cluster.connected() as ray_there:
        removing = threading.Thread(target=remove)
        removing.start()
        found = dict(cluster.on_cluster(ray_there, waits, range(3), None))
        removing.join()
    assert found == {place: place**2 for place in range(3)}
    assert len(began.read_text()) == 4


def test_a_cluster_that_goes_is_told() -> None:
    class Going:
        exceptions = ray.exceptions

        def remote(self, **_: Any) -> Any:
            return lambda work: type("Remote", (), {"remote": staticmethod(lambda piece: piece)})

        def cluster_resources(self) -> dict[str, float]:
            return {"CPU": 2.0}

        def wait(self, references: list[int]) -> Any:
            raise ConnectionError("Client is shutting down")

    with pytest.raises(cluster.ClusterGoneError, match=r"has gone .Client is shutting down"):
        list(cluster.on_cluster(Going(), str, [1, 2], None))


def test_a_node_of_another_commit_makes_no_record(monkeypatch: pytest.MonkeyPatch) -> None:
    here = runner.provenance()
    monkeypatch.setattr(runner, "provenance", lambda: replace(here, commit="b" * 40))
    (asked,) = make_suite("fakes", find_recipe("fakes"), [0], labels=["Hill"]).specifications
    record = runner.record_on_node((asked, replace(here, commit="a" * 40)))
    assert not record.finished and "install that one there" in record.reason


def test_work_that_kills_its_process_is_told_and_spares_the_others(nodes: Any) -> None:
    def deadly(place: int) -> int:
        import os

        if place == 1:
            os._exit(1)
        return place

    with cluster.connected() as ray_there:
        found = dict(cluster.on_cluster(ray_there, deadly, range(3), 2))
    assert found[0] == 0 and found[2] == 2
    assert isinstance(found[1], Exception)


def test_what_is_missing_is_told_in_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(cluster.ADDRESS, "127.0.0.1:1")
    assert run(tmp_path, "--workers", "1", "--algorithms", "Hill") == 0
    before = sorted(tmp_path.iterdir())
    capsys.readouterr()
    assert run(tmp_path, "--backend", "ray", "--overwrite") == 2
    assert sorted(tmp_path.iterdir()) == before  # nothing is removed for nothing
    told = capsys.readouterr().err
    assert "no Ray cluster answers at RAY_ADDRESS=127.0.0.1:1" in told
    assert told.count("\n") == 1
    monkeypatch.setitem(sys.modules, "ray", None)
    assert run(tmp_path, "--backend", "ray") == 2
    assert "pip install sb3-nmp[ray]" in capsys.readouterr().err
