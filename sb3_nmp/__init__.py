"""Robot skill learning by neural movement primitives, as Stable-Baselines3 algorithms."""

from sb3_nmp.acnmp import ACNMP, ACNMPAdaptation, ACNMPCritic, ACNMPExploration, ACNMPPolicy
from sb3_nmp.acnmp.distribution import TrajectoryDistribution
from sb3_nmp.bayesian.settings import ShapedExploration
from sb3_nmp.checking import check_algorithm
from sb3_nmp.common.algorithm import TrajectoryAlgorithm
from sb3_nmp.common.contextual import ContextualExploration
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import (
    AlgorithmContractError,
    ConfigurationError,
    ContextWarning,
    DemonstrationWarning,
    FileFormatError,
    InvalidDataError,
    PickleWarning,
    ResumeWarning,
    UnknownArgumentError,
    UnsafeFileError,
    UntrainedWarning,
    ViaPointWarning,
)
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.normalization import load_vec_normalize, save_vec_normalize
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.common.resampling import resample
from sb3_nmp.models.architecture import CNMPArchitecture
from sb3_nmp.models.cnmp_training import CNMPPretraining
from sb3_nmp.rcnmp import (
    RCNMP,
    RCNMPAchievement,
    RCNMPPolicy,
    RCNMPRewardModel,
    RCNMPSkill,
    RCNMPTraining,
)
from sb3_nmp.transfer import SkillTransfer, TransferTraining

__all__ = [
    "ACNMP",
    "RCNMP",
    "ACNMPAdaptation",
    "ACNMPCritic",
    "ACNMPExploration",
    "ACNMPPolicy",
    "AlgorithmContractError",
    "CNMPArchitecture",
    "CNMPPretraining",
    "ConfigurationError",
    "ContextWarning",
    "ContextualExploration",
    "DemonstrationWarning",
    "Demonstrations",
    "FileFormatError",
    "InvalidDataError",
    "PDController",
    "PickleWarning",
    "RCNMPAchievement",
    "RCNMPPolicy",
    "RCNMPRewardModel",
    "RCNMPSkill",
    "RCNMPTraining",
    "ResumeWarning",
    "ShapedExploration",
    "SkillTransfer",
    "SmoothNoise",
    "TrajectoryAlgorithm",
    "TrajectoryDistribution",
    "TransferTraining",
    "UnknownArgumentError",
    "UnsafeFileError",
    "UntrainedWarning",
    "ViaPointWarning",
    "check_algorithm",
    "load_vec_normalize",
    "resample",
    "save_vec_normalize",
]
