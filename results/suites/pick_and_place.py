"""Objects and towers taller than the demonstrated ones (thesis 5.2.4), 10 seeds."""

from dataclasses import replace

from benchmark_envs.tasks.pick_and_place_expert import EXTRAPOLATION_CONTEXTS
from results.adaptation.protocol import Extrapolation
from results.algorithms import (
    ACNMP,
    CMAES,
    EWERTON,
    REPS,
    STARK,
    SUM_ALONE,
    hand_tuned,
    thesis_acnmp,
    twin,
    twins,
    without_network,
)
from results.harness.suite import Recipe
from results.suites.push import FREE, RCNMP_FREE
from results.tuning.contexts import tuning_contexts

ALGORITHMS = {
    "ACNMP": ACNMP,
    "ACNMP, sum alone": replace(ACNMP, settings=SUM_ALONE),
    **twins("nearest", "ridge", "Gaussian process"),
    **hand_tuned(n_bases=8, shaped=0.5),
    "twin, nearest, sum alone": twin("nearest", **SUM_ALONE),
    "ACNMP (thesis)": thesis_acnmp(),
    "CMA-ES context": replace(
        CMAES, settings={"n_bases": 8, "context_std": 0.3, "population_size": 4}
    ),
    "ProMP+RL (Stark)": replace(STARK, settings={"population_size": 4}),
    "ProMP+RL (Ewerton)": replace(EWERTON, settings={"population_size": 4}),
    "REPS": replace(REPS, settings={"population_size": 10}),
    "RC-NMP": RCNMP_FREE,
    **without_network(**FREE),
}
TASKS: dict[str, dict[str, object]] = {"nmp/PickAndPlace-v1": {}}
PROTOCOLS = tuple(Extrapolation(target) for target in range(len(EXTRAPOLATION_CONTEXTS)))
TUNING = tuning_contexts("nmp/PickAndPlace-v1")
RECIPE = Recipe(
    ALGORITHMS,
    TASKS,
    100,
    10,
    PROTOCOLS,
    checkpoints=(0, 20, 50, 100),
    published=100,
    tuning=TUNING,
)
