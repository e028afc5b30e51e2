"""Parallel processes, one thread each, that end with the process that started them."""

import os
import threading
import time
from collections.abc import Iterable, Iterator
from typing import Any, cast

from joblib import Parallel, cpu_count, delayed, parallel_config

#: how often a worker looks whether its parent is still there, in s
LOOK_EVERY = 1.0


def in_processes(jobs: Iterable[Any], n_jobs: int, n_workers: int | None) -> Iterator[Any]:
    """Do jobs, and yield what each returns as soon as it has ended.

    :param jobs: calls that joblib's ``delayed`` made
    :param n_jobs: how many there are
    :param n_workers: processes; one per core by default
    """
    n_workers = max(1, min(n_workers or cpu_count(), n_jobs))
    with parallel_config(backend="loky", inner_max_num_threads=1):
        parallel = Parallel(n_jobs=n_workers, return_as="generator_unordered")
        watched = (delayed(_watched)(os.getpid(), job) for job in jobs)
        yield from cast(Iterator[Any], parallel(watched))


def _watched(parent: int, job: tuple[Any, tuple[Any, ...], dict[str, Any]]) -> Any:  # noqa: ANN401
    """Do a job in a process that ends when its parent is gone.

    A parent that was killed cannot tell its workers, and joblib's would wait for more work.

    :param parent: process id
    :param job: function, arguments and keyword arguments, as ``delayed`` returns them
    """
    function, arguments, keywords = job
    if os.getpid() != parent and not _is_watching():
        threading.Thread(target=_end_with, args=(parent,), name=_WATCH, daemon=True).start()
    return function(*arguments, **keywords)


_WATCH = "ends with its parent"


def _is_watching() -> bool:
    return any(thread.name == _WATCH for thread in threading.enumerate())


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(LOOK_EVERY)
    os._exit(1)  # nobody is left to hear of an exception
