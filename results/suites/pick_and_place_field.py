"""Object and goal anywhere on a field of 30 x 30 cm, six numbers a context: a stream; 3 seeds."""

from dataclasses import replace

from results.algorithms import ACNMP, twins
from results.harness.suite import Recipe
from results.stream.protocol import Stream

#: settings of ACNMP and of its twins
SEARCH: dict[str, object] = {
    "n_contexts": 20,
    # 99 of 100 rollouts above the first one succeed (`PickAndPlaceTask`), and what is learned is to
    # be better than what suffices.
    "reward_threshold": (-0.04, -0.02),
}
ALGORITHMS = {
    "ACNMP": replace(ACNMP, settings=SEARCH),
    **twins("nearest", "ridge", "quadratic", "Gaussian process", **SEARCH),
}
TASKS: dict[str, dict[str, object]] = {"nmp/PickAndPlace-v1": {"field": True}}
RECIPE = Recipe(ALGORITHMS, TASKS, 1000, 3, (Stream(40, 5000, 500, n_evaluations=1),))
