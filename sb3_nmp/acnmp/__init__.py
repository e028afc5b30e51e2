"""Adaptive Conditional Neural Movement Primitives (thesis chapter 5)."""

from sb3_nmp.acnmp.acnmp import ACNMP
from sb3_nmp.acnmp.exploration import Exploration
from sb3_nmp.acnmp.policies import ACNMPPolicy

__all__ = ["ACNMP", "ACNMPPolicy", "Exploration"]
