"""Parallel processes, one thread each."""

from collections.abc import Iterable, Iterator
from typing import Any, cast

from joblib import Parallel, cpu_count, parallel_config


def in_processes(jobs: Iterable[Any], n_jobs: int, n_workers: int | None) -> Iterator[Any]:
    """Do jobs, and yield what each returns as soon as it has ended.

    :param jobs: calls that joblib's ``delayed`` made
    :param n_jobs: how many there are
    :param n_workers: processes; one per core by default
    """
    n_workers = max(1, min(n_workers or cpu_count(), n_jobs))
    with parallel_config(backend="loky", inner_max_num_threads=1):
        parallel = Parallel(n_jobs=n_workers, return_as="generator_unordered")
        yield from cast(Iterator[Any], parallel(jobs))
