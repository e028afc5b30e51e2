"""Robot skill learning by neural movement primitives, as Stable-Baselines3 algorithms."""

from sb3_nmp.acnmp import ACNMP, ACNMPPolicy, Exploration
from sb3_nmp.common.algorithm import TrajectoryAlgorithm
from sb3_nmp.common.cnmp import CNMPSettings, PretrainingSettings
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError, FileFormatError, InvalidDataError
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.rcnmp import RCNMP, TrainingSettings

__all__ = [
    "ACNMP",
    "RCNMP",
    "ACNMPPolicy",
    "CNMPSettings",
    "ConfigurationError",
    "Demonstrations",
    "Exploration",
    "FileFormatError",
    "InvalidDataError",
    "PDController",
    "PretrainingSettings",
    "SmoothNoise",
    "TrainingSettings",
    "TrajectoryAlgorithm",
]
