"""Baselines on movement primitives, with the interface of Stable-Baselines3."""

from baselines.dreps import DREPS
from baselines.ga import GA, ElitePolicy
from baselines.primitives import DMP, PDFiltered, Primitive, ProMP, Response, WeightDistribution
from baselines.reps import REPS, GaussianPrimitivePolicy

__all__ = [
    "DMP",
    "DREPS",
    "GA",
    "REPS",
    "ElitePolicy",
    "GaussianPrimitivePolicy",
    "PDFiltered",
    "Primitive",
    "ProMP",
    "Response",
    "WeightDistribution",
]
