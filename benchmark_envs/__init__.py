"""Trajectory-bandit tasks in MuJoCo; importing this package registers them with Gymnasium.

`TrajectoryVecEnv` is loaded when it is asked for first: it needs Stable-Baselines3, and that torch.
"""

from typing import TYPE_CHECKING, Any

from benchmark_envs import backend as _mujoco_first  # noqa: F401
from benchmark_envs.cache import ContextCache
from benchmark_envs.checking import check_task
from benchmark_envs.exceptions import (
    InvalidContextError,
    InvalidTrajectoryError,
    RenderingUnavailableError,
    TaskContractError,
    TaskError,
    UnknownTaskError,
)
from benchmark_envs.executor import BatchExecutor, SensorLog
from benchmark_envs.motion import interpolate, limit_speed, minimum_jerk, resample
from benchmark_envs.mujoco_task import MujocoTask
from benchmark_envs.registry import make_task, register_task, task_ids
from benchmark_envs.rendering import draw
from benchmark_envs.rollouts import Measured, Rollouts
from benchmark_envs.splits import extrapolation, leave_one_out
from benchmark_envs.task import Task
from benchmark_envs.tasks import (
    ApertureTask,
    ArmPushTask,
    ArmReachTask,
    BottlesTask,
    ButtonPressTask,
    ObstaclesTask,
    PegInsertionTask,
    PickAndPlaceTask,
    PouringTask,
    PushTask,
    ViaPointsTask,
)
from benchmark_envs.trajectory_env import TrajectoryEnv
from benchmark_envs.workers import register_in_workers
from benchmark_envs.wrappers import (
    ActionController,
    ContextSource,
    Controller,
    FetchExpert,
    FunctionController,
    MovementPrimitive,
    MovementPrimitiveWrapper,
    PositionController,
    TrajectoryActionWrapper,
    fetch_env,
)

register_in_workers()

if TYPE_CHECKING:
    from benchmark_envs.trajectory_vec_env import TrajectoryVecEnv

__all__ = [
    "ActionController",
    "ApertureTask",
    "ArmPushTask",
    "ArmReachTask",
    "BatchExecutor",
    "BottlesTask",
    "ButtonPressTask",
    "ContextCache",
    "ContextSource",
    "Controller",
    "FetchExpert",
    "FunctionController",
    "InvalidContextError",
    "InvalidTrajectoryError",
    "Measured",
    "MovementPrimitive",
    "MovementPrimitiveWrapper",
    "MujocoTask",
    "ObstaclesTask",
    "PegInsertionTask",
    "PickAndPlaceTask",
    "PositionController",
    "PouringTask",
    "PushTask",
    "RenderingUnavailableError",
    "Rollouts",
    "SensorLog",
    "Task",
    "TaskContractError",
    "TaskError",
    "TrajectoryActionWrapper",
    "TrajectoryEnv",
    "TrajectoryVecEnv",
    "UnknownTaskError",
    "ViaPointsTask",
    "check_task",
    "draw",
    "extrapolation",
    "fetch_env",
    "interpolate",
    "leave_one_out",
    "limit_speed",
    "make_task",
    "minimum_jerk",
    "register_task",
    "resample",
    "task_ids",
]


def __getattr__(name: str) -> Any:  # noqa: ANN401
    if name != "TrajectoryVecEnv":
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    from benchmark_envs.trajectory_vec_env import TrajectoryVecEnv

    return TrajectoryVecEnv
