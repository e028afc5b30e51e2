"""What a row says of its origin: the commit, and what its algorithm learns from."""

import subprocess
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

import sb3_nmp
from results.harness import provenance as provenance_module
from results.harness.provenance import provenance
from results.harness.records import Provenance
from results.harness.specification import Algorithm
from results.leaderboard.boards import BOARDS, DATA
from results.leaderboard.commits import about_commit, why_not_looked_up
from results.leaderboard.files import read_row, row_path, write_row
from results.leaderboard.rows import Row
from results.leaderboard.sees import UntoldError, about_sees, what_it_may_see
from results.leaderboard.verify import verify_row
from results.stream.protocol import Stream

# -- commits -----------------------------------------------------------------------------------


@pytest.fixture
def history(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """A repository that is this project's, with one commit; call it with git's arguments."""
    tracked = tmp_path / "own/results/harness/provenance.py"
    tracked.parent.mkdir(parents=True)
    tracked.write_text("")
    monkeypatch.setattr(provenance_module, "__file__", str(tracked))

    def git(*arguments: str) -> str:
        who = ["-c", "user.name=x", "-c", "user.email=x@example.org"]
        command = ["git", "-C", str(tmp_path / "own"), *who, *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    git("init", "-q", "-b", "main")
    git("add", "-A")
    git("commit", "-q", "-m", "one")
    return git


def origin(commit: str | None, minutes: float = 0.0) -> Provenance:
    started = datetime.now(UTC) + timedelta(minutes=minutes)
    return Provenance(commit, False, {}, "", "", started.isoformat(timespec="seconds"))


def test_a_commit_that_leads_to_head_is_believed(history: Callable[..., str]) -> None:
    first = history("rev-parse", "HEAD")
    history("commit", "-q", "--allow-empty", "-m", "two")
    for commit in (first, first[:10], history("rev-parse", "HEAD")):
        assert not why_not_looked_up(origin(commit))
        assert list(about_commit(origin(commit))) == []


def test_a_commit_that_is_none_or_of_another_branch_is_not(history: Callable[..., str]) -> None:
    history("checkout", "-q", "-b", "other")
    history("commit", "-q", "--allow-empty", "-m", "aside")
    aside, tree = history("rev-parse", "HEAD"), history("rev-parse", "HEAD^{tree}")
    history("checkout", "-q", "main")
    for commit, why in (
        (aside, "none of those that lead to HEAD"),
        (tree, "none of those that lead to HEAD"),
        ("f" * 40, "none of those that lead to HEAD"),
        ("HEAD", "'HEAD', and one has 40"),
        ("F" * 40, "and one has 40"),
        ("--help", "and one has 40"),
        (None, "names no commit"),
    ):
        (told,) = about_commit(origin(commit))
        assert why in told


def test_runs_do_not_begin_before_their_commit(history: Callable[..., str]) -> None:
    commit = history("rev-parse", "HEAD")
    assert list(about_commit(origin(commit, minutes=-5))) == []  # of two clocks
    (told,) = about_commit(origin(commit, minutes=-20))
    assert "before there was its commit" in told
    (told,) = about_commit(replace(origin(commit), started="yesterday"))
    assert "'yesterday', which is no date" in told


def test_a_shallow_clone_says_what_it_cannot_tell(
    history: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = history("rev-parse", "HEAD")
    history("commit", "-q", "--allow-empty", "-m", "two")
    last = history("rev-parse", "HEAD")
    clone = ["clone", "-q", "--depth=1", f"file://{tmp_path}/own", str(tmp_path / "clone")]
    subprocess.run(["git", *clone], check=True)
    here = tmp_path / "clone/results/harness/provenance.py"
    monkeypatch.setattr(provenance_module, "__file__", str(here))
    assert why_not_looked_up(origin(last)) == ""
    assert "shallow clone" in why_not_looked_up(origin(first))
    assert list(about_commit(origin(first))) == list(about_commit(origin(None))) == []
    (told,) = about_commit(origin("c0ffee"))
    assert "one has 40" in told


def test_a_copy_without_git_says_so_and_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # other versions of MuJoCo give other rewards; that the pinned ones give none is another test
    simulated = verify_row(row_path(DATA, "bottles", "GA")).problems
    monkeypatch.setattr(provenance_module, "git", lambda *_: None)
    for commit in (None, "f" * 40):
        assert "no git history" in why_not_looked_up(origin(commit))
        assert list(about_commit(origin(commit))) == []
    verdict = verify_row(row_path(DATA, "bottles", "GA"))
    assert verdict.problems == simulated
    assert [told for told in verdict.unchecked if "no git history" in told] == verdict.unchecked


# -- what an algorithm learns from -------------------------------------------------------------


def committed(board: str, label: str) -> Row:
    return read_row(row_path(DATA, board, label))[0]


def problems(row: Row, **changed: Any) -> list[str]:
    run = BOARDS[row.board].runs(row.board, [row.label], 1)[0]
    return list(about_sees(replace(row, **changed), run))


@pytest.mark.parametrize(
    ("board", "label", "sees"),
    [
        ("push-beyond", "ACNMP, sum alone", "achieved contexts, demonstrations, reward, success"),
        ("push-beyond", "twin, nearest", "demonstrations, reward, success"),
        ("push-beyond", "twin, nearest", "achieved contexts, demonstrations, success, terms"),
        ("push-beyond", "RC-NMP", "achieved contexts, demonstrations, reward, success"),
        ("push-beyond", "ACNMP, network drives", "demonstrations, reward, success, terms"),
        ("push-beyond", "CMA-ES context", "reward, success"),
        ("bottles", "SAC", "reward, success"),
        ("random-bottles", "RC-NMP", "achieved contexts, success"),
        ("aperture", "ACNMP", "achieved contexts, demonstrations, reward, success, terms"),
        ("bottles", "GA", "success, reward"),  # the order is the alphabet's
    ],
)
def test_a_forged_source_is_told(board: str, label: str, sees: str) -> None:
    row = committed(board, label)
    assert problems(row) == []
    (told,) = problems(row, sees=tuple(sees.split(", ")))
    assert f"but '{label}' learns from" in told


def test_whether_runs_aimed_is_left_open() -> None:
    """No more than a run tells; that one aimed in none of many is possible."""
    row = committed("push-beyond", "twin, nearest")
    assert row.sees is not None and "achieved contexts" in row.sees
    assert problems(row, sees=tuple(each for each in row.sees if each != "achieved contexts")) == []


def test_a_search_over_contexts_may_learn_from_achieved_ones_instead_of_the_reward() -> None:
    (run, *_) = BOARDS["random-bottles"].runs("random-bottles", ["RC-NMP"], 1)
    pushing = replace(run, task="nmp/Push-v0", task_settings={})
    told = {frozenset(each or ()) for each in what_it_may_see(pushing)}
    known, achieved = frozenset({"reward", "success"}), "achieved contexts"
    assert told == {known, known | {achieved}, frozenset({"success", achieved})}
    shown = replace(pushing, protocol=Stream(n_demonstrations=2))
    assert what_it_may_see(shown) == [known | {"demonstrations"}]
    blind = replace(pushing, algorithm=replace(run.algorithm, settings={"relabel": False}))
    assert what_it_may_see(blind) == [known]


def test_an_algorithm_that_cannot_be_imported_is_told_and_no_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = BOARDS["bottles"].runs("bottles", ["GA"], 1)[0]
    for path in ("no_such_package:GA", "baselines:NoSuchClass"):
        lost = replace(run, algorithm=Algorithm("ga", path))
        with pytest.raises(UntoldError, match="cannot be imported"):
            what_it_may_see(lost)

    def missing(*_: object, **__: object) -> None:
        raise sb3_nmp.ConfigurationError("GA needs a package that is not installed")

    row, evidence, _ = read_row(row_path(DATA, "bottles", "GA"))
    path = write_row(tmp_path, row, evidence)
    simulated = verify_row(path).problems
    monkeypatch.setattr("baselines.GA.__init__", missing)
    verdict = verify_row(path)
    assert verdict.problems == simulated
    assert "GA needs a package" in verdict.unchecked[-1]


def test_changes_are_unknown_where_git_does_not_tell(monkeypatch: pytest.MonkeyPatch) -> None:
    """A status that takes too long, or fails, is no clean one."""
    monkeypatch.setattr(provenance_module, "is_own_repository", lambda: True)
    answers = {("rev-parse", "HEAD"): "c" * 40}
    monkeypatch.setattr(provenance_module, "git", lambda *asked: answers.get(asked))
    assert provenance().dirty is None
    for told, dirty in (("", False), (" M sb3_nmp/agent.py", True)):
        answers["status", "--porcelain"] = told
        assert provenance().dirty is dirty


def test_every_committed_row_can_be_looked_up_in_a_full_clone() -> None:
    if provenance().commit is None:
        pytest.skip("this copy has no history")
    if provenance_module.git("rev-parse", "--is-shallow-repository") == "true":
        pytest.skip("this clone is shallow")
    assert why_not_looked_up(committed("bottles", "GA").provenance) == ""
