"""Skill transfer between robots through a shared latent space (thesis 5.1, Eq. 5.4)."""

from sb3_nmp.transfer.settings import TransferTraining
from sb3_nmp.transfer.skill_transfer import SkillTransfer

__all__ = ["SkillTransfer", "TransferTraining"]
