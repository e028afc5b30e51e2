"""Runs of a task and of algorithms that are named on the command line, from whichever package."""

from collections.abc import Sequence

from benchmark_envs import make_task
from results.algorithms import BY_NAME
from results.exceptions import BenchmarkError
from results.harness.plugins import bring_in, outside_algorithms
from results.harness.specification import Algorithm
from results.harness.suite import Recipe, find_label
from results.one_context.protocol import OneContext

BUDGET, N_SEEDS = 200, 5


def find_algorithm(name: str) -> Algorithm:
    """Return an algorithm of the benchmark, of an entry point, or of a class's path.

    >>> find_algorithm("RC-NMP").path, find_algorithm("baselines:REPS").name
    ('sb3_nmp:RCNMP', 'baselines:REPS')

    :param name: a stable name, an entry point's name, or ``"module:Class"``
    :raises BenchmarkError: none of these, or both of the first two
    """
    if ":" in name:
        return Algorithm(name, name)
    outside = outside_algorithms()
    known = [*BY_NAME, *(each for each in outside if each not in BY_NAME)]
    found = find_label(name, known, "the benchmark, with all installed packages,")
    if found in BY_NAME and found in outside:
        raise BenchmarkError(
            f"'{found}' is a name of the benchmark and of an entry point: say which is meant by "
            f"its class, {BY_NAME[found].path} or {outside[found]}."
        )
    return BY_NAME[found] if found in BY_NAME else Algorithm(found, outside[found])


def make_recipe(task: str, algorithms: Sequence[str], modules: Sequence[str]) -> Recipe:
    """Return runs in one context, which the seed draws.

    :param task: its id
    :param algorithms: see `find_algorithm`
    :param modules: to import first, here and in every worker
    :raises BenchmarkError: no algorithm, one that cannot be imported, or two of one name
    :raises UnknownTaskError: no such task
    """
    if not algorithms:
        raise BenchmarkError(f"--task {task} needs --algorithm, such as --algorithm ga.")
    bring_in(modules, task)
    make_task(task, n_threads=1)
    found: dict[str, Algorithm] = {}
    for algorithm in map(find_algorithm, algorithms):
        other = found.setdefault(label_of(algorithm), algorithm)
        if other != algorithm:
            raise BenchmarkError(
                f"{other.name} and {algorithm.name} would both be called '{label_of(algorithm)}': "
                "rename one of the classes, or run them in folders of their own."
            )
    for algorithm in found.values():
        algorithm.load()
    return Recipe(found, {task: {}}, BUDGET, N_SEEDS, (OneContext(),), imports=tuple(modules))


def label_of(algorithm: Algorithm) -> str:
    """Return how tables call an algorithm: its class, or its stable name.

    >>> label_of(find_algorithm("baselines:REPS")), label_of(find_algorithm("ga"))
    ('REPS', 'ga')

    :param algorithm: which one
    """
    return algorithm.name.rpartition(":")[2]
