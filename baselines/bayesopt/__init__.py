"""Bayesian optimisation over the weights of a movement primitive, through BoTorch."""

from baselines.bayesopt.algorithms import BayesianPrimitiveSearch, LogEI, TuRBO

__all__ = ["BayesianPrimitiveSearch", "LogEI", "TuRBO"]
