"""Rows of the leaderboard against one of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from results.cli import main
from results.exceptions import BenchmarkError
from results.leaderboard.against import against, budgeted, differences
from results.leaderboard.boards import DATA
from results.leaderboard.files import read_row, row_path
from results.leaderboard.rows import Claim, Row

ROW = read_row(row_path(DATA, "push-beyond", "ACNMP"))[0]


def claim(seed: int, target: int, rollouts: float | None, reward: float = 0.0) -> Claim:
    return replace(
        ROW.claims[0], seed=seed, target=target, rollouts=rollouts, reward=reward, success=True
    )


def row(label: str, *claims: Claim) -> Row:
    return replace(ROW, label=label, claims=claims)


BASE = row("base", claim(1, 2, 10.0), claim(1, 9, 20.0), claim(2, 2, 30.0), claim(2, 9, 30.0))
OTHER = row("other", claim(2, 9, None), claim(2, 2, 31.0), claim(1, 9, 24.0), claim(1, 2, 12.0))


def test_differences_are_of_the_same_seed_and_target_and_one_for_each_seed() -> None:
    def rollouts(each: Claim) -> float:
        return budgeted(each, 130)

    assert differences(OTHER, BASE, rollouts).tolist() == [3.0, 50.5]
    assert differences(OTHER, BASE, rollouts, 2).tolist() == [2.0, 1.0]
    assert differences(BASE, OTHER, rollouts, 9).tolist() == [-4.0, -100.0]
    alone = replace(OTHER, claims=(claim(1, 2, 12.0), claim(7, 2, 99.0)))
    assert differences(alone, BASE, rollouts).tolist() == [2.0]
    assert differences(alone, BASE, lambda each: each.failure_rate).tolist() == []


def test_a_run_that_never_succeeds_counts_with_the_budget() -> None:
    assert [budgeted(claim(1, 2, count), 130) for count in (None, 7.0, 200.0)] == [130, 7, 130]


def test_the_page_has_all_targets_and_each_by_itself() -> None:
    (table,) = against([BASE, OTHER], "base").tables
    assert [line[0][0] for line in table.rows] == ["other"] * 3
    assert [line[1][0] for line in table.rows] == ["all", "2", "9"]
    assert [line[2][0] for line in table.rows] == ["2"] * 3
    assert [line[3][0] for line in table.rows] == ["+26.8", "+1.5", "+52.0"]
    assert table.rows[0][5][0] == "–"
    low, high = table.rows[1][3][1].strip("[]").split(",")
    assert float(low) <= 1.5 <= float(high)


def test_over_many_contexts_the_share_that_fails_is_compared() -> None:
    one = replace(BASE, claims=(replace(claim(1, 2, 5.0), target=None, failure_rate=0.02),))
    two = replace(OTHER, claims=(replace(claim(1, 2, 5.0), target=None, failure_rate=0.05),))
    (table,) = against([one, two], "base").tables
    (line,) = table.rows
    assert (line[1][0], line[5][0]) == ("all", "+3.0")


def test_what_cannot_be_compared_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    told = "no row 'third' is among those; there are 'base', 'oth"
    with pytest.raises(BenchmarkError, match=told):
        against([BASE, OTHER], "third")
    asked = ["leaderboard", "verify", "--against", "ACNMP", "--board", "push-beyond"]
    assert main(asked) == 2
    assert "--against goes with show" in capsys.readouterr().err


def test_the_command_prints_committed_rows(capsys: pytest.CaptureFixture[str]) -> None:
    rows = ["--board", "push-beyond", "--algorithms", "ACNMP", "twin, ridge"]
    assert main(["leaderboard", "show", *rows, "--against", "ACNMP", "--data", str(DATA)]) == 0
    told = capsys.readouterr().out
    assert "more than 'ACNMP'" in told and "twin, ridge" in told
    ridge = read_row(Path(row_path(DATA, "push-beyond", "twin, ridge")))[0]
    more = differences(ridge, ROW, lambda each: budgeted(each, ROW.budget))
    assert f"{np.mean(more):+.1f}" in told
