"""ProMP+RL: movement primitives learned from demonstrations, adapted by reinforcement learning."""

from baselines.promp_rl.policies import GaussianProcessPolicy, ProMPPolicy, TransferPolicy
from baselines.promp_rl.promp_rl import EwertonProMPRL, ProMPRL, StarkProMPRL

__all__ = [
    "EwertonProMPRL",
    "GaussianProcessPolicy",
    "ProMPPolicy",
    "ProMPRL",
    "StarkProMPRL",
    "TransferPolicy",
]
