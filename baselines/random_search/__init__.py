"""Random search: the best of smooth perturbations."""

from baselines.random_search.random_search import RandomSearch

__all__ = ["RandomSearch"]
