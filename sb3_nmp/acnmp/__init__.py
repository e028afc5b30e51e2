"""Adaptive Conditional Neural Movement Primitives (thesis chapter 5)."""

from sb3_nmp.acnmp.algorithm import ACNMP
from sb3_nmp.acnmp.policy import ACNMPPolicy
from sb3_nmp.acnmp.settings import ACNMPAdaptation, ACNMPExploration
from sb3_nmp.bayesian.settings import ACNMPCritic

__all__ = ["ACNMP", "ACNMPAdaptation", "ACNMPCritic", "ACNMPExploration", "ACNMPPolicy"]
