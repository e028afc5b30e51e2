"""`Recipe` and `Suite`: runs that belong together, multiplied out from what they are made of."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from results.exceptions import BenchmarkError
from results.harness.protocol import Protocol
from results.harness.records import SuiteRecord
from results.harness.specification import Algorithm, RunSpecification

#: of one command, each of which is a run of every algorithm
MOST_SEEDS = 10_000


@dataclass(frozen=True)
class Recipe:
    """What a suite is made of; `make_suite` multiplies it out.

    >>> from results.suites import find_recipe
    >>> list(find_recipe("quick").algorithms)
    ['RC-NMP', 'GA', 'GA, judged', 'DREPS', 'REPS']

    :param algorithms: by label, in the order of the tables
    :param tasks: task settings by task id
    :param budget: rollouts of a run
    :param n_seeds: how many seeds by default, from 0 on
    :param protocols: each seed is run once in each
    :param checkpoints: rollouts at which tables report the greedy error
    :param published: rollouts that the thesis's method needed, None where it tells none
    :param variants: further settings of the tasks, by a name for each variant; each seed is run
        once in each. By default there is but one, without a name
    :param imports: modules that every process imports first (`results.harness.plugins`)
    :param tuning: where its algorithms may be tuned: in contexts apart from those of ``protocols``
    """

    algorithms: Mapping[str, Algorithm]
    tasks: Mapping[str, Mapping[str, object]]
    budget: int
    n_seeds: int
    protocols: tuple[Protocol, ...]
    checkpoints: tuple[int, ...] = ()
    published: int | None = None
    variants: Mapping[str, Mapping[str, object]] = field(default_factory=lambda: {"": {}})
    imports: tuple[str, ...] = ()
    tuning: tuple[Protocol, ...] = ()


@dataclass(frozen=True)
class Suite:
    """Runs that belong together.

    >>> from results.suites import find_recipe
    >>> suite = make_suite("quick", find_recipe("quick"), seeds=[7], labels=["ga"])
    >>> [run.name for run in suite.specifications]
    ['GA on nmp/Bottles-v0, seed 7']

    :param name: also of the folder that holds its runs
    :param specifications: the runs
    """

    name: str
    specifications: tuple[RunSpecification, ...]

    @property
    def labels(self) -> list[str]:
        """The algorithms' labels, in the suite's order."""
        return list(dict.fromkeys(run.label for run in self.specifications))


def make_suite(
    name: str,
    recipe: Recipe,
    seeds: Iterable[int] | None = None,
    budget: int | None = None,
    labels: Sequence[str] | None = None,
) -> Suite:
    """Return the runs of a suite, seed by seed, so that an interrupted suite is balanced.

    :param name: of the suite
    :param recipe: what it is made of
    :param seeds: the recipe's own number of seeds, from 0 on, by default
    :param budget: rollouts of a run; by default the recipe's, or the algorithm's where it has one
    :param labels: the algorithms to run; all by default. Case and punctuation do not matter
    :raises BenchmarkError: no such algorithm, no seed, a budget below 1, or names of which two
        would be one file's
    """
    chosen = list(recipe.algorithms)
    if labels is not None:
        chosen = [find_label(label, chosen, f"the suite '{name}'") for label in labels]
    if budget is not None and budget < 1:
        raise BenchmarkError(f"the budget is {budget}; a run needs at least 1 rollout.")
    facts = SuiteRecord(name, tuple(recipe.algorithms), recipe.checkpoints, recipe.published)
    specifications = [
        _specification(recipe, label, task, variant, seed, budget, protocol, facts)
        for task in recipe.tasks
        for seed in (range(recipe.n_seeds) if seeds is None else list(seeds))
        for variant in recipe.variants
        for protocol in recipe.protocols
        for label in dict.fromkeys(chosen)
    ]
    _check_stems(specifications)
    return Suite(name, tuple(specifications))


def _check_stems(specifications: Sequence[RunSpecification]) -> None:
    """Raise where two runs would be written to one file.

    :raises BenchmarkError: their names differ in case and punctuation alone
    """
    known: dict[str, RunSpecification] = {}
    for run in specifications:
        other = known.setdefault(run.stem, run)
        if other is not run:
            raise BenchmarkError(
                f"'{other.name}' and '{run.name}' would both be written to '{run.stem}.json': give "
                "algorithms and variants names that differ in letters a to z or digits."
            )


def _specification(
    recipe: Recipe,
    label: str,
    task: str,
    variant: str,
    seed: int,
    budget: int | None,
    protocol: Protocol,
    suite: SuiteRecord,
) -> RunSpecification:
    """Return one run; a budget given goes before the recipe's and the algorithm's."""
    algorithm = recipe.algorithms[label]
    return RunSpecification(
        label,
        algorithm,
        task,
        seed,
        budget or algorithm.budget or recipe.budget,
        protocol,
        {**recipe.tasks[task], **recipe.variants[variant]},
        own_budget=budget is None and algorithm.budget is not None,
        suite=suite,
        variant=variant,
        imports=recipe.imports,
    )


def find_label(wanted: str, labels: Iterable[str], where: str, what: str = "algorithm") -> str:
    """Return the label that is meant, whatever its case and punctuation.

    >>> find_label("rcnmp", ["RC-NMP", "REPS"], "the suite")
    'RC-NMP'

    :param wanted: as the user typed it
    :param labels: those that exist
    :param where: for the message
    :param what: they are, for the message
    :raises BenchmarkError: none of them is meant
    """
    known = list(labels)
    found = match_label(wanted, known)
    if found is None:
        raise BenchmarkError(f"{where} has no {what} '{wanted}'; it has {quoted(known)}.")
    return found


def match_label(wanted: str, labels: Iterable[str]) -> str | None:
    """Return the label that is meant, whatever its case and punctuation; None: none of them.

    :param wanted: as the user typed it
    :param labels: those that exist
    """
    return {_key(label): label for label in labels}.get(_key(wanted))


def quoted(labels: Iterable[str]) -> str:
    """Return labels in one line, each of them told apart though some hold commas.

    >>> quoted(["GA", "GA, judged"])
    "'GA', 'GA, judged'"

    :param labels: for a message
    """
    return ", ".join(f"'{label}'" for label in labels)


def _key(label: str) -> str:
    return re.sub(r"[^a-z0-9]", "", label.lower())


def parse_seeds(text: str) -> list[int]:
    """Read seeds as users type them: how many, a range, or a list.

    >>> parse_seeds("3"), parse_seeds("10-12"), parse_seeds("7,9")
    ([0, 1, 2], [10, 11, 12], [7, 9])

    :param text: ``"N"`` for the first N, ``"A-B"`` for A to B inclusive, ``"A,B,C"`` for these
    :raises BenchmarkError: none of these, or no seed at all
    """
    seeds: Sequence[int] = []
    if re.fullmatch(r"\d+", text):
        seeds = range(int(text))
    elif match := re.fullmatch(r"(\d+)-(\d+)", text):
        seeds = range(int(match[1]), int(match[2]) + 1)
    elif re.fullmatch(r"\d+(,\d+)+,?|\d+,", text):
        seeds = sorted({int(part) for part in text.split(",") if part})
    if not seeds:
        raise BenchmarkError(
            f"the seeds '{text}' name no seed; write how many (5), a range (10-19) or a list "
            "(3,7; a single one as '3,')."
        )
    if seeds[-1] >= 2**32 or (seeds[-1] - seeds[0] >= MOST_SEEDS and isinstance(seeds, range)):
        raise BenchmarkError(
            f"the seeds '{text}' go too far: they must be below 2^32, and a range name at most "
            f"{MOST_SEEDS}. Where you mean a single seed, write it with a comma ('7,')."
        )
    return list(seeds)
