"""What an arm and its task are given, checked before any work begins."""

from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from benchmark_envs.arguments import as_numbers
from benchmark_envs.exceptions import TaskError
from benchmark_envs.rollouts import FloatArray


def as_path(given: object) -> Path:
    """Return the path of a file.

    :param given: a text or a path
    :raises TaskError: it is neither
    """
    try:
        return Path(cast(str, given))
    except TypeError as error:
        raise TaskError(f"path is {given!r}; it must be the path of an MJCF file.") from error


def vector(name: str, given: ArrayLike, n: int) -> FloatArray:
    """Return finite numbers, shape (n,).

    >>> vector("start", [0, 1], 2).tolist()
    [0.0, 1.0]

    :param name: of the argument
    :param given: of any kind
    :param n: how many it must be
    :raises TaskError: another shape, a text, or a value that is not finite
    """
    found = as_numbers(name, given, f"{n} finite numbers")
    if found.shape != (n,):
        raise TaskError(f"{name} has shape {found.shape}; {n} numbers are needed.")
    if not np.isfinite(found).all():
        raise TaskError(f"{name} is {given}; it must be {n} finite numbers.")
    return found


def names(name: str, given: object) -> tuple[str, ...]:
    """Return names in a tuple.

    >>> names("watched", ["hole"])
    ('hole',)

    :param name: of the argument
    :param given: a list or tuple of texts
    :raises TaskError: a single text, or anything else
    """
    if not isinstance(given, list | tuple) or not all(isinstance(each, str) for each in given):
        raise TaskError(f"{name} is {given!r}; it must be a list of texts.")
    return tuple(given)


def checked_ranges(given: object, joints: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return low and high ends by joint.

    :param given: a dictionary, or None
    :param joints: their names
    :raises TaskError: no dictionary, no such joint, or ends that are no two finite numbers
    """
    if not isinstance(given or {}, Mapping):
        raise TaskError(f"ranges is {given!r}; it must be a dictionary: {{'{joints[0]}': (a, b)}}.")
    found: dict[str, tuple[float, float]] = {}
    for joint, ends in cast(Mapping[str, ArrayLike], given or {}).items():
        if joint not in joints:
            raise TaskError(f"ranges names '{joint}'; the joints are {', '.join(joints)}.")
        low, high = vector(f"the range of '{joint}'", ends, 2).tolist()
        if not low < high:
            raise TaskError(
                f"the joint '{joint}' is given ranges={{'{joint}': {ends}}}, so that its range is "
                f"[{low:g}, {high:g}]; the low end must be below the high one."
            )
        found[joint] = low, high
    return found


def check_positive(name: str, given: object, unit: str) -> None:
    """Raise unless a setting is a finite number > 0.

    :param name: of the argument
    :param given: of any kind
    :param unit: of it
    :raises TaskError: it is not
    """
    number = isinstance(given, Real) and not isinstance(given, bool)
    if not number or not 0 < float(cast(float, given)) < np.inf:
        raise TaskError(
            f"{name} is {given!r} {unit}; finite and positive numbers are needed, such as "
            f"{name}=1.0."
        )


def asked(name: str, function: Callable[[FloatArray], Any], context: FloatArray) -> Any:  # noqa: ANN401
    """Return what a function of the context returns.

    :param name: of the argument
    :param function: the user's
    :param context: shape (C,)
    :raises TaskError: no function, or one that raises
    """
    if not callable(function):
        raise TaskError(f"{name} is {function!r}; it must be a function of the context.")
    try:
        return function(context.copy())
    except Exception as error:  # whatever a user's function does
        raise TaskError(
            f"{name} raised {type(error).__name__} ({error}) in the context "
            f"{context.round(4).tolist()}; it must take a context of shape {context.shape}."
        ) from error
