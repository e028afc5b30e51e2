"""CMA-ES over a residual of what demonstrations teach."""

from baselines.cmaes.cmaes import CMAES
from baselines.cmaes.policies import ResidualPolicy

__all__ = ["CMAES", "ResidualPolicy"]
