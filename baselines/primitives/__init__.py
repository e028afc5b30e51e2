"""Movement primitives: trajectories with few parameters, vectorised over rollouts."""

from baselines.primitives.dmp import DMP
from baselines.primitives.pd_filtered import PDFiltered
from baselines.primitives.primitive import Primitive, Response
from baselines.primitives.promp import ProMP
from baselines.primitives.weight_distribution import WeightDistribution

__all__ = ["DMP", "PDFiltered", "Primitive", "ProMP", "Response", "WeightDistribution"]
