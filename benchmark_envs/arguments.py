"""Arguments of a wrong type are refused when they are given, not when they are first used."""

import numpy as np
from numpy.typing import ArrayLike

from benchmark_envs.exceptions import TaskError
from benchmark_envs.rollouts import FloatArray


def as_numbers(
    name: str, given: ArrayLike, rule: str, error: type[TaskError] = TaskError
) -> FloatArray:
    """Return what was given as float64.

    >>> as_numbers("low", [0, 1], "numbers, shape (D,)").tolist()
    [0.0, 1.0]

    :param name: of the argument, as messages say it
    :param given: numbers of any shape
    :param rule: what it must be, in words
    :param error: to raise
    :raises TaskError: a text, rows of mixed lengths, or anything else that is no array of numbers
    """
    try:
        found = np.asarray(given)
        if found.dtype.kind in "US":  # NumPy would read "1.5" as a number
            raise TypeError
        return found.astype(np.float64, copy=False)
    except (TypeError, ValueError) as cause:
        raise error(f"{name} is {given!r}; it must be {rule}.") from cause


def check_flag(name: str, given: object) -> bool:
    """Return a switch; anything else, such as "no", would count as True.

    :param name: of the argument
    :param given: True or False
    :raises TaskError: it is neither
    """
    if not isinstance(given, bool | np.bool_):
        raise TaskError(f"{name} is {given!r}; it must be True or False.")
    return bool(given)
