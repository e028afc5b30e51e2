"""A skill over contexts, without demonstrations: bottles at random; RC-NMP's twins; 5 seeds."""

from dataclasses import replace

from results.algorithms import CONTEXTUAL_CMAES, CONTEXTUAL_REPS, GA, RCNMP
from results.harness.specification import Algorithm
from results.harness.suite import Recipe
from results.stream.protocol import Stream
from results.tuning.streams import TuningStream


def twin(regression: str) -> Algorithm:
    """Return RC-NMP's search over contexts, answered by a regression instead of a network.

    :param regression: which one
    """
    return replace(
        GA,
        settings={"policy_kwargs": {"regression": regression}},
        description=f"the same search, contexts answered by {regression}",
    )


ALGORITHMS = {
    "RC-NMP": RCNMP,
    "twin, Gaussian process": twin("gaussian-process"),
    "twin, nearest": twin("nearest"),
    "twin, ridge": twin("ridge"),
    "contextual REPS": CONTEXTUAL_REPS,
    "contextual CMA-ES": CONTEXTUAL_CMAES,
}
TASKS: dict[str, dict[str, object]] = {"nmp/Bottles-v0": {"random_bottles": True}}
TUNING = (TuningStream(0, 10_000, 100, 12),)
RECIPE = Recipe(ALGORITHMS, TASKS, 2000, 5, (Stream(0, 10_000, 1000),), tuning=TUNING)
