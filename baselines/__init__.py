"""Methods from elsewhere that ours are compared with, with the interface of Stable-Baselines3."""

from baselines.bayesian import BO, BOPolicy
from baselines.cmaes import CMAES, ResidualPolicy
from baselines.dreps import DREPS
from baselines.ga import GA, GAPolicy
from baselines.primitives import DMP, PDFiltered, Primitive, ProMP, Response, WeightDistribution
from baselines.promp_rl import (
    EwertonProMPRL,
    GaussianProcessPolicy,
    ProMPPolicy,
    ProMPRL,
    StarkProMPRL,
    TransferPolicy,
)
from baselines.reps import REPS, GaussianPrimitivePolicy

__all__ = [
    "BO",
    "CMAES",
    "DMP",
    "DREPS",
    "GA",
    "REPS",
    "BOPolicy",
    "EwertonProMPRL",
    "GAPolicy",
    "GaussianPrimitivePolicy",
    "GaussianProcessPolicy",
    "PDFiltered",
    "Primitive",
    "ProMP",
    "ProMPPolicy",
    "ProMPRL",
    "ResidualPolicy",
    "Response",
    "StarkProMPRL",
    "TransferPolicy",
    "WeightDistribution",
]
