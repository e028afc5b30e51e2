"""A skill over contexts, without demonstrations: pushing to targets at random; 5 seeds."""

from dataclasses import replace

from results.algorithms import RCNMP
from results.harness.suite import Recipe
from results.stream.protocol import Stream
from results.suites.random_bottles import ALGORITHMS as WITH_TWINS

ALGORITHMS = {
    **WITH_TWINS,
    "RC-NMP, no relabelling": replace(
        RCNMP,
        settings={"relabel": False},
        description="a rollout counts for its own target alone, not for where the cylinder stopped",
    ),
}
TASKS: dict[str, dict[str, object]] = {"nmp/Push-v0": {"reward": "goal"}}
RECIPE = Recipe(ALGORITHMS, TASKS, 3000, 5, (Stream(0, 100_000, 500, n_evaluations=10),))
