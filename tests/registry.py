"""All algorithms, each with settings that make a test quick; contract tests iterate over these."""

from typing import Any

import benchmark_envs  # noqa: F401  (registers the tasks)
from baselines import CMAES, DREPS, GA, REPS, EwertonProMPRL, StarkProMPRL
from sb3_nmp import ACNMP, RCNMP, Demonstrations, TrainingSettings, TrajectoryAlgorithm
from sb3_nmp.common.cnmp import CNMPSettings, PretrainingSettings

ENV_ID = "nmp/Bottles-v0"
POPULATION = 8
DEMONSTRATIONS = Demonstrations.from_task(ENV_ID, 3, seed=0)
ALGORITHMS: dict[type[TrajectoryAlgorithm], dict[str, Any]] = {
    RCNMP: {"n_sampled": 4, "n_crossover": 4, "training": TrainingSettings(5)},
    GA: {"n_copies": 4, "n_crossover": 4},
    REPS: {"population_size": POPULATION},
    DREPS: {"population_size": POPULATION},
    StarkProMPRL: {"population_size": POPULATION, "demonstrations": DEMONSTRATIONS},
    EwertonProMPRL: {"population_size": POPULATION, "demonstrations": DEMONSTRATIONS},
    ACNMP: {
        "population_size": POPULATION,
        "demonstrations": DEMONSTRATIONS,
        "pretraining": PretrainingSettings(20),
        "n_training_steps": 3,
        "n_assimilation_steps": 3,
        "policy_kwargs": {"cnmp": CNMPSettings(encoder_arch=(16,), decoder_arch=(16,))},
    },
    CMAES: {
        "population_size": POPULATION,
        "demonstrations": DEMONSTRATIONS,
        "pretraining": PretrainingSettings(20),
        "context_std": 0.3,
    },
}
