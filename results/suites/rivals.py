"""Rivals on the bottles: all methods that search in one context, with one budget, 10 seeds."""

from dataclasses import replace

from results.algorithms import (
    ARS,
    CMAES,
    DREPS,
    GA,
    JUDGED_GA,
    LOG_EI,
    PPO,
    RANDOM_SEARCH,
    RCNMP,
    REPS,
    SAC,
    TURBO,
)
from results.harness.suite import Recipe
from results.one_context.protocol import OneContext
from sb3_nmp import PDController

#: ten smooth bases through the PD controller, as the other searches of this suite have
CMAES_FREE = replace(
    CMAES,
    settings={"n_bases": 10, "pd_controller": PDController(), "population_size": 12},
    description="CMA-ES over the weights of smooth bases",
    pretrained=False,
)
ALGORITHMS = {
    "RC-NMP": RCNMP,
    "GA": GA,
    "GA, judged": JUDGED_GA,
    "REPS": REPS,
    "DREPS": DREPS,
    "CMA-ES": CMAES_FREE,
    "TuRBO": TURBO,
    "LogEI": LOG_EI,
    "PPO": PPO,
    "SAC": SAC,
    "ARS": ARS,
    "random search": RANDOM_SEARCH,
}
TASKS: dict[str, dict[str, object]] = {"nmp/Bottles-v0": {}}
RECIPE = Recipe(ALGORITHMS, TASKS, budget=400, n_seeds=10, protocols=(OneContext(),))
