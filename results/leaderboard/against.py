"""Rows of the leaderboard against one of them, pair by pair: the same seed, variant and target."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from results.exceptions import BenchmarkError
from results.harness.suite import quoted
from results.leaderboard.boards import BOARDS
from results.leaderboard.rows import Claim, Row
from results.report.statistics import mean_interval
from results.report.text_table import NOT_APPLICABLE, Cell, Page, Section, TextTable

HEADER = (
    "algorithm",
    "target",
    "seeds",
    "rollouts\nmore",
    "final reward\nmore",
    "fail\n% more",
)
NOTES = (
    "Mean differences over seeds, each with its 95 % bootstrap interval: a seed's difference is "
    "the mean over its targets and variants. rollouts: until the greedy trajectory succeeds for "
    "good; a run that does not counts with the budget, so it is told to need less than it would.",
)
#: what is compared of a claim, and with which format; None where a claim does not have it
Measure = Callable[[Claim], float | None]


def against(rows: Sequence[Row], label: str) -> Page:
    """Return a table for each board that has a row of that label.

    :param rows: of all boards
    :param label: of the row that the others are compared with
    :raises BenchmarkError: no board has one
    """
    boards = [name for name in BOARDS if any(r.board == name and r.label == label for r in rows)]
    if not boards:
        raise BenchmarkError(
            f"no row '{label}' is among those; there are "
            f"{quoted(dict.fromkeys(row.label for row in rows))}."
        )
    tables = [_table(name, [row for row in rows if row.board == name], label) for name in boards]
    return Page(tables, [Section("Notes", [*NOTES], "dim")])


def _table(board: str, rows: Sequence[Row], label: str) -> TextTable:
    base = next(row for row in rows if row.label == label)
    others = sorted((row for row in rows if row is not base), key=lambda row: row.rollouts[0])
    title = f"{board}: {BOARDS[board].title}, more than '{label}'"
    cells = [line for row in others for line in _lines(row, base)]
    return TextTable(title, HEADER, tuple(cells))


def _lines(row: Row, base: Row) -> list[tuple[Cell, ...]]:
    """Return a row's differences over all targets, and, where there are several, by target."""
    targets = sorted({c.target for c in base.claims if c.target is not None})
    asked = [None, *targets] if len(targets) > 1 else [None]
    lines = []
    for target in asked:
        measures: list[tuple[Measure, float, str]] = [
            (lambda claim: budgeted(claim, row.budget), 1.0, "+.1f"),
            (lambda claim: claim.reward, 1.0, "+.4f"),
            (lambda claim: claim.failure_rate, 100.0, "+.1f"),
        ]
        found = [(scale * differences(row, base, of, target), form) for of, scale, form in measures]
        name = "all" if target is None else str(target)
        seeds = str(len(found[0][0]))
        cells = [_with_interval(values, form) for values, form in found]
        lines.append(((row.label, ""), (name, ""), (seeds, ""), *cells))
    return lines


def budgeted(claim: Claim, budget: int) -> float:
    """Return the rollouts until a run succeeds for good; its budget where it never does.

    :param claim: of the run
    :param budget: of a run
    """
    return float(budget if claim.rollouts is None else min(claim.rollouts, budget))


def differences(
    row: Row, base: Row, measure: Measure, target: int | None = None
) -> NDArray[np.float64]:
    """Return by how much a row is above another, a value for each seed that both have.

    :param row: that is compared
    :param base: that is subtracted
    :param measure: of a claim
    :param target: the only one that counts; None: all
    """
    known = {claim.key: measure(claim) for claim in base.claims}
    of_seed: dict[int, list[float]] = {}
    for claim in row.claims:
        one, other = measure(claim), known.get(claim.key)
        if one is not None and other is not None and target in (None, claim.target):
            of_seed.setdefault(claim.seed, []).append(one - other)
    return np.array([float(np.mean(each)) for _, each in sorted(of_seed.items())], np.float64)


def _with_interval(values: NDArray[np.float64], form: str) -> Cell:
    if len(values) == 0:
        return NOT_APPLICABLE, ""
    low, high = map(float, mean_interval(values))
    return f"{values.mean():{form}}", f"[{low:{form}},{high:{form}}]"
