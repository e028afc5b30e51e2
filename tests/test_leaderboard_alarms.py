"""How often `nmp-bench leaderboard check` alarms although nothing has changed: computed, simulated.

All rows of the leaderboard are committed with their runs' scores, so that both are told for the
check that there is: its rows, its numbers of runs and contexts, and the ties of its scores. A check
begins with one run and does the others only where its bits are other ones; here it counts as if it
always did all: it alarms where this would, or less often.

Shape letters: S simulated checks, A runs again, R committed runs.
"""

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import rankdata

from results.leaderboard.boards import BOARDS, DATA
from results.leaderboard.check import FALSE_ALARMS, MEASURES, N_PERMUTATIONS, judge
from results.leaderboard.files import read_row, row_paths
from results.leaderboard.rows import Claim, Evidence, Row
from results.report.statistics import permutation_p

PATHS = row_paths(DATA)
#: of one row and measure
LEVEL = FALSE_ALARMS / (len(PATHS) * len(MEASURES))
#: runs again and committed runs of a row, for each of its contexts
Sizes = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Checked:
    """A committed row, and the places in its claims of a context's runs and of those done again.

    :param places: for each context: all its runs, and those that a check does again
    """

    row: Row
    evidence: Evidence
    places: tuple[tuple[list[int], list[int]], ...]

    @property
    def sizes(self) -> Sizes:
        return tuple((len(again), len(runs)) for runs, again in self.places)


def checked_rows() -> Iterator[Checked]:
    for path in PATHS:
        row, evidence, _ = read_row(path)
        board = BOARDS[row.board]
        n_checked = board.n_again(row.label)
        if n_checked == 0:
            continue
        places: dict[bytes, tuple[list[int], list[int]]] = {}
        for i, (claim, context) in enumerate(zip(row.claims, evidence.contexts, strict=True)):
            runs, again = places.setdefault(context.tobytes(), ([], []))
            runs.append(i)
            if claim.seed in board.seeds[:n_checked]:
                again.append(i)
        told = (each for each in places.values() if each[1])
        yield Checked(row, evidence, tuple(told))


# -- computed ----------------------------------------------------------------------------------


def strata_with(sizes: Sizes, excess: int) -> list[tuple[list[int], list[int]]]:
    """Return scores whose rank sum is above the least one by an excess.

    None are equal, and those of a context are all above those of the one before.
    """
    strata = []
    for n_again, n_runs in sizes:
        shift = min(excess, n_again * n_runs)
        excess -= shift
        again = list(range(n_again))
        for i in reversed(range(n_again)):
            again[i] += min(shift, n_runs)
            shift -= min(shift, n_runs)
        above = sum(len(scores) for stratum in strata for scores in stratum)
        runs = sorted({*range(n_again + n_runs)} - {*again})
        strata.append(([above + i for i in again], [above + i for i in runs]))
    return strata


def probabilities(sizes: Sizes) -> NDArray[np.float64]:
    """Return how likely each excess is when runs again and committed ones are alike."""
    total: NDArray[np.float64] = np.ones(1)
    for n_again, n_runs in sizes:
        ways = np.zeros((n_again + 1, n_again * n_runs + 1))
        ways[0, 0] = 1.0
        for place in range(n_again + n_runs):  # in the ranking
            for n in range(n_again, 0, -1):
                shift = place - n + 1  # of the n-th run again, if it has this place
                if 0 <= shift <= n_runs:
                    ways[n, shift:] += ways[n - 1, : ways.shape[1] - shift]
        total = np.asarray(np.convolve(total, ways[-1] / ways[-1].sum()), np.float64)
    return total


def false_alarms(sizes: Sizes) -> float:
    """Return the probability that one measure of an unchanged row alarms.

    That is where no scores tie, and those of a context are all above those of another. The deals of
    the permutation test are the same in every check, so it is known which rank sums alarm; their
    probability is exact.
    """
    likely = probabilities(sizes)

    def p_value(excess: int) -> float:
        return permutation_p(strata_with(sizes, excess), "less", N_PERMUTATIONS, together=True)

    n_alarms = bisect_right(range(len(likely)), LEVEL, key=p_value)
    return float(likely[:n_alarms].sum())


def test_probabilities_of_rank_sums_are_those_of_counting() -> None:
    assert probabilities(((1, 2),)).tolist() == pytest.approx([1 / 3] * 3)
    assert probabilities(((2, 2),)).tolist() == pytest.approx(np.array([1, 1, 2, 1, 1]) / 6)
    assert probabilities(((1, 1), (1, 1))).tolist() == [0.25, 0.5, 0.25]
    for excess in range(5):
        ((again, runs),) = strata_with(((2, 2),), excess)
        assert sum(again) == 1 + excess
        assert sorted(again + runs) == [0, 1, 2, 3]


def test_fewer_than_one_unchanged_check_in_a_hundred_alarms_by_computation() -> None:
    """The sum over rows and measures: what they have in common makes it less."""
    shapes = Counter(each.sizes for each in checked_rows())
    assert sum(shapes.values()) > 50
    total = sum(n * len(MEASURES) * false_alarms(sizes) for sizes, n in shapes.items())
    assert 0 < total < 0.01


# -- simulated ---------------------------------------------------------------------------------

N_CHECKS = 1000
#: standard deviations below the mean: a rank sum that is less extreme cannot alarm, since the
#: normal distribution has 0.5 % below it, and an alarm is one in 20 000
EXTREME = -2.6


def values(claims: tuple[Claim, ...]) -> NDArray[np.float64]:
    """The measures of claims, shape (R, 3)."""
    return np.array([[value(claim) for value in MEASURES.values()] for claim in claims])


def drawn_alike(each: Checked, n_checks: int, rng: np.random.Generator) -> list[NDArray[np.int_]]:
    """Draw the scores of runs again and of committed ones from the row's own, context by context.

    Where a context has one run alone, from those of all contexts of its variant.

    :return: for each context places of claims, shape (S, A + R)
    """
    drawn = []
    for (runs, _), (n_again, n_runs) in zip(each.places, each.sizes, strict=True):
        pool = runs
        if len(runs) == 1:
            variant = each.row.claims[runs[0]].variant
            pool = [i for i, claim in enumerate(each.row.claims) if claim.variant == variant]
        drawn.append(rng.choice(pool, (n_checks, n_again + n_runs)))
    return drawn


def deviations(each: Checked, drawn: list[NDArray[np.int_]]) -> NDArray[np.float64]:
    """Return by how many standard deviations the lowest measure's rank sum is off, shape (S,)."""
    scores = values(each.row.claims)
    off, variance = np.zeros((2, len(drawn[0]), len(MEASURES)))
    ends = np.cumsum([sum(sizes) for sizes in each.sizes])[:-1]
    ranked = np.split(rankdata(scores[np.concatenate(drawn, axis=1)], axis=1), ends, axis=1)
    for ranks, (n_again, n_runs) in zip(ranked, each.sizes, strict=True):
        n = n_again + n_runs
        ranks = ranks - ranks.mean(axis=1, keepdims=True)
        off += ranks[:, :n_again].sum(axis=1)
        variance += n_again * n_runs / (n * (n - 1)) * (ranks**2).sum(axis=1)
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(off / np.sqrt(variance)).min(axis=1)


def alarms(each: Checked, places: list[NDArray[np.int_]]) -> bool:
    """Let a check judge the row with scores that were drawn.

    :param places: for each context those of the claims drawn, shape (A + R,)
    """
    claims, again = list(each.row.claims), []
    for (runs, done), (n_again, _), where in zip(each.places, each.sizes, places, strict=True):
        for slot, place in zip(done, where[:n_again], strict=True):
            again.append(_scored_as(each.row.claims[slot], each.row.claims[place]))
        for slot, place in zip(runs, where[n_again:], strict=True):
            claims[slot] = _scored_as(each.row.claims[slot], each.row.claims[place])
    row = replace(each.row, claims=tuple(claims))
    return bool(judge(row, each.evidence, again, len(PATHS)).worse())


def _scored_as(run: Claim, other: Claim) -> Claim:
    return replace(other, seed=run.seed, variant=run.variant, target=run.target)


@pytest.mark.slow
def test_fewer_than_one_unchanged_check_in_a_hundred_alarms_by_simulation() -> None:
    rng = np.random.default_rng(0)
    alarmed = np.zeros(N_CHECKS, bool)
    n_judged = 0
    for each in checked_rows():
        drawn = drawn_alike(each, N_CHECKS, rng)
        for check in np.flatnonzero(deviations(each, drawn) < EXTREME):
            n_judged += 1
            alarmed[check] |= alarms(each, [places[check] for places in drawn])
    print(f"{alarmed.sum()} of {N_CHECKS} checks alarm; {n_judged} rows were judged")
    assert alarmed.mean() < 0.01


@pytest.mark.slow
def test_rows_that_are_not_judged_in_the_simulation_could_not_alarm() -> None:
    rng = np.random.default_rng(1)
    for each in checked_rows():
        drawn = drawn_alike(each, 300, rng)
        off = deviations(each, drawn)
        check = int(np.argmin(np.where(off < EXTREME, np.inf, off)))  # of those left out
        assert not alarms(each, [places[check] for places in drawn])
