"""A stranger's package: the one of docs/your_own.md is installed and run, without an edit here."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from results.cli import main
from results.exceptions import BenchmarkError
from results.harness.provenance import provenance
from results.harness.record_files import read_records
from results.harness.runner import run_and_write
from results.harness.specification import Algorithm, RunSpecification
from results.one_context.protocol import OneContext
from results.outside import find_algorithm
from results.suites import find_recipe

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/your_own.md").read_text(encoding="utf-8")
TASK = "mylab/HitBall-v0"


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package's folder, as the page tells to write it."""
    folder = tmp_path_factory.mktemp("stranger") / "mylab"
    (folder / "mylab").mkdir(parents=True)
    (folder / "mylab/__init__.py").touch()
    blocks = re.findall(
        r"`mylab/([\w./]+)`[^`]*?:?\n?[^`]*?```(?:toml|py)\n(.*?)```", PAGE, re.DOTALL
    )
    written = dict(blocks)
    assert set(written) == {
        "pyproject.toml", "mylab/tasks.py", "mylab/algos.py", "test_mylab.py",
    }  # fmt: skip
    assert sum(text.count("\n") for text in written.values()) < 130
    for name, text in written.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def elsewhere(where: Path, script: str, *paths: Path) -> subprocess.CompletedProcess[str]:
    """Run a program in a process of its own that knows some folders more."""
    known = os.pathsep.join(str(path) for path in (*paths, ROOT))
    return subprocess.run(
        [sys.executable, "-c", script], cwd=where, capture_output=True, text=True, timeout=600,
        env={**os.environ, "PYTHONPATH": known, "MUJOCO_GL": "disabled"},
    )  # fmt: skip


def test_the_package_is_installed_run_by_its_entry_points_and_drawn(
    source: Path, tmp_path: Path
) -> None:
    target = tmp_path / "installed"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation",
         "--no-index", "--target", str(target), str(source)],
        check=True, capture_output=True, timeout=600,
    )  # fmt: skip
    runs = tmp_path / "runs"
    script = f"""
from results.cli import main
from results.outside import find_algorithm
assert find_algorithm("smooth-noise").path == "mylab.algos:RandomSearch"
asked = ["run", "--task", "{TASK}", "--algorithm", "smooth-noise", "ga"]
assert main([*asked, "--budget", "20", "--seeds", "2", "--workers", "2", "--out", "{runs}"]) == 0
drawn = "{runs}/smooth-noise_mylab-hitball-v0_seed-000.json"
assert main(["render", "{TASK}", "--run", drawn, "--out", "{tmp_path}/hit.gif"]) == 0
assert main(["table", "--runs", "{runs}"]) == 0
"""
    done = elsewhere(tmp_path, script, target)
    assert done.returncode == 0, done.stderr
    records = read_records(runs).records
    assert {record.specification.label for record in records} == {"smooth-noise", "ga"}
    assert all(record.finished and len(record.curve["rollouts"]) == 20 for record in records)
    with Image.open(tmp_path / "hit.gif") as film:
        assert getattr(film, "n_frames", 1) > 10


def test_the_package_runs_from_its_folder_by_name(source: Path, tmp_path: Path) -> None:
    script = f"""
import sys
sys.path.remove("")  # as the installed command has it
from results.cli import main
asked = ["run", "--task", "{TASK}", "--algorithm", "mylab.algos:RandomSearch"]
more = ["--import", "mylab.tasks", "--budget", "10", "--seeds", "2", "--workers", "1"]
assert main([*asked, *more, "--out", "{tmp_path}"]) == 0
"""
    done = elsewhere(source, script)
    assert done.returncode == 0, done.stderr
    labels = [record.specification.label for record in read_records(tmp_path).records]
    assert labels == ["RandomSearch"] * 2


def test_the_package_keeps_the_contract(source: Path, tmp_path: Path) -> None:
    script = f"import pytest; raise SystemExit(pytest.main(['-q', '{source}/test_mylab.py']))"
    done = elsewhere(tmp_path, script, source)
    assert done.returncode == 0 and "1 passed" in done.stdout, done.stdout


def test_a_module_that_a_worker_cannot_import_is_told_in_the_runs_record(tmp_path: Path) -> None:
    algorithm = Algorithm("hill", "tests.results_fakes:HillClimber")
    run = RunSpecification(
        "Hill", algorithm, "nmp/ViaPoints-v0", 1, 5, OneContext(), imports=("no_such_module",)
    )
    record = run_and_write(run, tmp_path, provenance()).record
    assert not record.finished
    assert "module 'no_such_module' of --import cannot be imported" in record.reason
    assert "Every worker process imports it" in record.reason and "PYTHONPATH" in record.reason


def test_a_suite_of_another_package_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "lab_suites.py").write_text(
        "from results.algorithms import GA\n"
        "from results.harness.suite import Recipe\n"
        "from results.one_context.protocol import OneContext\n"
        "from results.suites import register_suite\n"
        "task = {'nmp/ViaPoints-v0': {'n_points': 2}}\n"
        "register_suite('lab', Recipe({'GA': GA}, task, 20, 2, (OneContext(),)))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    asked = ["run", "--suite", "lab", "--workers", "2", "--out", str(tmp_path / "runs")]
    assert main(asked) == 2
    assert "no suite 'lab' is registered" in capsys.readouterr().err
    monkeypatch.setattr("results.suites._REGISTERED", {})
    assert main([*asked, "--import", "lab_suites"]) == 0
    runs = read_records(tmp_path / "runs").records
    assert [each.finished for each in runs] == [True, True]
    assert find_recipe("lab", ["lab_suites"]).imports == ("lab_suites",)


def test_a_module_that_breaks_when_imported_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "breaking_lab.py").write_text("raise ZeroDivisionError('no licence')\n")
    monkeypatch.syspath_prepend(tmp_path)
    asked = ["run", "--task", "nmp/ViaPoints-v0", "--algorithm", "ga", "--import", "breaking_lab"]
    assert main(asked) == 2
    assert "ZeroDivisionError: no licence" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--task", "mylab/Nothing-v0", "--algorithm", "ga"], "no task 'mylab/Nothing-v0'"),
        (["--task", "nmp/ViaPoints-v0"], "needs --algorithm"),
        (["--task", "nmp/ViaPoints-v0", "--algorithm", "nope"], "no algorithm 'nope'; it has"),
        (["--task", "nmp/ViaPoints-v0", "--algorithm", "a.b:C"], "'a.b:C' cannot be imported"),
        (["--algorithm", "ga"], "--algorithm goes with --task"),
        *(
            (["--task", "nmp/ViaPoints-v0", "--algorithm", path], message)
            for path, message in (
                ("os:system", "'os:system' is a builtin_function_or_method and no algorithm: that"),
                ("math:pi", "'math:pi' is a float and no algorithm"),
                ("sb3_nmp:ACNMPCritic", "is a class of another kind and no algorithm"),
                ("sb3_nmp:TrajectoryAlgorithm", "is an abstract class and no algorithm"),
                (":REPS", "':REPS' cannot be imported (ValueError: Empty module name)"),
            )
        ),
    ],
)
def test_wrong_usage_is_told(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_a_name_of_the_benchmark_and_of_another_package_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert find_algorithm("RCNMP").path == "sb3_nmp:RCNMP"
    theirs = {"rcnmp": "mylab.algos:Other", "other": "mylab.algos:Other"}
    monkeypatch.setattr("results.outside.outside_algorithms", lambda: theirs)
    assert find_algorithm("other").path == "mylab.algos:Other"
    with pytest.raises(BenchmarkError, match=r"its class, sb3_nmp:RCNMP or mylab\.algos:Other"):
        find_algorithm("rcnmp")
    with pytest.raises(BenchmarkError, match="module:Class"):
        find_algorithm("results.cli:Nothing").load()
