"""``nmp-bench`` where things go wrong around it: killed, side by side, full disks, damage."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from results.cli import main
from results.exceptions import BenchmarkError
from results.harness import provenance as provenance_module
from results.harness.progress import run_with_progress
from results.harness.provenance import provenance
from results.harness.record_files import read_records
from results.harness.resume import alone_in, plan_runs
from tests.test_results_runner import do, run_of

ROOT = Path(__file__).parents[1]


def environment(**more: str) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(ROOT)} | more


def children(pid: int) -> list[int]:
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    return [int(each) for each in text.split()]


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait(until: object, seconds: float = 240) -> bool:
    assert callable(until)
    deadline = time.monotonic() + seconds
    while not until() and time.monotonic() < deadline:
        time.sleep(0.1)
    return bool(until())


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="children are read from /proc")
def test_workers_end_with_a_parent_that_was_killed(tmp_path: Path) -> None:
    script = (
        "import sys; from pathlib import Path\n"
        "from results.harness.resume import plan_runs\n"
        "from results.harness.progress import run_with_progress\n"
        "from tests.test_results_runner import run_of\n"
        "runs = [run_of(0, budget=2), run_of(1, budget=10**6), run_of(2, budget=10**6)]\n"
        "run_with_progress(plan_runs(Path(sys.argv[1]), runs), 2)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path)], env=environment(),
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    workers: list[int] = []
    try:
        has_begun = wait(lambda: list(tmp_path.glob("*.json")))
        workers = children(process.pid)
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert has_begun and len(workers) >= 2
        assert wait(lambda: not any(is_alive(worker) for worker in workers))
    finally:
        for worker in filter(is_alive, workers):
            os.kill(worker, signal.SIGKILL)


def test_one_process_at_a_time_does_runs_in_a_folder(tmp_path: Path) -> None:
    with alone_in(tmp_path), pytest.raises(BenchmarkError, match=r"another process does .*--out"):
        do(tmp_path, run_of(0))
    assert do(tmp_path, run_of(0)) == 0
    assert [path.name for path in tmp_path.iterdir()] == [f"{run_of(0).stem}.json"]


def test_a_full_disk_is_told_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "runs/x.json")

    monkeypatch.setattr("results.harness.runner.write_record", full)
    arguments = ["run", "--suite", "quick", "--algorithms", "ga", "--seeds", "1", "--budget", "5"]
    assert main([*arguments, "--workers", "1", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == "nmp-bench: No space left on device ('runs/x.json').\n"


LIMITED = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (900, 900))
from pathlib import Path
from results.harness.record_files import write_record
from tests.records_fakes import curve_of, finished_run, specification
run = finished_run(specification("A", 0), curve_of([-1.0] * 99, [False] * 99))
write_record(Path(sys.argv[1]), run)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits the size of a file by Linux's means")
def test_a_record_that_the_disk_cannot_hold_leaves_no_part_of_it(tmp_path: Path) -> None:
    """The write itself fails in its middle, as on a full disk."""
    path = tmp_path / "run.json"
    path.write_text("what was there")
    command = [sys.executable, "-c", LIMITED, str(path)]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True)
    assert done.returncode == 1 and "File too large" in done.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["run.json"]
    assert path.read_text() == "what was there"


def test_a_worker_that_is_killed_ends_the_command_and_loses_no_finished_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As by the kernel, where memory runs out."""
    runs = [run_of(0, "Dying"), run_of(1, "Dying", budget=12)]
    assert do(tmp_path, *runs, workers=2) == 1
    told = capsys.readouterr().err
    assert "a worker process died (out of memory? then use fewer --workers)" in told
    assert "the same command does the rest" in told and "Traceback" not in told
    held = read_records(tmp_path)
    assert not held.unreadable and all(record.finished for record in held.records)
    assert f"{len(held.records)} of 2 runs are finished" in told
    assert do(tmp_path, *runs, workers=1) == 0
    assert [record.specification.seed for record in read_records(tmp_path).records] == [0, 1]


def test_a_folder_that_cannot_be_made_is_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    arguments = ["run", "--suite", "quick", "--algorithms", "ga", "--seeds", "1", "--budget", "5"]
    assert main([*arguments, "--out", str(tmp_path / "file" / "runs")]) == 2
    assert "Not a directory" in capsys.readouterr().err


def test_damaged_models_and_negative_seeds_are_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "model.zip").write_bytes(b"PK\x03\x04 cut short")
    out = ["--out", str(tmp_path / "x.gif")]
    assert main(["render", "nmp/Bottles-v0", "--model", str(tmp_path / "model.zip"), *out]) == 2
    assert "cannot be read as a model of RCNMP" in capsys.readouterr().err
    assert main(["render", "nmp/Bottles-v0", "--expert", "s", "--seed", "-1", *out]) == 2
    assert "--seed is -1; it must be 0 or more" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("specification", "label"), None, "label"),
        (("result", "measured", "curve"), {}, "a curve without rollouts"),
        (
            ("result", "measured", "curve"),
            {"rollouts": [1, 2], "reward": [0.0]},
            "columns of different lengths",
        ),
        (("result",), None, "without its finished part"),
    ],
)
def test_a_record_that_lacks_something_is_left_out_with_the_reason(
    path: tuple[str, ...], value: object, message: str, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    do(tmp_path, run_of(0), run_of(1))
    file = tmp_path / f"{run_of(0).stem}.json"
    record = json.loads(file.read_text())
    inner = record
    for key in path[:-1]:
        inner = inner[key]
    if value is None:
        del inner[path[-1]]
    else:
        inner[path[-1]] = value
    file.write_text(json.dumps(record))
    (why,) = read_records(tmp_path).unreadable.values()
    assert message in why and "Remove the file" in why
    assert run_with_progress(plan_runs(tmp_path, [run_of(0), run_of(1)]), 1) == 1
    told = capsys.readouterr()
    assert "1 of 2 runs are finished" in told.out and "1 of 2 runs are not done" in told.err
    assert main(["table", "--runs", str(tmp_path)]) == 0
    assert "left out" in capsys.readouterr().err


def test_a_wrong_renderer_is_told_in_one_line() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "results", *"render nmp/Bottles-v0 --expert s --out x.gif".split()],
        env=environment(MUJOCO_GL="foo"), capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 2
    assert "MUJOCO_GL: foo" in done.stderr and "Traceback" not in done.stderr
    assert "it must be egl (" in done.stderr and "osmesa (" in done.stderr
    assert "glfw (" in done.stderr and "RuntimeError" not in done.stderr


@pytest.mark.parametrize(
    ("backend", "message"),
    [
        ("foo", "MuJoCo cannot be imported with MUJOCO_GL: foo"),
        ("disable", "(MUJOCO_GL is disable): that switches MuJoCo's rendering off. Set"),
        ("glfw", "(MUJOCO_GL is glfw): there is no display. Set"),
    ],
)
def test_a_wrong_renderer_is_told_to_whoever_makes_an_environment(
    backend: str, message: str
) -> None:
    script = (
        "import gymnasium, benchmark_envs\n"
        "env = gymnasium.make('nmp/Bottles-v0', render_mode='rgb_array')\n"
        "env.reset(seed=0)\nenv.render()\n"
    )
    without = environment(MUJOCO_GL=backend)
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        without.pop(display, None)
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script], env=without, capture_output=True, text=True
    )
    told = done.stderr.strip().splitlines()[-1]
    assert told.startswith("benchmark_envs.exceptions.RenderingUnavailableError: "), done.stderr
    assert message in told


def test_a_copy_inside_another_repository_names_no_commit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copied = tmp_path / "vendor" / "results" / "harness" / "provenance.py"
    copied.parent.mkdir(parents=True)
    copied.write_text("")
    git = ["git", "-C", str(tmp_path), "-c", "user.name=x", "-c", "user.email=x@example.org"]
    for command in (["init", "-q"], ["add", "-A"], ["commit", "-q", "-m", "a stranger's"]):
        subprocess.run([*git, *command], check=True)
    monkeypatch.setattr(provenance_module, "__file__", str(copied))
    assert provenance().commit is None
    (tmp_path / "vendor" / "results").rename(tmp_path / "results")
    subprocess.run([*git, "add", "-A"], check=True)
    monkeypatch.setattr(
        provenance_module, "__file__", str(tmp_path / "results" / "harness" / "provenance.py")
    )
    assert provenance().commit is not None
