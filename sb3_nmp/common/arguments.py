"""The arguments that all constructors share, and how a class shows those that it passes on.

A constructor names what is its own, which its class describes, and passes on the rest as
``**shared: Unpack[SharedArguments]``. `complete` then gives the class the whole signature and the
whole docstring, so that ``help`` and ``inspect.signature`` show every argument with its default and
its description. `check_names` refuses what is not among them.
"""

import inspect
import re
from difflib import get_close_matches
from typing import Any, TypedDict, get_args

import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.utils import get_device

from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError, UnknownArgumentError


class SB3Arguments(TypedDict, total=False):
    """Those that SB3 gives a meaning and a default.

    :param policy_kwargs: further arguments of the policy
    :param stats_window_size: rollouts over which the logged success rate and reward are averaged
    :param tensorboard_log: folder for TensorBoard; None switches it off
    :param verbose: 0 nothing, 1 the log table, 2 debug messages
    :param seed: of Python, NumPy, PyTorch, the environment and the algorithm's own generator; equal
        seeds give equal runs, bit for bit
    """

    policy_kwargs: dict[str, Any] | None
    stats_window_size: int
    tensorboard_log: str | None
    verbose: int
    seed: int | None


class SharedArguments(SB3Arguments, total=False):
    """Those that every algorithm has; `TrajectoryAlgorithm` describes them."""

    demonstrations: Demonstrations | None
    exploration_scale: float | tuple[float, ...] | None
    device: th.device | str
    _init_setup_model: bool


#: they stand last in a signature
FROM_SB3 = (*SB3Arguments.__annotations__, "device", "_init_setup_model")


def complete(cls: type) -> None:
    """Give a class its whole signature and docstring.

    The constructor's ``**shared: Unpack[...]`` stands for arguments of its base class, which gives
    their defaults. An argument that the class does not describe is described as the base class
    or, of those of SB3, `SB3Arguments` does.

    :param cls: whose bases are complete
    :raises UnknownArgumentError: it passes on an argument that its base class does not have
    """
    bases = [base for base in cls.__mro__[1:] if issubclass(base, BaseAlgorithm)]
    passed_on = _passed_on(cls)
    cls.__signature__ = _whole_signature(cls, bases, passed_on)  # pyright: ignore
    if "__doc__" in cls.__dict__ and cls.__doc__:
        shared = passed_on.__doc__ if passed_on else None
        sources = [cls.__doc__, shared, *(base.__doc__ for base in bases)]
        cls.__doc__ = _whole_docstring(sources, list(inspect.signature(cls).parameters))


def check_names(cls: type, given: dict[str, Any]) -> None:
    """Raise unless a class has all the arguments that it is given.

    :param cls: a complete class
    :param given: the keyword arguments
    :raises UnknownArgumentError: it has none of that name
    """
    parameters = inspect.signature(cls).parameters
    if any(each.kind is each.VAR_KEYWORD for each in parameters.values()):
        return
    unknown = [name for name in given if name not in parameters]
    if unknown:
        near = get_close_matches(unknown[0], parameters, 1)
        raise UnknownArgumentError(
            f"{cls.__name__} has no argument '{unknown[0]}'"
            + (f"; did you mean '{near[0]}'?" if near else ".")
            + f" It has {', '.join(name for name in parameters if name[0] != '_')}."
        )


def check_values(
    cls: type[BaseAlgorithm], policy: object, seed: int | None, device: th.device | str
) -> None:
    """Raise for values that SB3 or PyTorch would refuse in words of their own.

    :param cls: the algorithm
    :param policy: an alias or a class
    :param seed: any, or None
    :param device: of the policy
    :raises ConfigurationError: one does not fit
    """
    check_policy(cls, policy)
    check_seed(seed)
    try:
        get_device(device)
    except (RuntimeError, TypeError, AttributeError) as error:
        raise ConfigurationError(
            f"device is {device!r}; it must be 'cpu', 'cuda', 'cuda:0' or the like, or 'auto'."
        ) from error


def check_policy(cls: type[BaseAlgorithm], policy: object) -> None:
    """Raise for an alias of a policy that an algorithm does not have.

    :param cls: the algorithm
    :param policy: an alias or a class
    :raises ConfigurationError: it has none of that name
    """
    if isinstance(policy, str) and policy not in cls.policy_aliases:
        raise ConfigurationError(
            f"{cls.__name__} has no policy '{policy}'; it has {', '.join(cls.policy_aliases)}."
        )


def check_seed(seed: int | None) -> None:
    """Raise for a seed that NumPy's generators do not take.

    :param seed: any, or None
    :raises ConfigurationError: it is below 0 or above 2^32 - 1
    """
    if seed is not None and not 0 <= seed < 2**32:
        raise ConfigurationError(
            f"seed is {seed}; it must be in [0, {2**32 - 1}], or None for a run that cannot be "
            "repeated."
        )


def _passed_on(cls: type) -> type | None:
    """Return the typed dictionary of the constructor's ``**shared``; None where it has none."""
    init = cls.__dict__.get("__init__")
    for parameter in inspect.signature(init).parameters.values() if init else ():
        if parameter.kind is parameter.VAR_KEYWORD and get_args(parameter.annotation):
            return get_args(parameter.annotation)[0]
    return None


def _whole_signature(cls: type, bases: list[type], passed_on: type | None) -> inspect.Signature:
    if "__init__" not in cls.__dict__:
        return inspect.signature(bases[0])
    own = list(inspect.signature(cls.__dict__["__init__"]).parameters.values())[1:]
    if passed_on is None:
        return inspect.Signature(own)
    known: dict[str, inspect.Parameter] = {}
    for base in reversed(bases):
        known |= inspect.signature(base).parameters
    unknown = [name for name in passed_on.__annotations__ if name not in known]
    if unknown:
        raise UnknownArgumentError(
            f"{cls.__name__} passes on '{unknown[0]}', which {bases[0].__name__} does not have."
        )
    shared = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=known[name].default,
            annotation=annotation,
        )
        for name, annotation in sorted(
            passed_on.__annotations__.items(), key=lambda item: item[0] in FROM_SB3
        )
    ]
    named = [each for each in own if each.kind is not each.VAR_KEYWORD]
    return inspect.Signature([*named, *shared])


def _whole_docstring(sources: list[str | None], names: list[str]) -> str:
    """Return the first docstring with a ``:param`` field for every name that a source describes."""
    text, *_ = re.split(r"^:", inspect.cleandoc(sources[0] or ""), maxsplit=1, flags=re.M)
    fields: dict[str, str] = {}
    for source in reversed(sources):
        fields |= _fields(source)
    shown = [fields[key] for key in (f"param {name}" for name in names) if key in fields]
    others = [field for key, field in fields.items() if not key.startswith("param ")]
    return "\n".join([text.rstrip(), "", *shown, *others]) + "\n"


def _fields(docstring: str | None) -> dict[str, str]:
    """Return the Sphinx fields of a docstring by ``"param x"`` or ``"raises X"``."""
    found = re.findall(r"^:([^:]+):(.*(?:\n +.*)*)", inspect.cleandoc(docstring or ""), re.M)
    return {name: f":{name}:{text}" for name, text in found}
