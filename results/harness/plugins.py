"""Tasks and algorithms from other packages: named modules, and entry points of what is installed.

An entry point of the group ``sb3_nmp.tasks`` names a module whose import registers tasks; one of
``sb3_nmp.algorithms`` names an algorithm's class, ``module:Class``. Nothing of others is imported
before it is asked for.
"""

import os
import sys
from collections.abc import Iterable
from importlib import import_module
from importlib.metadata import entry_points

from benchmark_envs import task_ids
from results.exceptions import BenchmarkError

TASKS, ALGORITHMS = "sb3_nmp.tasks", "sb3_nmp.algorithms"


def bring_in(modules: Iterable[str], task: str) -> None:
    """Import what a run needs from elsewhere, in whichever process it takes place.

    :param modules: to import; those in the working directory are found too
    :param task: its id; where it is not registered then, entry points are asked
    :raises BenchmarkError: a module cannot be imported
    """
    import_modules(modules)
    if task not in task_ids():
        for point in sorted(entry_points(group=TASKS), key=lambda point: point.name):
            _import(point.module, f"the entry point '{point.name}'")


def import_modules(modules: Iterable[str]) -> None:
    """Import modules of others; those in the working directory are found too.

    :param modules: their names
    :raises BenchmarkError: one cannot be imported
    """
    for module in modules:
        _import(module, "--import")


def outside_algorithms() -> dict[str, str]:
    """Return the paths of installed packages' algorithms by the names of their entry points."""
    return {point.name: point.value for point in entry_points(group=ALGORITHMS)}


def _import(module: str, named_by: str) -> None:
    """Import a module; a process of the benchmark's own finds what lies where it was started."""
    if os.getcwd() not in sys.path and "" not in sys.path:
        sys.path.append(os.getcwd())
    try:
        import_module(module)
    except Exception as error:  # whatever a foreign module does when it is imported
        raise BenchmarkError(
            f"the module '{module}' of {named_by} cannot be imported in process {os.getpid()} "
            f"({type(error).__name__}: {error}). Every worker process imports it: install its "
            "package ('pip install -e .'), or name its folder in PYTHONPATH."
        ) from error
