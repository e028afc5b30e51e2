"""`Row`: what the leaderboard says of an algorithm, run by run, and what shows it."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from results.exceptions import BenchmarkError
from results.harness.records import ProtocolRecord, Provenance, RunRecord
from results.report.frames import rollouts_to_success
from results.report.statistics import (
    expected_rollouts,
    interquartile_mean,
    interquartile_mean_interval,
)

#: single precision, as trajectories and contexts are simulated
Float32Array = NDArray[np.float32]
Interval = tuple[float, float, float]


@dataclass(frozen=True)
class Claim:
    """What is said of one run: in one context, or over many.

    Over many, it is said of the answers to held-out contexts, the first ones of which are kept. The
    policy succeeds where at most a board's share of them fails.

    :param seed: of the run
    :param variant: name of the task's settings
    :param target: the number of its context, where the protocol numbers them
    :param rollouts: from which on the greedy trajectory succeeds, None where it does not in the end
    :param reward: of the last greedy trajectory; over many contexts the mean of the kept ones
    :param success: whether that one succeeds
    :param solving_reward: of the greedy trajectory from which on all succeed; None where none is,
        and over many contexts
    :param mean_reward: of the greedy trajectory, over all rollouts of the budget
    :param failure_rate: share of all held-out contexts that fail in the end; None in one context
    :param kept_rewards: of the kept contexts; empty in one context
    :param n_kept_failures: how many of the kept contexts fail
    """

    seed: int
    variant: str
    target: int | None
    rollouts: float | None
    reward: float
    success: bool
    solving_reward: float | None
    mean_reward: float
    failure_rate: float | None = None
    kept_rewards: tuple[float, ...] = ()
    n_kept_failures: int = 0

    @property
    def key(self) -> tuple[int, str, int | None]:
        """What tells it from the other runs of its row."""
        return self.seed, self.variant, self.target


@dataclass(frozen=True)
class Row:
    """One algorithm on one board; its scores follow from its claims and are not stored.

    :param board: its name
    :param label: the algorithm's
    :param description: of the algorithm, one line
    :param algorithm: its stable name
    :param settings: of the algorithm, as JSON values
    :param task: its id
    :param protocol: where and how the runs took place
    :param budget: rollouts of a run
    :param sees: what the algorithm learns from
    :param provenance: commit, versions and machine, the same for all its runs
    :param claims: one for each run
    :param n_trials: of the study that found the settings; None where none did
    """

    board: str
    label: str
    description: str
    algorithm: str
    settings: dict[str, Any]
    task: str
    protocol: ProtocolRecord
    budget: int
    sees: tuple[str, ...] | None
    provenance: Provenance
    claims: tuple[Claim, ...]
    n_trials: int | None = None

    @property
    def rollouts(self) -> Interval:
        """Expected rollouts to success, and their 95 % interval over seeds."""
        counts = [math.inf if c.rollouts is None else c.rollouts for c in self.claims]
        return expected_rollouts(counts, self.budget, [c.seed for c in self.claims])

    @property
    def reward(self) -> Interval:
        """Interquartile mean of the seeds' mean final rewards, and its 95 % interval."""
        of_seed: dict[int, list[float]] = {}
        for claim in self.claims:
            of_seed.setdefault(claim.seed, []).append(claim.reward)
        means = [float(np.mean(rewards)) for rewards in of_seed.values()]
        return interquartile_mean(means), *interquartile_mean_interval(means)

    @property
    def failure_rate(self) -> Interval | None:
        """Interquartile mean of the share of contexts that fail, and its interval; None in one."""
        rates = [c.failure_rate for c in self.claims if c.failure_rate is not None]
        return (interquartile_mean(rates), *interquartile_mean_interval(rates)) if rates else None

    @property
    def solved(self) -> int:
        """How many runs succeed in the end."""
        return sum(claim.success for claim in self.claims)


@dataclass(frozen=True)
class Evidence:
    """The trajectories that earned a row, in single precision, in the order of its claims.

    :param contexts: of the runs, shape (R, C); over many contexts the kept ones, (R, K, C)
    :param final: the last greedy trajectories, shape (R, T, D) or (R, K, T, D)
    :param solving: those from which on all succeed, of the runs that have one, shape (S, T, D)
    """

    contexts: Float32Array
    final: Float32Array
    solving: Float32Array


def claim_of(record: RunRecord, most_failures: float = 0.0) -> Claim:
    """Return what is said of a finished run.

    :param record: of the run
    :param most_failures: share of held-out contexts that may fail in a success over many
    :raises BenchmarkError: a failed run, one that was trained with others, or one from before
        records kept what can be repeated
    """
    asked = record.specification
    if not record.finished:
        raise BenchmarkError(
            f"{asked.name} has failed ({record.reason}): a row needs all its runs."
        )
    if record.n_together > 1:
        raise BenchmarkError(
            f"{asked.name} was trained as one with {record.n_together - 1} other runs "
            "(--together), and nobody can do it again to the bit: a row needs runs by themselves."
        )
    if "failure_rate" in record.curve:
        return _over_many(record, most_failures)
    measured = record.measured
    greedy, curve = measured.rollouts.get("greedy"), record.curve
    if measured.context is None or greedy is None or greedy.reward is None:
        raise _cannot_be_repeated(record)
    count = rollouts_to_success(curve["rollouts"], curve["greedy_success"])
    solving = measured.rollouts.get("solving")
    return Claim(
        asked.seed,
        asked.variant,
        asked.protocol.number,
        None if math.isinf(count) else count,
        greedy.reward,
        bool(greedy.success),
        None if solving is None else solving.reward,
        mean_reward(curve["rollouts"], curve["greedy_reward"], asked.budget),
    )


def _over_many(record: RunRecord, most_failures: float) -> Claim:
    asked, curve, kept = record.specification, record.curve, record.measured.more.get("kept")
    if not kept:
        raise _cannot_be_repeated(record)
    count = rollouts_to_success(
        curve["rollouts"], [rate <= most_failures for rate in curve["failure_rate"]]
    )
    return Claim(
        asked.seed,
        asked.variant,
        asked.protocol.number,
        None if math.isinf(count) else count,
        float(np.mean(kept["rewards"])),
        not math.isinf(count),
        None,
        mean_reward(curve["rollouts"], curve["mean_reward"], asked.budget),
        curve["failure_rate"][-1],
        tuple(kept["rewards"]),
        len(kept["successes"]) - sum(kept["successes"]),
    )


def _cannot_be_repeated(record: RunRecord) -> BenchmarkError:
    return BenchmarkError(
        f"{record.specification.name} tells no trajectory that can be repeated, or is from before "
        "records kept them exactly; do it again (nmp-bench leaderboard update --overwrite)."
    )


def mean_reward(rollouts: Sequence[int], rewards: Sequence[float], budget: int) -> float:
    """Return the mean over a budget of a reward that holds until the next entry.

    >>> mean_reward([10, 20], [-4.0, -2.0], 30)
    -3.0

    :param rollouts: ascending counts; the first reward counts from there on
    :param rewards: one for each
    :param budget: of the run, beyond the first count
    """
    ends = [*rollouts[1:], max(budget, rollouts[-1])]
    weights = np.diff([rollouts[0], *ends])
    if weights.sum() == 0:
        return float(rewards[-1])
    return float(np.average(np.asarray(rewards, float), weights=weights))


def make_row(
    board: str, records: Iterable[RunRecord], most_failures: float = 0.0
) -> tuple[Row, Evidence]:
    """Return the row of one algorithm, and the trajectories that earned it.

    :param board: its name
    :param records: of all its runs
    :param most_failures: see `claim_of`
    :raises BenchmarkError: a run that can be no part of it, or runs of different commits, versions
        or machines
    """
    runs = sorted(records, key=_order)
    claims = tuple(claim_of(record, most_failures) for record in runs)
    first = runs[0]
    asked = first.specification
    for record in runs:
        _check_same_origin(board, first, record)
    seen = {each for record in runs for each in record.sees or ()}  # one that aimed saw more
    sees = tuple(sorted(seen)) or None
    row = Row(
        board, asked.label, asked.description, asked.algorithm, asked.settings, asked.task,
        asked.protocol.shared, asked.budget, sees,
        first.provenance, claims, asked.n_trials,
    )  # fmt: skip
    return row, _evidence(runs)


def _order(record: RunRecord) -> tuple[str, int, int]:
    asked = record.specification
    return asked.variant, asked.protocol.number or 0, asked.seed


def _check_same_origin(board: str, first: RunRecord, other: RunRecord) -> None:
    one, two = first.provenance, other.provenance
    for name in ("commit", "dirty", "packages", "machine"):
        if getattr(one, name) != getattr(two, name):
            raise BenchmarkError(
                f"{first.specification.name} and {other.specification.name} differ in {name} "
                f"({getattr(one, name)} and {getattr(two, name)}); a row has one origin. Do all "
                f"its runs again: nmp-bench leaderboard update --board {board} --algorithms "
                f"'{first.specification.label}' --overwrite."
            )


def _evidence(runs: Sequence[RunRecord]) -> Evidence:
    if "failure_rate" in runs[0].curve:
        every = [record.measured.more["kept"] for record in runs]
        contexts = np.array([kept["contexts"] for kept in every], np.float32)
        final = np.array([kept["trajectories"] for kept in every], np.float32)
        return Evidence(contexts, final, np.empty((0, *final.shape[2:]), np.float32))
    rollouts = [record.measured.rollouts for record in runs]
    final = np.array([each["greedy"].trajectory for each in rollouts], np.float32)
    solving = [each["solving"].trajectory for each in rollouts if "solving" in each]
    contexts = [record.measured.context.values for record in runs if record.measured.context]
    return Evidence(
        np.array(contexts, np.float32),
        final,
        np.array(solving, np.float32).reshape(-1, *final.shape[1:]),
    )
