"""A skill over contexts, without demonstrations: pouring amounts at random; 5 seeds."""

from results.harness.suite import Recipe
from results.stream.protocol import Stream
from results.suites.random_bottles import ALGORITHMS

TASKS: dict[str, dict[str, object]] = {"nmp/Pouring-v1": {}}
RECIPE = Recipe(ALGORITHMS, TASKS, 500, 5, (Stream(0, 100_000, 100, n_evaluations=3),))
