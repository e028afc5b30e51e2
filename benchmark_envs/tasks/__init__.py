"""One file a task; importing it registers the task."""

from benchmark_envs.tasks.bottles import BottlesTask

__all__ = ["BottlesTask"]
