"""Bayesian optimisation around a regression's answer: ACNMP without its network."""

from baselines.bayesian.bo import BO
from baselines.bayesian.policies import BOPolicy

__all__ = ["BO", "BOPolicy"]
