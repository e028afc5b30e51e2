"""Contextual policy search: one search distribution over all contexts."""

from baselines.contextual.cmaes import ContextualCMAES
from baselines.contextual.policies import ContextualGaussianPolicy
from baselines.contextual.reps import ContextualREPS

__all__ = ["ContextualCMAES", "ContextualGaussianPolicy", "ContextualREPS"]
