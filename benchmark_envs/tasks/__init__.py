"""One file for each task; importing it registers the task."""

from benchmark_envs.tasks.aperture import ApertureTask
from benchmark_envs.tasks.arm_proxies import ArmPushTask, ArmReachTask, PegInsertionTask
from benchmark_envs.tasks.bottles import BottlesTask
from benchmark_envs.tasks.button_press import ButtonPressTask
from benchmark_envs.tasks.obstacles import ObstaclesTask
from benchmark_envs.tasks.pick_and_place import PickAndPlaceTask
from benchmark_envs.tasks.pouring import PouringTask
from benchmark_envs.tasks.push import PushTask
from benchmark_envs.tasks.via_points import ViaPointsTask

__all__ = [
    "ApertureTask",
    "ArmPushTask",
    "ArmReachTask",
    "BottlesTask",
    "ButtonPressTask",
    "ObstaclesTask",
    "PegInsertionTask",
    "PickAndPlaceTask",
    "PouringTask",
    "PushTask",
    "ViaPointsTask",
]
