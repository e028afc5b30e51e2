"""Reward Conditioned Neural Movement Primitives (thesis chapter 6)."""

from sb3_nmp.rcnmp.policies import RCNMPPolicy
from sb3_nmp.rcnmp.rcnmp import RCNMP
from sb3_nmp.rcnmp.training import TrainingSettings

__all__ = ["RCNMP", "RCNMPPolicy", "TrainingSettings"]
