"""A command that is killed and started again leaves the files of one that never was."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from results.harness.record_files import read_records, write_record
from results.leaderboard.boards import BOARDS
from results.leaderboard.files import digest, read_row, row_paths
from results.leaderboard.verify import verify_row
from tests.test_leaderboard import HILLS, command

# -- at every change of a file -----------------------------------------------------------------


class Killed(BaseException):
    """The process is no more."""


def killed_before(patch: pytest.MonkeyPatch, n_changes: int) -> None:
    """Let no file change any more from one change on, of which half is written if it writes.

    What clears up after an exception changes nothing either, as in a process that was killed.

    :param n_changes: so many happen
    """
    left = [n_changes]
    patch.setattr(os, "getpid", lambda: 10**7 + n_changes)  # the next process has another one

    def mortal(kind: Any, name: str) -> None:
        change = getattr(kind, name)

        def counted(*arguments: Any, **keywords: Any) -> Any:
            left[0] -= 1
            if left[0] >= 0:
                return change(*arguments, **keywords)
            if left[0] == -1 and name.startswith("write"):
                path, content = arguments[:2]
                with open(path, "wb" if name == "write_bytes" else "w") as file:
                    file.write(content[: len(content) // 2])
            raise Killed

        patch.setattr(kind, name, counted)

    mortal(os, "replace")
    for name in ("write_bytes", "write_text", "unlink", "mkdir", "rename", "replace"):
        mortal(Path, name)


def killed_everywhere(do: Callable[[], object]) -> Iterator[int]:
    """Kill what is done before each of its changes in turn, until none is left; yield each time.

    :param do: it
    """
    for n_changes in range(100):
        with pytest.MonkeyPatch.context() as patch:
            killed_before(patch, n_changes)
            try:
                do()
            except Killed:
                pass
            else:
                return
        yield n_changes
    raise AssertionError("it changes files again and again")


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Rows of a board of two short runs, and its runs."""
    folder = tmp_path_factory.mktemp("killed")
    short = replace(HILLS, recipe=replace(HILLS.recipe, budget=10), seeds=(500, 501))
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(BOARDS, "hills", short)
        assert update(folder, folder / "runs") == 0
        yield folder


def update(folder: Path, runs: Path) -> int:
    return command("update", folder / "data", "--out", str(runs))


def test_a_record_is_written_whole_or_not_at_all(made: Path, tmp_path: Path) -> None:
    record = read_records(made / "runs/hills").records[0]
    path = tmp_path / f"{record.specification.stem}.json"
    kills = []
    for n_changes in killed_everywhere(lambda: write_record(path, record)):
        kills.append(n_changes)
        held = read_records(tmp_path)
        assert held.unreadable == {}
        assert held.records in ([], [record])
        write_record(path, record)
        assert list(contents(tmp_path)) == [path.name]
        path.unlink()
    assert len(kills) >= 2  # at least a temporary file is written, and renamed


@pytest.mark.parametrize("is_new", [True, False], ids=["new", "over an old one"])
def test_a_row_killed_anywhere_is_mended_by_the_same_command(
    made: Path, tmp_path: Path, is_new: bool
) -> None:
    page, rows = tmp_path / "data/README.md", tmp_path / "data/hills"
    kills = []
    for n_changes in killed_everywhere(lambda: update(tmp_path, made / "runs")):
        kills.append(n_changes)
        if page.exists():
            assert page.read_text() in ("old", (made / "data/README.md").read_text())
        assert update(tmp_path, made / "runs") == 0
        assert contents(tmp_path / "data") == contents(made / "data")
        assert verify_row(rows / "hill.json").problems == []
        for path in (*rows.iterdir(), page):
            path.unlink() if is_new else path.write_text("old")
    assert len(kills) >= 6  # three files are written, and renamed


# -- at random moments -------------------------------------------------------------------------

ROOT = Path(__file__).parents[1]
N_KILLS = 10
#: share of the files until which it is killed, so that it never ends before
LAST = 0.85


def start(arguments: list[str], folder: Path) -> "subprocess.Popen[str]":
    """Start a command in a process group of its own, outside of any repository.

    :param arguments: of ``nmp-bench``
    :param folder: where its temporary files are
    """
    environment = os.environ | {
        "PYTHONPATH": str(ROOT),
        "PYTHONUNBUFFERED": "1",  # what it has said is known when it is killed
        "GIT_DIR": os.devnull,  # the working tree may change while the test runs
        "OMP_NUM_THREADS": "1",
        "TMPDIR": str(folder),
    }
    return subprocess.Popen(
        [sys.executable, "-m", "results", *arguments],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True,
    )  # fmt: skip


def at_its_end(process: "subprocess.Popen[str]") -> list[str]:
    told, _ = process.communicate(timeout=900)
    assert process.returncode == 0, told
    return told.splitlines()


def files(folder: Path) -> dict[Path, tuple[int, int]]:
    """The finished files, and what changes when one is written again."""
    found = {}
    for path in folder.rglob("*"):
        if path.is_file() and not path.name.startswith("."):
            found[path] = (path.stat().st_ino, path.stat().st_mtime_ns)
    return found


def killed(
    arguments: list[str], folder: Path, temporary: Path, share: float, delay: float, n_files: int
) -> list[str]:
    """Start a command, kill its whole process group, and return what it had said.

    :param share: of the files, from which on it is killed
    :param delay: after that, in s
    :param n_files: that it makes in the end
    """
    process = start(arguments, temporary)
    while len(files(folder)) < int(share * n_files) and process.poll() is None:
        time.sleep(0.01)
    time.sleep(delay)
    assert process.poll() is None, "it has ended before it was killed"
    os.killpg(process.pid, signal.SIGKILL)
    return process.communicate()[0].splitlines()


def without_time(path: Path) -> Any:
    """What a file holds, but how long it took, when, and the digest over that."""
    if path.suffix != ".json":
        return path.read_bytes()
    content = json.loads(path.read_text())
    if "digest" in content:
        row, evidence, told = read_row(path)
        assert digest(row, evidence) == told
        del content["digest"], content["row"]["provenance"]["started"]
    else:
        del content["result"]["seconds"], content["provenance"]["started"]
    return content


def check_kills(command: Callable[[Path], list[str]], tmp_path: Path, seed: int) -> list[Path]:
    """Kill a command at ten moments, and compare it with one that was not.

    :param command: its arguments for a folder
    :param seed: of the moments
    :return: both folders
    """
    whole, broken, temporary = (tmp_path / name for name in ("whole", "broken", "temporary"))
    for folder in (whole, broken, temporary):
        folder.mkdir()
    told = at_its_end(start(command(whole), temporary))
    wanted = files(whole)
    runs = {line for line in told if " on nmp/" in line}
    rng = np.random.default_rng(seed)
    said: list[str] = []
    for share in np.sort(rng.uniform(0.0, LAST, N_KILLS)):
        before = files(broken)
        said += killed(command(broken), broken, temporary, share, rng.uniform(), len(wanted))
        after = files(broken)
        assert {path: after[path] for path in before} == before  # none of them was made again
    before = {path: each for path, each in files(broken).items() if path.stem.count("_seed-")}
    said += at_its_end(start(command(broken), temporary))
    assert {path: files(broken)[path] for path in before} == before
    ended = [line for line in said if " on nmp/" in line]
    assert len(ended) == len(set(ended)) and set(ended) <= runs
    made = sorted(path.relative_to(broken) for path in broken.rglob("*"))
    assert made == sorted(path.relative_to(whole) for path in whole.rglob("*"))
    for path in made:
        if (broken / path).is_file():
            assert without_time(broken / path) == without_time(whole / path), path
    return [whole, broken]


@pytest.mark.slow
def test_a_runner_killed_ten_times_has_done_what_it_should(tmp_path: Path) -> None:
    def command(folder: Path) -> list[str]:
        asked = "run --suite via-points --algorithms REPS CMA-ES --seeds 3 --budget 100 --workers 2"
        return [*asked.split(), "--out", str(folder)]

    for folder in check_kills(command, tmp_path, seed=0):
        held = read_records(folder)
        assert held.unreadable == {}
        assert len(held.records) == 2 * 3 * 6 == len([*folder.iterdir()])


@pytest.mark.slow
def test_a_leaderboard_killed_ten_times_has_the_rows_that_it_should(tmp_path: Path) -> None:
    def command(folder: Path) -> list[str]:
        asked = "leaderboard update --board via-points --algorithms REPS GA --workers 2"
        return [*asked.split(), "--out", str(folder / "runs"), "--data", str(folder / "data")]

    for folder in check_kills(command, tmp_path, seed=1):
        assert [path.name for path in row_paths(folder / "data")] == ["ga.json", "reps.json"]
        for path in row_paths(folder / "data"):
            assert len(read_row(path)[0].claims) == 20
            assert verify_row(path).problems == []
