"""All algorithms, each with settings that make a test quick; contract tests iterate over these."""

from importlib.util import find_spec
from typing import Any

import benchmark_envs  # noqa: F401  (registers the tasks)
from baselines import (
    BO,
    CMAES,
    CMAME,
    DREPS,
    GA,
    REPS,
    ContextualCMAES,
    ContextualREPS,
    EwertonProMPRL,
    LogEI,
    RandomSearch,
    StarkProMPRL,
    TuRBO,
)
from sb3_nmp import (
    ACNMP,
    RCNMP,
    ACNMPAdaptation,
    CNMPArchitecture,
    CNMPPretraining,
    Demonstrations,
    RCNMPTraining,
    TrajectoryAlgorithm,
)

ENV_ID = "nmp/Bottles-v0"
POPULATION = 8
DEMONSTRATIONS = Demonstrations.from_task(ENV_ID, 3, seed=0)
SMALL = CNMPArchitecture(encoder_arch=(16,), decoder_arch=(16,))
QUICK_BAYESIAN = {"n_initial": POPULATION, "n_bases": 3, "max_iterations": 3}
ALGORITHMS: dict[type[TrajectoryAlgorithm], dict[str, Any]] = {
    RCNMP: {"population_size": POPULATION, "n_crossover": 4, "training": RCNMPTraining(5)},
    GA: {"population_size": POPULATION, "n_crossover": 4},
    REPS: {"population_size": POPULATION},
    DREPS: {"population_size": POPULATION},
    StarkProMPRL: {"population_size": POPULATION, "demonstrations": DEMONSTRATIONS},
    EwertonProMPRL: {"population_size": POPULATION, "demonstrations": DEMONSTRATIONS},
    ACNMP: {
        "population_size": POPULATION,
        "demonstrations": DEMONSTRATIONS,
        "pretraining": CNMPPretraining(20),
        "adaptation": ACNMPAdaptation(n_training_steps=3, n_assimilation_steps=3),
        "policy_kwargs": {"cnmp": SMALL},
    },
    BO: {"population_size": POPULATION, "demonstrations": DEMONSTRATIONS},
    CMAES: {
        "population_size": POPULATION,
        "demonstrations": DEMONSTRATIONS,
        "pretraining": CNMPPretraining(20),
        "context_std": 0.3,
        "policy_kwargs": {"cnmp": SMALL},
    },
    ContextualREPS: {"population_size": POPULATION, "value_features": "linear"},
    ContextualCMAES: {"population_size": POPULATION},
    RandomSearch: {"population_size": POPULATION},
    TuRBO: {"population_size": POPULATION, **QUICK_BAYESIAN, "n_candidates": 50},
    LogEI: {"population_size": POPULATION, **QUICK_BAYESIAN, "n_samples": 8, "n_raw": 4},
}
if find_spec("ribs"):  # it needs NumPy 2, which the oldest versions are older than
    ALGORITHMS[CMAME] = {"population_size": POPULATION, "n_emitters": 2}
