"""Quality diversity: many different solutions from one search, through pyribs."""

from baselines.quality_diversity.cma_me import CMAME

__all__ = ["CMAME"]
