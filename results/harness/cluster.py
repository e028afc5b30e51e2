"""Runs on a Ray cluster, for work that outgrows one machine.

Nodes need this package installed and share no folder: each returns its record, which the process
that asked for it writes. A run whose node has gone is done again elsewhere.
"""

import os
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from results.exceptions import BenchmarkError

#: how often a run whose node or process has gone is begun anew
RETRIES = 3
#: of Ray: the cluster to join; without it one is made of this machine's cores
ADDRESS = "RAY_ADDRESS"
CONNECT_SECONDS = 10.0


class ClusterGoneError(BenchmarkError):
    """A cluster that was there does not answer any more."""


@contextmanager
def connected() -> Iterator[Any]:
    """Connect to the cluster that `ADDRESS` names, or to one of this machine, for a while.

    :raises BenchmarkError: Ray is not installed, or there is no such cluster
    """
    ray = _connect()
    try:
        yield ray
    finally:
        ray.shutdown()


def on_cluster(
    ray: Any,  # noqa: ANN401
    work: Callable[[Any], Any],
    asked: Sequence[Any],
    n_workers: int | None,
) -> Iterator[tuple[int, Any]]:
    """Do work on a cluster's cores, one each, and yield what comes back as soon as it does.

    :param ray: of `connected`
    :param work: called with each of ``asked``, on some node
    :param asked: what can be sent to nodes
    :param n_workers: pieces of work at once; all that the cluster has cores for by default
    :return: the place in ``asked``, and what ``work`` returned, or the exception that Ray raised
        where that could not be done, such as one of a node that goes away again and again
    :raises ClusterGoneError: it has gone
    """
    remote = ray.remote(num_cpus=1, max_retries=RETRIES)(work)
    waiting = list(enumerate(asked))[::-1]
    under_way: dict[Any, int] = {}
    while waiting or under_way:
        try:
            most = n_workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
            while waiting and len(under_way) < most:
                place, piece = waiting.pop()
                under_way[remote.remote(piece)] = place
            (reference, *_), _ = ray.wait(list(under_way))
            found = _result(ray, reference)
        except (ray.exceptions.RaySystemError, ConnectionError) as error:
            raise ClusterGoneError(f"the Ray cluster has gone ({error})") from error
        yield under_way.pop(reference), found


def _connect() -> Any:  # noqa: ANN401
    """Return Ray, connected to the cluster that `ADDRESS` names, or to one of this machine."""
    try:
        import ray
    except ImportError as error:
        raise BenchmarkError(
            "--backend ray needs Ray; install it with 'pip install sb3-nmp[ray]', here and on all "
            "nodes."
        ) from error
    one_thread = {"env_vars": {"OMP_NUM_THREADS": "1"}}
    try:
        _knock(os.environ.get(ADDRESS, ""))
        ray.init(log_to_driver=False, runtime_env=one_thread, include_dashboard=None)
    except (OSError, ValueError, RuntimeError) as error:
        raise BenchmarkError(
            f"no Ray cluster answers at {ADDRESS}={os.environ.get(ADDRESS, '')} ({error}): start "
            "one with 'ray start --head', or unset it to use this machine's cores."
        ) from error
    return ray


def _knock(address: str) -> None:
    """Raise an OSError where nothing listens at ``[ray://]host:port``; Ray itself asks for minutes.

    :param address: other forms, such as ``"auto"``, are left to Ray
    """
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdecimal():
        socket.create_connection((host, int(port)), timeout=CONNECT_SECONDS).close()


def _result(ray: Any, reference: Any) -> Any:  # noqa: ANN401
    """Return what came back, or the exception of a piece of work that cannot be done."""
    try:
        return ray.get(reference)
    except ray.exceptions.RaySystemError:
        raise
    except ray.exceptions.RayError as error:
        return error
