"""`check --exact`: a run of each row again, to the bit; whatever has changed shows, however small.

An unchanged program repeats its runs on a like machine, so there are no false alarms, and one seed
is enough. It cannot tell worse from better: that is what `judge` is for. Where the machine or a
package that decides the bits is another one, nothing is compared, and the sentence says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from results.harness.machine import machine
from results.harness.provenance import provenance
from results.leaderboard.rows import Claim, Row

#: they decide nothing in a run
NO_MATTER = ("sb3-nmp", "pandas")


@dataclass(frozen=True)
class Comparison:
    """What came of one row.

    :param row: its board and algorithm
    :param unlike: why bits cannot be compared; empty where they can
    :param changed: a sentence for each run that is another one now
    :param n_runs: how many were done again
    """

    row: str
    unlike: str
    changed: tuple[str, ...]
    n_runs: int

    def sentence(self) -> str:
        """Say it."""
        if self.unlike:
            return f"{self.row}: not compared: {self.unlike}"
        if not self.changed:
            return f"{self.row}: {self.n_runs} runs again, the same to the bit"
        board, _, label = self.row.partition(", ")
        return (
            f"{self.row}: CHANGED: {'; '.join(self.changed)}. If that is meant, make the row anew: "
            f"nmp-bench leaderboard update --board {board} --algorithms '{label}' --overwrite"
        )


def name_of(row: Row) -> str:
    """Return how a row is called in messages.

    :param row: its claims
    """
    return f"{row.board}, {row.label}"


def unlike(row: Row) -> str:
    """Say why this process's bits cannot be compared with a row's, empty where they can.

    :param row: its claims
    """
    here, there = provenance(), row.provenance
    names = sorted({*here.packages, *there.packages} - {*NO_MATTER})
    other = [name for name in names if here.packages.get(name) != there.packages.get(name)]
    if other:
        told = ", ".join(
            f"{name} {there.packages.get(name)} (here {here.packages.get(name)})" for name in other
        )
        return f"the row was made with {told}"
    if there.machine != machine():
        return "the row was made on another kind of CPU"
    return ""


def compare(row: Row, again: Sequence[Claim]) -> Comparison:
    """Return whether runs that were done again are the committed ones, to the bit.

    :param row: the committed claims
    :param again: of some of its runs
    """
    committed = {claim.key: claim for claim in row.claims}
    changed = [
        f"seed {new.seed}{f', {new.variant}' if new.variant else ''} ends at {new.reward!r} with "
        f"mean {new.mean_reward!r}, committed {old.reward!r} and {old.mean_reward!r}"
        for new in again
        if (old := committed[new.key]) != new
    ]
    return Comparison(name_of(row), "", tuple(changed), len(again))
