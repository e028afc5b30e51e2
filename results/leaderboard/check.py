"""`check`: do a part of the runs again, and alarm where the program has become worse.

The runs again and the committed ones in the same context are exchangeable as long as the program
is as good as it was. So the one-sided permutation test (`permutation_p`) is exact, and Bonferroni's
correction for all rows and measures bounds the probability of a false alarm anywhere by
`FALSE_ALARMS`. Ranks are those among all contexts: where each has one run, which of two is better
says less than by how much (RC-NMP without mutation on via-points: p = 6e-5, with these ranks 2e-5).
A program that has not changed gives the same bits on a like CPU, and no alarm.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from results.leaderboard.rows import Claim, Evidence, Row
from results.report.statistics import permutation_p

FALSE_ALARMS = 0.01  # of a whole check
N_PERMUTATIONS = 50_000
#: larger is better
MEASURES: Mapping[str, Callable[[Claim], float]] = {
    "rollouts to success": lambda c: -math.inf if c.rollouts is None else -c.rollouts,
    "final reward": lambda c: c.reward,
    "mean reward": lambda c: c.mean_reward,
}


@dataclass(frozen=True)
class Judgement:
    """What a check says of one row.

    :param row: its board and algorithm
    :param n_runs: how many were done again
    :param same: whether all of them gave the committed bits
    :param p_values: by measure, corrected for the whole check; empty where all is the same
    """

    row: str
    n_runs: int
    same: bool
    p_values: dict[str, float]

    def worse(self, level: float = FALSE_ALARMS) -> list[str]:
        """Return the measures in which the program has become worse.

        :param level: the probability of a false alarm in the whole check
        """
        return [name for name, p in self.p_values.items() if p <= level]

    def sentence(self) -> str:
        """Say it."""
        if not self.n_runs:
            return f"{self.row}: no runs again, which take too long; compare bits with --exact"
        if self.same:
            return f"{self.row}: {self.n_runs} runs again, the same to the bit"
        told = ", ".join(f"{name} p = {p:.2g}" for name, p in self.p_values.items())
        word = f"WORSE in {' and '.join(self.worse())}" if self.worse() else "no worse"
        return f"{self.row}: {self.n_runs} runs again, {word} ({told}, corrected)"


def judge(
    row: Row,
    evidence: Evidence,
    again: Sequence[Claim],
    n_rows: int,
    n_permutations: int = N_PERMUTATIONS,
) -> Judgement:
    """Return whether runs that were done again are worse than the committed ones.

    :param row: the committed claims
    :param evidence: which tells the runs' contexts
    :param again: what the same program, or a changed one, gave for some of the runs
    :param n_rows: how many rows the whole check has
    :param n_permutations: of the test
    """
    name = f"{row.board}, {row.label}"
    committed = {claim.key: claim for claim in row.claims}
    if all(committed[claim.key] == claim for claim in again):
        return Judgement(name, len(again), True, {})
    context = {c.key: one.tobytes() for c, one in zip(row.claims, evidence.contexts, strict=True)}
    p_values = {}
    for measure, value in MEASURES.items():
        strata = []
        for where in dict.fromkeys(context[claim.key] for claim in again):
            new = [value(claim) for claim in again if context[claim.key] == where]
            old = [value(claim) for claim in row.claims if context[claim.key] == where]
            strata.append((np.array(new), np.array(old)))
        p = permutation_p(strata, "less", n_permutations, together=True)
        p_values[measure] = min(1.0, p * n_rows * len(MEASURES))
    return Judgement(name, len(again), False, p_values)
