"""Reward Conditioned Neural Movement Primitives (thesis chapter 6)."""

from sb3_nmp.rcnmp.achievement import RCNMPAchievement
from sb3_nmp.rcnmp.algorithm import RCNMP
from sb3_nmp.rcnmp.policy import RCNMPPolicy
from sb3_nmp.rcnmp.reward_model import RCNMPRewardModel
from sb3_nmp.rcnmp.skill import RCNMPSkill
from sb3_nmp.rcnmp.training import RCNMPTraining

__all__ = [
    "RCNMP",
    "RCNMPAchievement",
    "RCNMPPolicy",
    "RCNMPRewardModel",
    "RCNMPSkill",
    "RCNMPTraining",
]
