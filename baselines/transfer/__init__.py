"""What one robot shows told to another without a network: the twin of `sb3_nmp.SkillTransfer`."""

from baselines.transfer.moment_regression import MomentRegression

__all__ = ["MomentRegression"]
