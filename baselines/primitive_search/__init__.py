"""What all searches over the weights of a movement primitive share."""

from baselines.primitive_search.algorithm import PrimitiveSearch, PrimitiveSearchArguments
from baselines.primitive_search.points import PointSearch
from baselines.primitive_search.policies import StartPolicy

__all__ = ["PointSearch", "PrimitiveSearch", "PrimitiveSearchArguments", "StartPolicy"]
