"""Reward Conditioned Neural Movement Primitives (thesis chapter 6)."""

from sb3_nmp.rcnmp.algorithm import RCNMP
from sb3_nmp.rcnmp.policy import RCNMPPolicy
from sb3_nmp.rcnmp.settings import RCNMPAchievement, RCNMPRewardModel, RCNMPSkill, RCNMPTraining

__all__ = [
    "RCNMP",
    "RCNMPAchievement",
    "RCNMPPolicy",
    "RCNMPRewardModel",
    "RCNMPSkill",
    "RCNMPTraining",
]
