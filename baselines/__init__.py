"""Methods from elsewhere, with the interface of Stable-Baselines3, and twins of our own."""

from baselines.bayesian import BO, BOPolicy
from baselines.bayesopt import LogEI, TuRBO
from baselines.cmaes import CMAES, ResidualPolicy
from baselines.contextual import ContextualCMAES, ContextualGaussianPolicy, ContextualREPS
from baselines.dreps import DREPS
from baselines.ga import GA, GAPolicy
from baselines.primitive_search import StartPolicy
from baselines.primitives import DMP, PDFiltered, Primitive, ProMP, Response, WeightDistribution
from baselines.promp_rl import (
    EwertonProMPRL,
    GaussianProcessPolicy,
    ProMPPolicy,
    ProMPRL,
    StarkProMPRL,
    TransferPolicy,
)
from baselines.quality_diversity import CMAME
from baselines.random_search import RandomSearch
from baselines.reps import REPS, GaussianPrimitivePolicy
from baselines.transfer import MomentRegression

__all__ = [
    "BO",
    "CMAES",
    "CMAME",
    "DMP",
    "DREPS",
    "GA",
    "REPS",
    "BOPolicy",
    "ContextualCMAES",
    "ContextualGaussianPolicy",
    "ContextualREPS",
    "EwertonProMPRL",
    "GAPolicy",
    "GaussianPrimitivePolicy",
    "GaussianProcessPolicy",
    "LogEI",
    "MomentRegression",
    "PDFiltered",
    "Primitive",
    "ProMP",
    "ProMPPolicy",
    "ProMPRL",
    "RandomSearch",
    "ResidualPolicy",
    "Response",
    "StarkProMPRL",
    "StartPolicy",
    "TransferPolicy",
    "TuRBO",
    "WeightDistribution",
]
