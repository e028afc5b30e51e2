"""Faces of environments: what an action is, before it reaches the environment."""

from benchmark_envs.wrappers.movement_primitive import MovementPrimitive, MovementPrimitiveWrapper

__all__ = ["MovementPrimitive", "MovementPrimitiveWrapper"]
