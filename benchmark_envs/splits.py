"""The thesis's splits of tasks: contexts to demonstrate, and one to learn without demonstration."""

from numbers import Integral

import numpy as np

from benchmark_envs.exceptions import TaskError
from benchmark_envs.registry import make_task
from benchmark_envs.rollouts import FloatArray


def leave_one_out(task_id: str, target: int) -> tuple[FloatArray, FloatArray]:
    """Return the contexts to demonstrate, and the one to learn without a demonstration.

    :param task_id: of a task with numbered targets, such as ``"nmp/Push-v0"``
    :param target: the number of the target that is left out, from 0
    :return: the K - 1 other targets' contexts in the order of their numbers, shape (K - 1, C), and
        the left-out target's context, shape (C,)
    :raises UnknownTaskError: no task of that id
    :raises TaskError: a task without numbered targets, or no target of that number

    >>> train, test = leave_one_out("nmp/Push-v0", target=9)
    >>> train.shape, test.tolist()
    ((9, 2), [-0.257, 0.238])
    """
    targets: FloatArray | None = getattr(make_task(task_id), "targets", None)
    if targets is None:
        raise TaskError(
            f"{task_id} has no numbered targets to leave one out of: draw its contexts with "
            "`sample_context`."
        )
    if not isinstance(target, Integral) or not 0 <= target < len(targets):
        raise TaskError(
            f"{task_id} has no target {target}; its targets are numbered 0 to {len(targets) - 1}."
        )
    return np.delete(targets, target, axis=0), targets[target].copy()


def extrapolation(task_id: str, target: int) -> tuple[FloatArray, FloatArray]:
    """Return the contexts to demonstrate, and one far from them to learn (thesis 5.2.4).

    :param task_id: of a task with such contexts, such as ``"nmp/Pouring-v1"``
    :param target: the number of the context that is to be learned, from 0
    :return: shapes (K, C) and (C,)
    :raises UnknownTaskError: no task of that id
    :raises TaskError: a task without such contexts, or none of that number

    >>> train, test = extrapolation("nmp/PickAndPlace-v1", target=1)
    >>> train.shape, test.tolist()
    ((8, 2), [0.09, 0.11])
    """
    task = make_task(task_id)
    shown: FloatArray | None = getattr(task, "demonstrated_contexts", None)
    beyond: FloatArray | None = getattr(task, "extrapolation_contexts", None)
    if shown is None or beyond is None:
        raise TaskError(
            f"{task_id} has no numbered contexts to extrapolate to: choose demonstrations and "
            "context yourself, or use `leave_one_out` where a task has numbered targets."
        )
    if not isinstance(target, Integral) or not 0 <= target < len(beyond):
        raise TaskError(
            f"{task_id} has no extrapolation context {target}; they are numbered 0 to "
            f"{len(beyond) - 1}."
        )
    return shown.copy(), beyond[target].copy()
