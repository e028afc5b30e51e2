"""Trajectory-bandit tasks in MuJoCo; importing this package registers them with Gymnasium."""

from benchmark_envs.exceptions import (
    InvalidContextError,
    InvalidTrajectoryError,
    RenderingUnavailableError,
    TaskError,
    UnknownTaskError,
)
from benchmark_envs.registry import make_task, register_task, task_ids
from benchmark_envs.splits import extrapolation, leave_one_out
from benchmark_envs.task import Rollouts, Task
from benchmark_envs.tasks import (
    ApertureTask,
    BottlesTask,
    PickAndPlaceTask,
    PouringTask,
    PushTask,
)
from benchmark_envs.trajectory_env import TrajectoryEnv
from benchmark_envs.trajectory_vec_env import TrajectoryVecEnv

__all__ = [
    "ApertureTask",
    "BottlesTask",
    "InvalidContextError",
    "InvalidTrajectoryError",
    "PickAndPlaceTask",
    "PouringTask",
    "PushTask",
    "RenderingUnavailableError",
    "Rollouts",
    "Task",
    "TaskError",
    "TrajectoryEnv",
    "TrajectoryVecEnv",
    "UnknownTaskError",
    "extrapolation",
    "leave_one_out",
    "make_task",
    "register_task",
    "task_ids",
]
