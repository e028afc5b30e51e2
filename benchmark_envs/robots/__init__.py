"""Your own arm, from its MJCF file to a trajectory bandit; and limits that a motion must keep."""

from benchmark_envs.robots.arm import PEG_ARM, Arm
from benchmark_envs.robots.arm_task import ArmTask
from benchmark_envs.robots.expert import follow
from benchmark_envs.robots.motion_limits import MotionLimits, Violation
from benchmark_envs.robots.via_poses import ViaPose

__all__ = ["PEG_ARM", "Arm", "ArmTask", "MotionLimits", "ViaPose", "Violation", "follow"]
