"""Faces of environments: what a context is, and what an action is before it is executed."""

from benchmark_envs.wrappers.context_source import ContextSource
from benchmark_envs.wrappers.controllers import (
    ActionController,
    Controller,
    FunctionController,
    PositionController,
)
from benchmark_envs.wrappers.fetch import FetchExpert, fetch_env
from benchmark_envs.wrappers.movement_primitive import MovementPrimitive, MovementPrimitiveWrapper
from benchmark_envs.wrappers.trajectory_action import TrajectoryActionWrapper

__all__ = [
    "ActionController",
    "ContextSource",
    "Controller",
    "FetchExpert",
    "FunctionController",
    "MovementPrimitive",
    "MovementPrimitiveWrapper",
    "PositionController",
    "TrajectoryActionWrapper",
    "fetch_env",
]
