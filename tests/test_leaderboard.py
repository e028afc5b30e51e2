"""The leaderboard: rows are made once, forged ones are caught, worse programs raise the alarm."""

import errno
import json
import math
import os
import shlex
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from results.cli import main
from results.exceptions import BenchmarkError, RecordError
from results.harness import progress
from results.harness.provenance import is_own_repository
from results.harness.specification import Algorithm
from results.harness.suite import Recipe
from results.leaderboard import commands, exact, verify
from results.leaderboard.boards import BOARDS, DATA, Board, labels_on
from results.leaderboard.check import FALSE_ALARMS, MEASURES, judge
from results.leaderboard.files import digest, read_row, row_paths, write_row
from results.leaderboard.rows import Claim, Evidence, Row, mean_reward
from results.leaderboard.tables import page
from results.leaderboard.verify import (
    TOLERANCE,
    _about_claim_over_many,
    as_known_then,
    missing_rows,
    other_versions,
    verify_row,
)
from results.one_context.protocol import OneContext
from results.report.statistics import permutation_p
from results.stream.evaluation import N_KEPT
from results.stream.protocol import Stream
from results.suites import random_bottles
from tests import results_fakes

N_SEEDS = 10
HILLS = Board(
    "hills",
    Recipe(
        {"Hill": Algorithm("hill", "tests.results_fakes:HillClimber", {"sigma": 0.12})},
        {"nmp/ViaPoints-v0": {}},
        60,
        N_SEEDS,
        (OneContext(),),
        variants={"2 points": {"n_points": 2}},
    ),
    tuple(range(500, 500 + N_SEEDS)),
    n_checked=N_SEEDS,
)
#: over many contexts
ANYWHERE = Board(
    "hills anywhere",
    Recipe(
        {"nearest": random_bottles.ALGORITHMS["twin, nearest"]},
        {"nmp/Bottles-v0": {"random_bottles": True}},
        60,
        2,
        (Stream(0, 1000, 40, n_evaluations=3),),
    ),
    (500, 501),
    n_checked=2,
    most_failures=0.9,
)


@pytest.fixture(scope="module", autouse=True)
def hills() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(BOARDS, "hills", HILLS)
        patch.setitem(BOARDS, "anywhere", ANYWHERE)
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rows of the board, and its runs."""
    folder = tmp_path_factory.mktemp("leaderboard")
    assert update(folder) == 0
    return folder


def update(folder: Path) -> int:
    return command("update", folder / "data", "--out", str(folder / "runs"))


def command(what: str, data: Path, *more: str, board: str = "hills") -> int:
    asked = ["leaderboard", what, "--board", board, "--data", str(data), "--workers", "1"]
    return main([*asked, *more])


def the_row(data: Path) -> tuple[Row, Evidence]:
    (path,) = row_paths(data)
    return read_row(path)[:2]


def test_a_field_of_settings_that_came_later_is_not_asked_of_an_older_row() -> None:
    critic = {"settings": "acnmp-critic", "pull": 0.3, "new": True}
    asked = {"critic": critic, "size": 3}
    older = {key: value for key, value in critic.items() if key != "new"}
    for said, holds in (
        (asked, True),
        (asked | {"critic": older}, True),
        (asked | {"critic": older | {"pull": 0.1}}, False),
        (asked | {"critic": critic | {"other": 1}}, False),
        (asked | {"critic": {**older, "settings": "another"}}, False),
        ({"critic": critic}, False),  # an argument is told whole
    ):
        assert (as_known_then(asked, said) == said) == holds


def test_no_row_is_written_before_all_runs_are_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the runs of the second board would be of a changed tree, and of no commit."""
    few = replace(HILLS, recipe=replace(HILLS.recipe, budget=20), seeds=(500, 501))
    for name in ("one", "other"):
        monkeypatch.setitem(BOARDS, name, few)
    seen: list[int] = []
    run = progress.run_with_progress

    def watched(*asked: Any) -> int:
        done = run(*asked)
        seen.append(len(row_paths(tmp_path / "data")))
        return done

    monkeypatch.setattr(progress, "run_with_progress", watched)
    asked = ["leaderboard", "update", "--board", "one", "other", "--workers", "1"]
    assert main([*asked, "--data", str(tmp_path / "data"), "--out", str(tmp_path / "runs")]) == 0
    assert seen == [0, 0]
    assert len(row_paths(tmp_path / "data")) == 2


def test_the_same_command_again_skips_everything(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in sorted((made / "data").rglob("*.*"))}
    assert update(made) == 0
    assert f"{N_SEEDS} of {N_SEEDS} runs are finished" in capsys.readouterr().out
    assert {path: path.read_bytes() for path in sorted((made / "data").rglob("*.*"))} == before
    row, evidence = the_row(made / "data")
    assert 0 < row.solved < N_SEEDS  # else the forgeries below have nothing to forge
    assert len(evidence.solving) == row.solved
    assert f"| Hill | {N_SEEDS} | {row.solved}/{N_SEEDS} |" in (made / "data/README.md").read_text()


def test_runs_that_may_not_be_mixed_are_done_again_as_the_message_says(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One run of another commit: update refuses the row, names a command, and that one mends it."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    path = next((tmp_path / "runs/hills").glob("*.json"))
    path.write_text(path.read_text().replace('"commit": ', '"commit": "c0ffee", "old": ', 1))
    assert update(tmp_path) == 2
    told = capsys.readouterr().err
    asked = "nmp-bench leaderboard update --board hills --algorithms 'Hill' --overwrite"
    assert "differ in commit" in told and asked in told
    where = ["--data", str(tmp_path / "data"), "--out", str(tmp_path / "runs"), "--workers", "1"]
    assert main([*shlex.split(asked)[1:], *where]) == 0
    assert the_row(tmp_path / "data")[0].claims == the_row(made / "data")[0].claims


def test_the_first_row_of_all_that_fails_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = {"Hill": Algorithm("hill", "tests.results_fakes:Broken")}
    recipe = replace(HILLS.recipe, algorithms=broken, budget=10)
    monkeypatch.setitem(BOARDS, "hills", replace(HILLS, recipe=recipe, seeds=(500, 501)))
    assert update(tmp_path) == 1
    told = capsys.readouterr().err
    assert "1 of 2 runs failed" in told and "no row" in told and "No such file" not in told
    assert not (tmp_path / "data").exists()


def test_rows_that_are_named_are_those_of_the_boards_that_have_them(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["--board", "bottles", "hills", "--algorithms", "hill", "--workers", "1"]
    asked += ["--out", str(made / "runs"), "--data"]
    for what, told in (
        ("show", "Hill"),
        ("verify", "hills/hill: holds"),
        ("update", f"{N_SEEDS} of {N_SEEDS} runs are finished"),
    ):
        assert main(["leaderboard", what, *asked, str(made / "data")]) == 0
        assert told in capsys.readouterr().out
    assert main(["leaderboard", "update", *asked, str(tmp_path)]) == 0
    assert [path.parent.name for path in row_paths(tmp_path)] == ["hills"]
    shown = ["leaderboard", "show", "--algorithms", "ACNMP", "--data", str(DATA)]
    assert main(shown) == 0
    told = capsys.readouterr().out
    assert "push" in told and "ACNMP" in told and "two bottles, from nothing" not in told


def test_an_honest_row_holds(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command("verify", made / "data") == 0
    assert "hills/hill: holds (bitwise)" in capsys.readouterr().out


@pytest.mark.parametrize(
    "path", row_paths(DATA), ids=lambda path: f"{path.parent.name}/{path.stem}"
)
def test_every_committed_row_holds(path: Path) -> None:
    if versions := other_versions(read_row(path)[0]):
        pytest.skip(f"the row was made with {versions}; others may give other rewards")
    assert verify_row(path).problems == []


def test_every_board_has_the_rows_that_it_asks_for() -> None:
    committed = {name: board for name, board in BOARDS.items() if (DATA / name).exists()}
    assert len(committed) >= 7
    assert missing_rows(DATA, labels_on(committed)) == []


def test_a_row_that_was_taken_away_is_missed(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = replace(
        HILLS.recipe, algorithms={**HILLS.recipe.algorithms, "GA": Algorithm("ga", "baselines:GA")}
    )
    write_row(tmp_path, *the_row(made / "data"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(BOARDS, "hills", replace(HILLS, recipe=more))
        assert command("verify", tmp_path) == 1
        told = capsys.readouterr()
        assert "asks for a row 'GA'" in told.err and "hills/hill: holds" in told.out
        assert command("verify", tmp_path, "--algorithms", "Hill") == 0
        assert command("verify", tmp_path, "--algorithms", "GA", "Hill") == 1
        assert "asks for a row 'GA'" in capsys.readouterr().err


def changed_claim(row: Row, index: int, **entries: object) -> Row:
    claims = list(row.claims)
    claims[index] = replace(claims[index], **entries)  # type: ignore[arg-type]
    return replace(row, claims=tuple(claims))


def of(row: Row, success: bool) -> int:
    return next(i for i, claim in enumerate(row.claims) if claim.success == success)


def a_reward_one_bit_better(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return changed_claim(row, 0, reward=float(np.nextafter(row.claims[0].reward, 1.0))), evidence


def a_success_that_was_none(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    i = of(row, False)
    claim = {"success": True, "rollouts": 10.0, "solving_reward": row.claims[i].reward}
    place = sum(each.success for each in row.claims[:i])
    solving = np.insert(evidence.solving, place, evidence.final[i], axis=0)
    return changed_claim(row, i, **claim), replace(evidence, solving=solving)


def the_trajectory_of_another_run(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return row, replace(evidence, final=evidence.final[[1, 0, *range(2, N_SEEDS)]])


def a_trajectory_beside_the_true_one(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    final = evidence.final.copy()
    final[0] = np.nextafter(final[0], np.float32(9.0))
    return row, replace(evidence, final=final)


def an_easier_context(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    contexts = evidence.contexts.copy()
    contexts[0] = contexts[1]
    return row, replace(evidence, contexts=contexts)


def a_run_left_out(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    worst = of(row, False)
    kept = [i for i in range(N_SEEDS) if i != worst]
    claims = tuple(row.claims[i] for i in kept)
    rest = replace(evidence, contexts=evidence.contexts[kept], final=evidence.final[kept])
    return replace(row, claims=claims), rest


def the_best_run_twice(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return replace(row, claims=(*row.claims[:-1], row.claims[of(row, True)])), evidence


def a_share_that_fails_in_one_context(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return changed_claim(row, 0, failure_rate=0.0, kept_rewards=(5.0,)), evidence


def another_budget(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return replace(row, budget=30), evidence


def other_settings(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return replace(row, settings={"sigma": 0.2}), evidence


def another_description(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return replace(row, description="the best of 9 trials"), evidence


def a_negative_count(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return changed_claim(row, of(row, True), rollouts=-5.0), evidence


def a_failure_as_the_solving_one(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    solving = evidence.solving.copy()
    solving[0] = evidence.final[of(row, False)]
    return row, replace(evidence, solving=solving)


def a_success_left_out(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return changed_claim(row, of(row, True), solving_reward=None), replace(
        evidence, solving=evidence.solving[1:]
    )


def a_study_that_there_was_not(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return replace(row, n_trials=20), evidence


def nothing_seen(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return replace(row, sees=None), evidence


def less_seen(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return replace(row, sees=("success",)), evidence


def more_seen(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return replace(row, sees=("achieved contexts", "reward")), evidence


def of_commit(row: Row, commit: str | None) -> Row:
    return replace(row, provenance=replace(row.provenance, commit=commit))


def a_commit_too_short(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return of_commit(row, "c0ffee"), evidence


def a_commit_of_nowhere(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return of_commit(row, "c0ffee" + 34 * "0"), evidence


def no_commit(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return of_commit(row, None), evidence


def runs_before_their_commit(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    early = replace(row.provenance, started="2001-01-01T00:00:00+00:00")
    return replace(row, provenance=early), evidence


Forgery = Callable[[Row, Evidence], tuple[Row, Evidence]]
#: which only the history of a repository tells
OF_HISTORY: set[Forgery] = {a_commit_of_nowhere, no_commit, runs_before_their_commit}
FORGERIES: dict[Forgery, str] = {
    a_reward_one_bit_better: "the final trajectory earns",
    a_success_that_was_none: "trajectory fails",
    the_trajectory_of_another_run: "the final trajectory earns",
    a_trajectory_beside_the_true_one: "the final trajectory earns",
    an_easier_context: "is in the context",
    a_run_left_out: "are not those of the board",
    the_best_run_twice: "counted twice",
    a_share_that_fails_in_one_context: "tells what many have",
    another_budget: "its budget is 30",
    other_settings: "its settings is",
    another_description: "its description is",
    a_negative_count: "took -5.0 rollouts",
    a_failure_as_the_solving_one: "the solving trajectory fails",
    a_success_left_out: "has no trajectory that tells since when",
    a_study_that_there_was_not: "its n_trials is 20, but the board asks for None",
    nothing_seen: "its sees is None, but 'Hill' learns from ['reward']",
    less_seen: "its sees is ['success'], but 'Hill' learns from ['reward']",
    more_seen: "its sees is ['achieved contexts', 'reward'], but",
    a_commit_too_short: "its commit is 'c0ffee', and one has 40 hexadecimal digits",
    a_commit_of_nowhere: "is none of those that lead to HEAD",
    no_commit: "it names no commit",
    runs_before_their_commit: "before there was its commit",
}


@pytest.mark.parametrize("forge", FORGERIES, ids=lambda forge: forge.__name__)
def test_a_forger_who_mends_the_digest_is_caught(
    made: Path, tmp_path: Path, forge: Forgery
) -> None:
    if forge in OF_HISTORY and not is_own_repository():
        pytest.skip("this copy has no history; `test_leaderboard_origin.py` has one of its own")
    path = write_row(tmp_path, *forge(*the_row(made / "data")))
    assert any(FORGERIES[forge] in problem for problem in verify_row(path).problems)
    assert command("verify", tmp_path) == 1


def test_a_row_tells_its_trials_whatever_its_description_says(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the algorithm by the records to the row, its file and the table."""
    from results.harness.record_files import read_records
    from results.leaderboard.rows import make_row

    untuned = replace(the_row(made / "data")[0], description="the best of 9 trials")
    assert "| – | – | R |" in page([untuned]).markdown()
    tuned = {"Hill": replace(HILLS.recipe.algorithms["Hill"], n_trials=7)}
    recipe = replace(HILLS.recipe, algorithms=tuned, budget=10)
    monkeypatch.setitem(BOARDS, "hills", replace(HILLS, recipe=recipe, seeds=(500, 501)))
    assert update(tmp_path) == 0
    row, _ = make_row("hills", read_records(tmp_path / "runs/hills").records)
    assert row.n_trials == the_row(tmp_path / "data")[0].n_trials == 7
    assert "| – | 7 | R |" in page([row]).markdown()
    assert command("verify", tmp_path / "data") == 0


def test_rows_from_before_trials_were_told_are_read_and_their_digests_fit(
    made: Path, tmp_path: Path
) -> None:
    row, evidence = the_row(made / "data")
    path = write_row(tmp_path, row, evidence)
    content = json.loads(path.read_text())
    del content["row"]["n_trials"]
    path.write_text(json.dumps(content))
    assert read_row(path)[0].n_trials is None
    assert verify_row(path).problems == []


def test_an_edited_count_does_not_fit_the_digest(made: Path, tmp_path: Path) -> None:
    """Simulation cannot tell after how many rollouts a trajectory was found; the digest can."""
    row, evidence = the_row(made / "data")
    path = write_row(tmp_path, row, evidence)
    edited = changed_claim(row, of(row, True), rollouts=1.0)
    assert digest(edited, evidence) != digest(row, evidence)
    content = json.loads(path.read_text()) | {"row": msgspec.to_builtins(edited)}
    path.write_text(json.dumps(content))
    assert ["digest" in problem for problem in verify_row(path).problems] == [True]


@pytest.mark.parametrize(
    ("damage", "why"),
    [
        (lambda path: path.with_suffix(".npz").unlink(), "restore both"),
        (lambda path: path.with_suffix(".npz").write_bytes(b"PK damaged"), "restore both"),
        (lambda path: path.write_text(path.read_text()[:-50]), "restore both"),
        (
            lambda path: path.write_text(path.read_text().replace('"format": 1', '"format": 7')),
            "format 7, and this version reads format 1",
        ),
        (
            lambda path: path.write_text('{"format": 7, "of": "another kind"}'),
            "format 7, and this version reads format 1",
        ),
        (
            lambda path: np.savez(path.with_suffix(".npz"), final=np.array([{}], object)),
            "restore both",
        ),
        (lambda path: np.savez(path.with_suffix(".npz"), final=np.zeros(3)), "single precision"),
    ],
)
def test_a_damaged_row_is_told_in_a_sentence(
    made: Path, tmp_path: Path, damage: Callable[[Path], object], why: str
) -> None:
    path = write_row(tmp_path, *the_row(made / "data"))
    damage(path)
    with pytest.raises(RecordError, match=why):
        read_row(path)
    assert [why in problem for problem in verify_row(path).problems] == [True]


@pytest.mark.parametrize("what", ["verify", "show"])
@pytest.mark.parametrize(
    ("broken", "why"),
    [
        (lambda row: replace(row, provenance=replace(row.provenance, packages={})), "of mujoco"),
        (lambda row: replace(row, claims=()), "has no claims"),
        (lambda row: replace(row, board="nope"), "says board 'nope'"),
    ],
)
def test_a_row_that_is_not_whole_is_told_in_a_sentence(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    what: str, broken: Callable[[Row], Row], why: str,
) -> None:  # fmt: skip
    row, evidence = the_row(made / "data")
    path = write_row(tmp_path, broken(row), evidence)
    path.parent.rename(tmp_path / row.board)
    capsys.readouterr()
    assert command(what, tmp_path) == (1 if what == "verify" else 2)
    assert why in capsys.readouterr().err


def test_a_full_disk_leaves_the_row_that_was_there(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row, evidence = the_row(made / "data")
    path = write_row(tmp_path, row, evidence)
    write = Path.write_bytes

    def full(self: Path, content: bytes) -> int:
        if ".json" in self.name:
            write(self, content[:100])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(self, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left"):
        write_row(tmp_path, row, replace(evidence, final=evidence.final + 1))
    assert sorted(each.name for each in path.parent.iterdir()) == ["hill.json", "hill.npz"]
    assert verify_row(path).problems == []


def test_another_cpu_is_allowed_a_tolerance(made: Path, tmp_path: Path) -> None:
    row, evidence = the_row(made / "data")
    assert row.provenance.machine is not None
    elsewhere = replace(row.provenance, machine=replace(row.provenance.machine, features=("VSX",)))
    honest = replace(row, provenance=elsewhere)
    for error, holds in ((0.0, True), (0.5 * TOLERANCE, True), (3 * TOLERANCE, False)):
        off = changed_claim(honest, 0, reward=honest.claims[0].reward + error)
        verdict = verify_row(write_row(tmp_path, off, evidence))
        assert "another kind of CPU" in verdict.how
        assert (verdict.problems == []) == holds
    packages = elsewhere.packages | {"mujoco": "1.0"}
    older = replace(honest, provenance=replace(elsewhere, packages=packages))
    assert "mujoco 1.0" in verify.comparison(older)[0]


def test_runs_of_two_programs_make_no_row(made: Path) -> None:
    from results.harness.record_files import read_records
    from results.leaderboard.rows import make_row

    records = read_records(made / "runs/hills").records
    other = replace(records[1], provenance=replace(records[1].provenance, commit="c0ffee"))
    with pytest.raises(BenchmarkError, match=r"differ in commit.*c0ffee.*--overwrite"):
        make_row("hills", [records[0], other, *records[2:]])


def test_a_row_tells_what_any_of_its_runs_saw(made: Path) -> None:
    from results.harness.record_files import read_records
    from results.leaderboard.rows import make_row

    first, *others = read_records(made / "runs/hills").records
    assert first.result is not None and first.result.sees is not None
    more = replace(first, result=replace(first.result, sees=(*first.result.sees, "terms")))
    for runs in ([more, *others], [*others, more]):
        row, _ = make_row("hills", runs)
        assert row.sees == tuple(sorted({*first.result.sees, "terms"}))


def test_the_mean_reward_holds_each_entry_until_the_next() -> None:
    assert mean_reward([5, 10, 30], [-9.0, -3.0, -1.0], 40) == (-9 * 5 - 3 * 20 - 1 * 10) / 35
    assert mean_reward([40], [-2.0], 40) == -2.0


# -- over many contexts ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def anywhere(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("anywhere")
    out = ("--out", str(folder / "runs"))
    assert command("update", folder / "data", *out, board="anywhere") == 0
    return folder / "data"


def test_a_row_over_many_contexts_is_made_shown_verified_and_checked(
    anywhere: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    row, evidence = the_row(anywhere)
    assert evidence.contexts.shape == (2, N_KEPT, 4)
    assert evidence.final.shape == (2, N_KEPT, 200, 2)
    assert evidence.solving.shape == (0, 200, 2)
    assert row.failure_rate is not None and 0 < row.failure_rate[0] < 1
    assert "solved with at most 90% failures" in (anywhere / "README.md").read_text()
    assert command("verify", anywhere, board="anywhere") == 0
    assert command("check", anywhere, board="anywhere") == 0
    told = capsys.readouterr().out
    assert "anywhere/nearest: holds (bitwise)" in told
    unchecked = replace(ANYWHERE, n_checked=0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(BOARDS, "anywhere", unchecked)
        assert command("check", anywhere, board="anywhere") == 0
    assert "no runs again, which take too long" in capsys.readouterr().out
    assert "anywhere, nearest: 1 runs again, the same to the bit" in told


def fewer_failures(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return changed_claim(row, 0, failure_rate=0.0), evidence


def fewer_kept_failures(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    n = row.claims[0].n_kept_failures
    return changed_claim(row, 0, n_kept_failures=n - 1), evidence


def a_kept_reward_one_bit_better(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    first, *others = row.claims[0].kept_rewards
    kept = (float(np.nextafter(first, 1.0)), *others)
    return changed_claim(row, 0, kept_rewards=kept, reward=float(np.mean(kept))), evidence


def a_better_mean(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return changed_claim(row, 0, reward=row.claims[0].reward + 0.1), evidence


def an_easier_kept_context(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    contexts = evidence.contexts.copy()
    contexts[0, 0] = contexts[0, 1]
    return row, replace(evidence, contexts=contexts)


def only_some_contexts(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    kept = row.claims[0].kept_rewards[:5]
    return changed_claim(row, 0, kept_rewards=kept, reward=float(np.mean(kept))), evidence


def no_success_in_spite_of_its_failures(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    i = of(row, True)
    return changed_claim(row, i, success=False, rollouts=None), evidence


def fewer_than_no_failures(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    return changed_claim(row, 0, failure_rate=-0.001), evidence


def a_trajectory_that_solves_one(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    forged = changed_claim(row, 0, solving_reward=-0.1)
    return forged, replace(evidence, solving=evidence.final[0, :1])


def fewer_demonstrations_than_there_were(row: Row, evidence: Evidence) -> tuple[Row, Evidence]:
    settings = row.protocol.settings | {"n_demonstrations": 1}
    return replace(row, protocol=replace(row.protocol, settings=settings)), evidence


OVER_MANY: dict[Forgery, str] = {
    fewer_than_no_failures: "which is none of 40 contexts",
    a_trajectory_that_solves_one: "tells a trajectory that solves one",
    fewer_demonstrations_than_there_were: "its protocol is",
    fewer_failures: "of the 25 kept ones do",
    fewer_kept_failures: "of the kept trajectories fail, not",
    a_kept_reward_one_bit_better: "the trajectory in kept context 0 earns",
    a_better_mean: "is not the mean of the kept ones",
    an_easier_kept_context: "is in the context",
    only_some_contexts: "tells 5 rewards",
    no_success_in_spite_of_its_failures: "says success False, but",
}


@pytest.mark.parametrize("forge", OVER_MANY, ids=lambda forge: forge.__name__)
def test_a_forger_of_a_row_over_many_contexts_is_caught(
    anywhere: Path, tmp_path: Path, forge: Forgery
) -> None:
    path = write_row(tmp_path, *forge(*the_row(anywhere)))
    assert any(OVER_MANY[forge] in problem for problem in verify_row(path).problems)


def test_a_share_that_the_kept_contexts_make_incredible_is_not_believed() -> None:
    """Twenty of a thousand contexts may fail, but then not seven of the first 25."""
    rewards = (-1.0,) * N_KEPT
    claim = Claim(0, "", None, 9.0, -1.0, True, None, -2.0, 0.02, rewards, 7)
    (told,) = _about_claim_over_many(claim, 1000, 0.02)
    assert "that 2.0% of 1000 contexts fail, but 7 of the 25 kept ones do" in told
    for n_kept in (0, 1, 2, 5):
        assert not [*_about_claim_over_many(replace(claim, n_kept_failures=n_kept), 1000, 0.02)]


# -- check -------------------------------------------------------------------------------------


def test_an_unchanged_program_gives_the_same_bits(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command("check", made / "data") == 0
    assert "hills, Hill: 1 runs again, the same to the bit" in capsys.readouterr().out


def test_a_worse_program_raises_the_alarm(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    keep_the_worst(monkeypatch)
    assert command("check", made / "data") == 1
    assert "WORSE" in capsys.readouterr().out


def keep_the_worst(patch: pytest.MonkeyPatch) -> None:
    learn = results_fakes.HillClimber._end_generation

    def worst_kept(self: results_fakes.HillClimber, generation: object) -> None:
        learn(self, replace(generation, rewards=-generation.rewards))  # type: ignore[attr-defined, type-var]

    patch.setattr(results_fakes.HillClimber, "_end_generation", worst_kept)


def wrong_sign_of_what_a_skill_learns(patch: pytest.MonkeyPatch) -> None:
    """Each rollout is learned as one that went round the other side."""
    import sb3_nmp.common.skill_search as module

    made = module.Experience

    def mirrored(contexts: Any, weights: Any, *told: Any) -> Any:
        return made(contexts, -weights, *told)

    patch.setattr(module, "Experience", mirrored)


def test_a_check_begins_with_one_run_and_goes_on_where_its_bits_are_others(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command("check", made / "data") == 0
    assert "hills, Hill: 1 runs again, the same to the bit" in capsys.readouterr().out
    keep_the_worst(monkeypatch)
    assert command("check", made / "data") == 1
    assert f"hills, Hill: {N_SEEDS} runs again, WORSE" in capsys.readouterr().out
    monkeypatch.setitem(BOARDS, "hills", replace(HILLS, too_slow=frozenset({"Hill"})))
    assert command("check", made / "data") == 0
    assert "hills, Hill: no runs again, which take too long" in capsys.readouterr().out


def test_a_check_begins_with_the_first_run_of_each_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not with a whole seed, which on pouring are three runs."""
    done: list[list[str]] = []

    def noted(_: object, runs: Any, __: object) -> Iterator[tuple[tuple[str, str], list[Claim]]]:
        asked = [run for each in runs.values() for run in each]
        done.append([f"{run.label}, {run.seed}, {run.protocol.number}" for run in asked])
        return ((key, []) for key in runs)

    monkeypatch.setattr(commands, "_claims_again", noted)
    monkeypatch.setattr(exact, "unlike", lambda _: "")
    paths = row_paths(DATA, "pouring")
    assert len(list(commands.judgements(BOARDS, paths, 1))) == len(paths)
    first, more = done
    assert len({*first}) == len(paths) and all(each.endswith(", 300, 0") for each in first)
    assert more == []


def test_a_change_that_makes_nothing_worse_costs_runs_and_no_alarm(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    propose = results_fakes.HillClimber._propose

    def a_little_farther(self: results_fakes.HillClimber, *asked: Any) -> Any:
        return propose(self, *asked) * (1 + 1e-6)

    monkeypatch.setattr(results_fakes.HillClimber, "_propose", a_little_farther)
    assert command("check", made / "data") == 0
    assert f"hills, Hill: {N_SEEDS} runs again, no worse" in capsys.readouterr().out


def test_a_regression_over_many_contexts_raises_the_alarm(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seeds = tuple(range(500, 510))
    board = replace(ANYWHERE, seeds=seeds, n_checked=len(seeds))
    monkeypatch.setitem(BOARDS, "anywhere", board)
    out = ("--out", str(tmp_path / "runs"))
    assert command("update", tmp_path / "data", *out, board="anywhere") == 0
    assert command("check", tmp_path / "data", board="anywhere") == 0
    assert "1 runs again, the same to the bit" in capsys.readouterr().out
    wrong_sign_of_what_a_skill_learns(monkeypatch)
    assert command("check", tmp_path / "data", board="anywhere") == 1
    assert "10 runs again, WORSE in final reward" in capsys.readouterr().out


def test_every_board_does_runs_again() -> None:
    for name, board in BOARDS.items():
        again = [board.n_again(label) for label in board.labels]
        assert {*again} <= {0, board.n_checked} and max(again) > 0, name
        assert board.too_slow <= {*board.labels}, name


def test_one_run_tells_any_change_to_the_bit(
    made: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also one that no statistic of ten runs would tell, such as a scale that is 1e-6 larger."""
    assert command("check", made / "data", "--exact") == 0
    assert "hills, Hill: 1 runs again, the same to the bit" in capsys.readouterr().out
    propose = results_fakes.HillClimber._propose

    def a_little_farther(self: results_fakes.HillClimber, *asked: Any) -> Any:
        return propose(self, *asked) * (1 + 1e-6)

    monkeypatch.setattr(results_fakes.HillClimber, "_propose", a_little_farther)
    assert command("check", made / "data", "--exact") == 1
    told = capsys.readouterr().out
    assert "CHANGED: seed 500, 2 points ends at" in told
    assert "--algorithms 'Hill' --overwrite" in told


def test_bits_of_other_machines_are_not_compared(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    row, evidence = the_row(made / "data")
    elsewhere = replace(row.provenance, packages=row.provenance.packages | {"torch": "1.0"})
    made_there = replace(row, provenance=elsewhere)
    write_row(tmp_path, changed_claim(made_there, 0, mean_reward=9.0), evidence)
    assert command("check", tmp_path, "--exact") == 0
    assert "not compared: the row was made with torch 1.0 (here" in capsys.readouterr().out
    write_row(tmp_path, made_there, evidence)
    assert command("check", tmp_path) == 0
    assert f"{N_SEEDS} runs again, the same" in capsys.readouterr().out, "all of them at once"


def a_row(rng: np.random.Generator, n: int, first_seed: int = 0) -> tuple[Row, Evidence]:
    """A row of one fixed context, whose three measures hang together as those of runs do."""
    quality = rng.normal(size=n)
    claims = tuple(
        Claim(first_seed + i, "", None, *_outcome(q, rng)) for i, q in enumerate(quality)
    )
    row = Row("bottles", "A", "", "a", {}, "t", None, 200, None, None, claims)  # type: ignore[arg-type]
    nothing = np.zeros((n, 1), np.float32)
    return row, Evidence(nothing, nothing, nothing)


def _outcome(q: float, rng: np.random.Generator) -> tuple:
    reward, rollouts = q + 0.5 * rng.normal(), float(round(20 * np.exp(-q)))
    return None if rollouts > 60 else rollouts, reward, rollouts <= 60, None, q + rng.normal()


def test_false_alarms_are_bounded_and_simulated() -> None:
    """The bound is computed for any level; a higher one shows in fewer boards that it holds."""
    rng, level, n_boards, n_rows = np.random.default_rng(0), 0.1, 60, 3
    alarms = 0
    for _ in range(n_boards):
        for _ in range(n_rows):
            row, evidence = a_row(rng, 20)
            again = [replace(c, seed=i) for i, c in enumerate(a_row(rng, 10)[0].claims)]
            if judge(row, evidence, again, n_rows, n_permutations=399).worse(level):
                alarms += 1
                break
    assert alarms <= n_boards * level + 2 * np.sqrt(n_boards * level * (1 - level))
    smallest = 1 / 50_001  # a p-value's, before correction for every row and measure there is
    n_committed = sum(
        len(board.labels) for name, board in BOARDS.items() if name not in {"hills", "anywhere"}
    )
    assert smallest * n_committed * len(MEASURES) < FALSE_ALARMS


def test_the_check_of_every_board_can_alarm() -> None:
    """Runs that are worse than all committed ones, in every context: the least p that there is."""
    kept = {name: board for name, board in BOARDS.items() if name not in {"hills", "anywhere"}}
    n_rows = sum(len(board.labels) for board in kept.values())
    for name, board in kept.items():
        runs = board.runs(name, board.labels[:1])
        n_contexts = len({(run.variant, run.protocol.number) for run in runs})
        n_orders = math.comb(len(board.seeds) + board.n_checked, board.n_checked) ** n_contexts
        least = 1 / min(n_orders, 50_001)
        assert board.n_checked == 0 or least * n_rows * len(MEASURES) < FALSE_ALARMS, name


@pytest.mark.slow
def test_false_alarms_are_below_one_in_a_hundred() -> None:
    rng, n_boards, n_rows, alarms = np.random.default_rng(1), 1000, 6, 0
    for _ in range(n_boards):
        rows = [(a_row(rng, 20), a_row(rng, 10)[0].claims) for _ in range(n_rows)]
        alarms += any(judge(*row, again, n_rows, 4000).worse() for row, again in rows)
    assert alarms / n_boards < FALSE_ALARMS


def test_contexts_are_judged_apart() -> None:
    """Every run is a little worse in its own context; contexts differ by far more than that."""
    rng = np.random.default_rng(2)
    contexts = np.arange(16, dtype=np.float32)[:, None]
    hardness = 100 * rng.normal(size=16)
    claims = tuple(Claim(i, "", None, None, h, False, None, h) for i, h in enumerate(hardness))
    row = replace(a_row(rng, 1)[0], claims=claims)
    evidence = Evidence(contexts, contexts, contexts[:0])
    worse = [replace(c, reward=c.reward - 0.1, mean_reward=c.mean_reward - 0.1) for c in claims]
    assert judge(row, evidence, worse, 1).worse() == ["final reward", "mean reward"]
    assert (
        judge(row, evidence, [replace(c, reward=c.reward + 0.1) for c in claims], 1).worse() == []
    )
    pooled = [(np.array([c.reward for c in worse]), hardness)]
    assert permutation_p(pooled, "less") > 0.2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["check", "--board", "nope"], "no board 'nope'; the leaderboard has bottles"),
        (["verify", "--board", "hills", "--data", "nowhere"], "'nowhere' holds no such row"),
        *(
            ([what, "--board", *boards, "--algorithms", "Hill", "nope"], message)
            for what in ("show", "update", "check", "verify")
            for boards, message in (
                (["hills"], "on the board hills, has no row 'nope'; it has 'Hill'."),
                (["bottles", "hills"], "on the boards bottles, hills, has no row 'nope'; it has"),
                (["bottles"], "has no row 'Hill'; it has 'RC-NMP', 'GA', 'GA, judged',"),
            )
        ),
        (["verify", "--exact"], "--exact goes with check"),
        (["check", "--overwrite"], "--overwrite goes with update"),
        (["check", "--workers", "0"], "--workers is 0; at least 1 process"),
    ],
)
def test_wrong_usage_is_told(
    arguments: list[str], message: str, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    where = [] if "--data" in arguments else ["--data", str(made / "data")]
    assert main(["leaderboard", *arguments, *where]) == 2
    assert message in capsys.readouterr().err
