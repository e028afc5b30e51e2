"""`verify`: simulate every stored trajectory again, and hold it to what its row claims.

What this shows: these trajectories, in the contexts that the board's seeds give, earn these
rewards; every row and run that the board asks for is there once; the algorithm learns from what its
row says; and the commit is one of this history. What it cannot show is which of its commits, after
how many rollouts a trajectory was found, what the mean over the budget was, and over many contexts
which share fails beyond those whose answers are kept, but for what these make incredible: for that
runs must be done again, which `check` does.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.stats import hypergeom

from benchmark_envs import Task, TaskError, make_task
from results.exceptions import RecordError
from results.harness.environments import RunTask
from results.harness.machine import machine
from results.harness.provenance import provenance
from results.harness.specification import RunSpecification, plain
from results.leaderboard.boards import BOARDS, Board
from results.leaderboard.commits import about_commit, why_not_looked_up
from results.leaderboard.files import digest, read_row, row_path
from results.leaderboard.rows import Claim, Evidence, Row
from results.leaderboard.sees import UntoldError, about_sees
from results.stream.evaluation import N_KEPT
from results.stream.protocol import Stream

#: of a reward, relative to it or to 1, where CPU or libraries differ from those of the row
TOLERANCE = 1e-6
#: a claim over many contexts that is less probable, given the kept ones, is not believed
INCREDIBLE = 1e-6
Runs = dict[tuple[int, str, int | None], RunSpecification]
#: fields of a row that are as the board has them
ASKED = ("description", "algorithm", "settings", "task", "budget", "protocol", "n_trials")
DECIDES_REWARDS = ("mujoco", "numpy")  # and nothing else that is installed


@dataclass(frozen=True)
class Verdict:
    """What came of one row.

    :param name: of its file
    :param how: rewards were compared
    :param problems: sentences; empty where the row holds
    :param unchecked: what could not be checked here, and why
    """

    name: str
    how: str = ""
    problems: list[str] = field(default_factory=list)
    unchecked: list[str] = field(default_factory=list)


def verify_row(path: Path, boards: dict[str, Board] = BOARDS) -> Verdict:
    """Simulate a row's trajectories again.

    :param path: of its claims
    :param boards: that rows may belong to
    """
    name = f"{path.parent.name}/{path.stem}"
    try:
        row, evidence, told = read_row(path)
        problems = list(_about_files(path, row, evidence, told, boards))
        if problems:  # what is not as the board asks cannot be simulated as it asks
            return Verdict(name, "not simulated", problems)
        runs = _runs(row, boards[row.board])
        how, tolerance = comparison(row)
        problems += _about_contexts(row, evidence, runs)
        problems += _about_rewards(row, evidence, runs, tolerance)
        of_origin, unchecked = _about_origin(row, runs)
    except (RecordError, TaskError) as error:
        return Verdict(name, "not simulated", [str(error)])
    return Verdict(name, how, problems + of_origin, unchecked)


def _about_origin(row: Row, runs: Runs) -> tuple[list[str], list[str]]:
    """Return what is wrong with a row's commit and sources of learning, and what is unchecked."""
    problems = list(about_commit(row.provenance))
    unchecked = [why] if (why := why_not_looked_up(row.provenance)) else []
    try:
        problems += about_sees(row, next(iter(runs.values())))
    except UntoldError as error:
        unchecked.append(str(error))
    return problems, unchecked


def missing_rows(data: Path, labels: dict[str, list[str]]) -> list[str]:
    """Return a sentence for each row that is asked for, and that has no file.

    A row that somebody took away would otherwise hold.

    :param data: of all boards
    :param labels: of the rows that are wanted, by board
    """
    return [
        f"{name}: the board asks for a row '{label}', and '{row_path(data, name, label)}' is "
        f"missing. Restore it from the repository, or make it with 'nmp-bench leaderboard update "
        f'--board {name} --algorithms "{label}"\'.'
        for name, wanted in labels.items()
        for label in wanted
        if not row_path(data, name, label).exists()
    ]


def comparison(row: Row) -> tuple[str, float]:
    """Return how a row's rewards compare here, in words, and the tolerance.

    :param row: with the machine and versions that it was made with
    """
    if versions := other_versions(row):
        return f"within {TOLERANCE:g}; the row was made with {versions}", TOLERANCE
    if row.provenance.machine != machine():
        return f"within {TOLERANCE:g}; the row was made on another kind of CPU", TOLERANCE
    return "bitwise", 0.0


def other_versions(row: Row) -> str:
    """Return with which other versions than here a row was made, in words; empty where with none.

    Another version of MuJoCo may give other rewards.

    :param row: with the versions that it was made with
    """
    here, there = provenance().packages, row.provenance.packages
    return ", ".join(
        f"{name} {there[name]}" for name in DECIDES_REWARDS if here[name] != there[name]
    )


def _runs(row: Row, board: Board) -> Runs:
    chosen = board.runs(row.board, [row.label])
    return {(run.seed, run.variant, run.protocol.number): run for run in chosen}


def _about_files(
    path: Path, row: Row, evidence: Evidence, told: str, boards: dict[str, Board]
) -> Iterator[str]:
    """Yield what is wrong before anything is simulated."""
    if told != digest(row, evidence):
        yield "its digest does not fit: a claim or a trajectory was changed after it was written"
    if row.board != path.parent.name or row.board not in boards:
        yield f"it is in the folder '{path.parent.name}' and says board '{row.board}'"
        return
    if path != row_path(path.parent.parent, row.board, row.label):
        yield f"it is the row '{row.label}', which belongs into another file than '{path.name}'"
    if row.label not in boards[row.board].labels:
        yield f"the board has no row '{row.label}'"
        return
    runs = _runs(row, boards[row.board])
    wanted = next(iter(runs.values())).record
    wanted = replace(wanted, protocol=wanted.protocol.shared)
    for name in ASKED:
        said, asked = getattr(row, name), getattr(wanted, name)
        if said != as_known_then(asked, said):
            yield f"its {name} is {said}, but the board asks for {asked}"
    keys = [claim.key for claim in row.claims]
    if len(set(keys)) < len(keys):
        yield "a run is counted twice"
    if set(keys) != set(runs):
        odd = set(keys) ^ set(runs)
        yield f"its runs are not those of the board; they differ in (seed, variant, target) {odd}"
    yield from _about_claims(row, evidence, runs, boards[row.board])


def as_known_then(asked: object, said: object) -> object:
    """Return what a board asks for, less fields of settings that came later than a row.

    A field that came later has a default that leaves older rows as they were, or they are made
    anew: `check --exact` tells. What is no settings object must be told whole.

    >>> asked = {"critic": {"settings": "acnmp-critic", "pull": 0.3, "new": True}, "size": 3}
    >>> as_known_then(asked, {"critic": {"settings": "acnmp-critic", "pull": 0.1}})
    {'critic': {'settings': 'acnmp-critic', 'pull': 0.3}, 'size': 3}

    :param asked: by the board
    :param said: by the row
    """
    if not (isinstance(asked, dict) and isinstance(said, dict)):
        return asked
    same = "settings" in asked and asked["settings"] == said.get("settings")
    known = {key: value for key, value in asked.items() if key in said or not same}
    return {key: as_known_then(value, said.get(key)) for key, value in known.items()}


def _about_claims(row: Row, evidence: Evidence, runs: Runs, board: Board) -> Iterator[str]:
    """Yield what in a row's claims contradicts itself, or the trajectories beside them."""
    n_solving = sum(claim.solving_reward is not None for claim in row.claims)
    if not len(row.claims) == len(evidence.contexts) == len(evidence.final):
        yield f"{len(row.claims)} claims stand beside {len(evidence.final)} trajectories"
    if n_solving != len(evidence.solving):
        yield f"{n_solving} solved claims stand beside {len(evidence.solving)} trajectories"
    if evidence.final.ndim != (4 if _over_many(runs) else 3):
        yield f"its trajectories have the shape {evidence.final.shape}"
        return
    for claim in row.claims:
        yield from _about_claim(claim, row.budget)
        protocol = runs[claim.key].protocol if claim.key in runs else None
        if isinstance(protocol, Stream):
            yield from _about_claim_over_many(claim, protocol.n_test, board.most_failures)
        else:
            yield from _about_claim_in_one(claim)


def _over_many(runs: Runs) -> bool:
    """Tell whether a row's runs are over many contexts each."""
    return isinstance(next(iter(runs.values())).protocol, Stream)


def _about_claim(claim: Claim, budget: int) -> Iterator[str]:
    """Yield what in a claim contradicts itself."""
    where = f"run {claim.key}"
    if (claim.rollouts is not None) != claim.success:
        yield f"{where} says success {claim.success}, but rollouts to success {claim.rollouts}"
    if claim.rollouts is not None and not 0 <= claim.rollouts <= budget:
        yield f"{where} took {claim.rollouts} rollouts of {budget}"


def _about_claim_in_one(claim: Claim) -> Iterator[str]:
    """Yield what contradicts itself in a claim in one context."""
    where = f"run {claim.key}"
    if (claim.solving_reward is not None) != claim.success:
        yield f"{where} says success {claim.success}, but has no trajectory that tells since when"
    if claim.failure_rate is not None or claim.kept_rewards or claim.n_kept_failures:
        yield f"{where} is in one context, and tells what many have: a share that fails"


def _about_claim_over_many(claim: Claim, n_test: int, most_failures: float) -> Iterator[str]:
    """Yield what contradicts itself in a claim over many contexts, or cannot be believed."""
    where, rate = f"run {claim.key}", claim.failure_rate
    if rate is None or len(claim.kept_rewards) != N_KEPT:
        yield f"{where} tells {len(claim.kept_rewards)} rewards, and {N_KEPT} contexts are kept"
        return
    if claim.solving_reward is not None:
        yield f"{where} is over many contexts, and tells a trajectory that solves one"
    if claim.success != (rate <= most_failures):
        yield f"{where} says success {claim.success}, but {rate:.1%} fail, {most_failures:.1%} may"
    n_failures, n_kept = round(rate * n_test), claim.n_kept_failures
    if rate != n_failures / n_test or not 0 <= n_failures <= n_test:
        yield f"{where} says that a share of {rate!r} fails, which is none of {n_test} contexts"
    elif min(_as_many(n_kept, n_failures, n_test)) < INCREDIBLE:
        yield (
            f"{where} says that {rate:.1%} of {n_test} contexts fail, but {n_kept} of the "
            f"{N_KEPT} kept ones do"
        )
    if claim.reward != float(np.mean(claim.kept_rewards)):
        yield f"{where} says reward {claim.reward!r}, which is not the mean of the kept ones"


def _as_many(n_kept: int, n_failures: int, n_test: int) -> tuple[float, float]:
    """Return how probable at most, and at least, so many failures among the kept contexts are.

    The kept contexts are the first ones of those that were drawn, which is a sample of them all.
    """
    drawn = hypergeom(n_test, n_failures, N_KEPT)
    return float(drawn.cdf(n_kept)), float(drawn.sf(n_kept - 1))


def _about_contexts(row: Row, evidence: Evidence, runs: Runs) -> Iterator[str]:
    """Yield runs whose context is not the one that their seed gives."""
    for claim, stored in zip(row.claims, evidence.contexts, strict=True):
        wanted = context_of(runs[claim.key])
        if stored.shape != wanted.shape:
            yield f"run {claim.key} has contexts of shape {stored.shape}, not {wanted.shape}"
        elif not np.array_equal(stored, wanted):
            said, true = np.atleast_2d(stored), np.atleast_2d(wanted)
            first = int(np.flatnonzero((said != true).any(axis=1))[0])
            yield (
                f"run {claim.key} is in the context {said[first].tolist()}, not "
                f"{true[first].tolist()}"
            )


def context_of(run: RunSpecification) -> np.ndarray:
    """Return the one context of a run, shape (C,), or the kept ones of many, shape (K, C).

    In single precision, as records keep them.

    :param run: of a protocol in one context, or of a stream
    """
    task = RunTask(run.task, run.seed, run.budget, settings=run.task_settings)
    protocol = run.protocol
    found = (
        protocol.test_contexts(task.task)[:N_KEPT]
        if isinstance(protocol, Stream)
        else protocol.context(task)
    )
    return np.asarray(found, np.float32)


@lru_cache(maxsize=16)
def _simulator(task_id: str, settings: str) -> Task:
    return make_task(task_id, n_threads=1, **json.loads(settings))


def _about_rewards(
    row: Row,
    evidence: Evidence,
    runs: Runs,
    tolerance: float,
) -> Iterator[str]:
    """Yield trajectories that do not earn what is claimed."""
    if _over_many(runs):
        yield from _about_rewards_over_many(row, evidence, runs, tolerance)
        return
    solved = [i for i, claim in enumerate(row.claims) if claim.solving_reward is not None]
    batches = (("final", range(len(row.claims))), ("solving", solved))
    for name, indices in batches:
        trajectories = getattr(evidence, name)
        for place, i in enumerate(indices):
            claim = row.claims[i]
            run = runs[claim.key]
            task = _simulator(run.task, json.dumps(plain(run.task_settings), sort_keys=True))
            again = task.simulate(evidence.contexts[i], trajectories[place])
            said = claim.reward if name == "final" else claim.solving_reward
            reward, success = float(again.rewards[0]), bool(again.successes[0])
            if said is None or abs(reward - said) > tolerance * max(1.0, abs(said)):
                yield f"run {claim.key}: the {name} trajectory earns {reward!r}, not {said!r}"
            if success != (claim.success or name == "solving"):
                yield f"run {claim.key}: the {name} trajectory {'succeeds' if success else 'fails'}"


def _about_rewards_over_many(
    row: Row, evidence: Evidence, runs: Runs, tolerance: float
) -> Iterator[str]:
    """Yield runs whose kept trajectories do not earn what is claimed."""
    for claim, contexts, final in zip(row.claims, evidence.contexts, evidence.final, strict=True):
        run = runs[claim.key]
        task = _simulator(run.task, json.dumps(plain(run.task_settings), sort_keys=True))
        again = task.simulate(contexts, final)
        said = np.array(claim.kept_rewards)
        wrong = np.abs(again.rewards - said) > tolerance * np.maximum(1.0, np.abs(said))
        for place in np.flatnonzero(wrong):
            yield (
                f"run {claim.key}: the trajectory in kept context {place} earns "
                f"{float(again.rewards[place])!r}, not {claim.kept_rewards[place]!r}"
            )
        n_failures = int(np.sum(~again.successes))
        if n_failures != claim.n_kept_failures:
            yield (
                f"run {claim.key}: {n_failures} of the kept trajectories fail, not "
                f"{claim.n_kept_failures}"
            )
