"""Pouring amounts far beyond the demonstrated ones (thesis 5.2.4), 10 seeds."""

from dataclasses import replace

from benchmark_envs.tasks.pouring import EXTRAPOLATION_CONTEXTS
from results.adaptation.protocol import Extrapolation
from results.algorithms import (
    ACNMP,
    CMAES,
    DREPS,
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

#: of RC-NMP and its twins: three generations in all
SMALL = FREE | {"population_size": 6, "n_crossover": 2}
ALGORITHMS = {
    "ACNMP": ACNMP,
    "ACNMP, sum alone": replace(ACNMP, settings=SUM_ALONE),
    **twins("nearest", "ridge", "Gaussian process"),
    **hand_tuned(n_bases=4, shaped=0.5),
    "twin, ridge, sum alone": twin("ridge", **SUM_ALONE),
    "ACNMP (thesis)": thesis_acnmp(),
    "CMA-ES context": replace(CMAES, settings={"n_bases": 4, "context_std": 0.3}),
    "ProMP+RL (Stark)": replace(STARK, settings={"population_size": 6}),
    "ProMP+RL (Ewerton)": replace(EWERTON, settings={"population_size": 9}),
    "REPS": replace(REPS, settings={"population_size": 9}),
    "DREPS": replace(DREPS, settings={"population_size": 9}),
    "RC-NMP": replace(RCNMP_FREE, settings=SMALL),
    **without_network(**SMALL),
}
TASKS: dict[str, dict[str, object]] = {"nmp/Pouring-v1": {}}
PROTOCOLS = tuple(Extrapolation(target) for target in range(len(EXTRAPOLATION_CONTEXTS)))
TUNING = tuning_contexts("nmp/Pouring-v1")
RECIPE = Recipe(
    ALGORITHMS,
    TASKS,
    18,
    10,
    PROTOCOLS,
    checkpoints=(0, 6, 12, 18),
    published=18,
    tuning=TUNING,
)
