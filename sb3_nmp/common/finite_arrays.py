"""Arrays of finite numbers, checked once and never changed."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sb3_nmp.common.exceptions import InvalidDataError


def finite_array(
    name: str, values: ArrayLike, shape: str, n_dimensions: int
) -> NDArray[np.float64]:
    """Return a read-only float64 copy.

    :param name: of the array, a plural
    :param values: of it
    :param shape: that it needs, in words
    :param n_dimensions: of that shape
    :raises InvalidDataError: rows of mixed shapes, a wrong number of dimensions, or a value that
        is not finite
    """
    if isinstance(values, Sequence):
        shapes = sorted({np.shape(row) for row in values})
        if len(shapes) > 1:
            raise InvalidDataError(
                f"the {name} have mixed shapes ({', '.join(map(str, shapes))}): all must have the "
                "same number of time points and dimensions; sb3_nmp.resample brings them to one."
            )
    array = numbers(name, values)
    if array.ndim != n_dimensions and array.size:
        raise InvalidDataError(f"the {name} have shape {array.shape}; they need {shape}.")
    if array.ndim != n_dimensions:
        raise InvalidDataError(f"the {name} are empty; at least one demonstration is needed.")
    if not np.isfinite(array).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InvalidDataError(
            f"the {name} hold {array[index]} at index {index}; every value must be finite."
        )
    array.setflags(write=False)
    return array


def numbers(name: str, values: ArrayLike, shape: str | None = None) -> NDArray[np.float64]:
    """Return a float64 copy.

    :param name: of the array, a plural
    :param values: of it
    :param shape: that it needs, in words, for the message; it is not checked
    :raises InvalidDataError: texts, other objects, or rows of mixed lengths
    """
    try:
        return np.array(values, np.float64)
    except (TypeError, ValueError) as error:
        needed = f"; {name} must be numbers, shape {shape}." if shape else ""
        raise InvalidDataError(
            f"the {name} are not an array of numbers: {error}{needed}"
        ) from error
