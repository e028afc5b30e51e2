"""A genetic algorithm on trajectories: RC-NMP without its network."""

from baselines.ga.ga import GA
from baselines.ga.policies import GAPolicy

__all__ = ["GA", "GAPolicy"]
