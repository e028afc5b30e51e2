"""REPS: relative entropy policy search over the weights of a movement primitive."""

from baselines.reps.gaussian_search import GaussianSearch
from baselines.reps.policies import GaussianPrimitivePolicy
from baselines.reps.reps import REPS

__all__ = ["REPS", "GaussianPrimitivePolicy", "GaussianSearch"]
