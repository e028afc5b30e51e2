"""The list of tasks: one line beside each task's definition puts it here and into Gymnasium."""

import difflib
import inspect
from collections.abc import Callable
from typing import Any, TypeVar

import gymnasium as gym
from gymnasium.envs.registration import parse_env_id

from benchmark_envs.exceptions import TaskError, UnknownTaskError
from benchmark_envs.task import Task

T = TypeVar("T", bound=type[Task])

_TASKS: dict[str, type[Task]] = {}


def register_task(task_id: str) -> Callable[[T], T]:
    """Class decorator: register a task here and its `TrajectoryEnv` with Gymnasium.

    :param task_id: such as ``"nmp/Bottles-v0"``
    :raises TaskError: Gymnasium takes no such id, another class has it, or what is registered is
        no `Task`
    """
    if not isinstance(task_id, str):
        raise TaskError(
            f"register_task is given {task_id!r}; it needs the task's id, such as "
            "@register_task('mylab/HitBall-v0')."
        )
    try:
        parse_env_id(task_id)
    except gym.error.Error as error:
        raise TaskError(
            f"the task's id is '{task_id}'; Gymnasium's ids look like 'mylab/HitBall-v0'."
        ) from error

    def register(task_class: T) -> T:
        _check_class(task_id, task_class)
        gym.register(
            id=task_id,
            entry_point="benchmark_envs.trajectory_env:TrajectoryEnv",
            kwargs={"task": task_id},
        )
        _TASKS[task_id] = task_class
        return task_class

    return register


def _check_class(task_id: str, task_class: object) -> None:
    """Raise where a class cannot be registered under an id; one that is loaded anew can.

    :raises TaskError: it is no `Task`, or another class has the id
    """
    if not (isinstance(task_class, type) and issubclass(task_class, Task)):
        raise TaskError(f"{task_class!r} is registered as '{task_id}'; it must be a class of Task.")
    there = _TASKS.get(task_id)
    if there is None:
        return
    names = [f"{each.__module__}.{each.__qualname__}" for each in (there, task_class)]
    if names[0] != names[1]:
        raise TaskError(
            f"'{task_id}' is registered twice, as {names[0]} and as {names[1]}: give one of them "
            "another id."
        )


def task_ids() -> list[str]:
    """Return the ids of all registered tasks."""
    return sorted(_TASKS)


def make_task(task_id: str, n_threads: int | None = None, **settings: Any) -> Task:  # noqa: ANN401
    """Build a task.

    >>> make_task("nmp/Push-v0", reward="goal").settings
    {'reward': 'goal'}

    :param task_id: one of `task_ids`
    :param n_threads: of the simulator, by default one per core; a task that simulates nothing
        ignores it
    :param settings: the arguments of the task's constructor that change it
    :raises UnknownTaskError: no task of that id
    :raises TaskError: the task has no such setting
    """
    if not isinstance(task_id, str) or task_id not in _TASKS:
        close = difflib.get_close_matches(str(task_id), _TASKS, n=1, cutoff=0.5)
        hint = f" Did you mean '{close[0]}'?" if close else ""
        raise UnknownTaskError(
            f"no task '{task_id}' is registered.{hint} There are: {', '.join(task_ids())}."
        )
    task_class = _TASKS[task_id]
    names = task_class.setting_names()
    unknown = sorted(set(settings) - set(names))
    if unknown:
        raise TaskError(
            f"{task_id} has no setting '{unknown[0]}'; it has: {', '.join(names) or 'none'}."
        )
    if "n_threads" in inspect.signature(task_class).parameters:
        settings["n_threads"] = n_threads
    return task_class(**settings)
