"""All algorithms, each with settings that make a test quick; contract tests iterate over these."""

from typing import Any

from baselines.dreps import DREPS
from baselines.ga import GA
from baselines.reps import REPS
from sb3_nmp import RCNMP, TrainingSettings, TrajectoryAlgorithm

ENV_ID = "nmp/Bottles-v0"
ALGORITHMS: dict[type[TrajectoryAlgorithm], dict[str, Any]] = {
    RCNMP: {"n_sampled": 4, "n_crossover": 4, "training": TrainingSettings(5)},
    GA: {"n_copies": 4, "n_crossover": 4},
    REPS: {"population_size": 8},
    DREPS: {"population_size": 8},
}
POPULATION = 8
