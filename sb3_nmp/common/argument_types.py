"""Arguments of a wrong type are refused when they are given, not when they are first used."""

import inspect
import types
from collections.abc import Iterator, Mapping
from numbers import Integral, Real
from typing import Any, Literal, TypeGuard, Union, get_args, get_origin

import numpy as np

from sb3_nmp.common.exceptions import ConfigurationError

#: of arguments that have checks and messages of their own
CHECKED_ELSEWHERE = ("policy", "env", "demonstrations", "device")


def check_types(cls: type, given: Mapping[str, Any]) -> None:
    """Raise unless arguments of a constructor are of the types that it declares.

    >>> from sb3_nmp import RCNMP
    >>> check_types(RCNMP, {"mutation": 0.1})
    Traceback (most recent call last):
        ...
    sb3_nmp.common.exceptions.ConfigurationError: mutation is 0.1; it must be a SmoothNoise or None.

    :param cls: the class
    :param given: arguments by name
    :raises ConfigurationError: one is of another type
    """
    for name, asked in misfits(cls, given):
        raise ConfigurationError(f"{name} is {given[name]!r}; it must be {asked}.")


def misfits(cls: type, given: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Name the arguments of a constructor that are of another type, with the type in words.

    :param cls: the class
    :param given: arguments by name
    """
    parameters = inspect.signature(cls).parameters
    for name, value in given.items():
        if name not in parameters or name in CHECKED_ELSEWHERE:
            continue
        declared = parameters[name].annotation
        if not fits(value, declared):
            yield name, in_words(declared)


def is_whole(value: object) -> TypeGuard[int]:
    """Tell whether a value is a whole number; True and False are none.

    >>> is_whole(3), is_whole(3.0), is_whole(True)
    (True, False, False)

    :param value: any
    """
    return isinstance(value, Integral) and not isinstance(value, bool)


def fits(value: object, declared: Any) -> bool:  # noqa: ANN401
    """Tell whether a value is of a declared type; True for types that are not known here.

    >>> fits(3, int), fits("3", int), fits((1.0, 2), tuple[float, ...]), fits(None, int | None)
    (True, False, True, True)
    >>> fits(bool, type[int]), fits(str, type[int])
    (True, False)

    :param value: any
    :param declared: an annotation
    """
    origin, arguments = get_origin(declared), get_args(declared)
    if origin in (Union, types.UnionType):
        return any(fits(value, each) for each in arguments)
    if origin is Literal:
        return value in arguments if isinstance(value, str) else False
    if origin is tuple:
        fixed = None if arguments[-1] is Ellipsis else len(arguments)
        return isinstance(value, tuple | list | np.ndarray) and (
            fixed in (None, len(value)) and all(fits(each, arguments[0]) for each in value)
        )
    if origin is dict:
        return isinstance(value, Mapping)
    if origin is type:
        return isinstance(value, type) and issubclass(value, arguments[0])
    if declared is None or declared is type(None):
        return value is None
    if declared in (int, float):
        return isinstance(value, Integral if declared is int else Real)
    if declared is bool:
        return isinstance(value, bool | np.bool_)
    if origin is not None:  # a schedule, or another callable
        return callable(value)
    return isinstance(value, declared) if isinstance(declared, type) else True


def in_words(declared: Any) -> str:  # noqa: ANN401
    """Say what a declared type asks for.

    >>> in_words(int | None), in_words(Literal["a", "b"]), in_words(float | tuple[float, ...])
    ('a whole number or None', "'a' or 'b'", 'a number or a tuple of numbers')

    :param declared: an annotation
    """
    origin, arguments = get_origin(declared), get_args(declared)
    if origin in (Union, types.UnionType):
        return " or ".join(in_words(each) for each in arguments)
    if origin is Literal:
        return " or ".join(map(repr, arguments))
    if origin is tuple:
        number = "" if arguments[-1] is Ellipsis else f"{len(arguments)} "
        return f"a tuple of {number}numbers"
    if origin is dict:
        return "a dictionary"
    if origin is type:
        return f"a subclass of {arguments[0].__name__}"
    if declared is None or declared is type(None):
        return "None"
    known = {int: "a whole number", float: "a number", bool: "True or False", str: "a text"}
    if declared in known:
        return known[declared]
    if origin is not None:
        return "a function (a schedule)"
    return f"a {getattr(declared, '__name__', declared)}"
