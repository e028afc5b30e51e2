"""The arguments that all constructors share, and how a class shows those that it passes on.

A constructor names what is its own, which its class describes, and passes on the rest as
``**shared: Unpack[SharedArguments]``. `complete` then gives the class the whole signature and the
whole docstring, so that ``help`` and ``inspect.signature`` show every argument with its default and
its description. `check_names` refuses what is not among them.
"""

import inspect
import re
from difflib import get_close_matches
from numbers import Integral, Real
from typing import Any, TypedDict, cast, get_args

import numpy as np
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.common.utils import get_device

from sb3_nmp.common.argument_types import is_whole
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.environment import check_budget
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
    cls: type[BaseAlgorithm], policy: object, seed: object, device: th.device | str
) -> int | None:
    """Return a seed as a whole number, and raise for values that SB3 or PyTorch would refuse.

    :param cls: the algorithm
    :param policy: an alias or a class
    :param seed: any, or None
    :param device: of the policy
    :raises ConfigurationError: one does not fit
    """
    check_policy(cls, policy)
    whole = check_seed(seed)
    try:
        get_device(device)
    except (RuntimeError, TypeError, AttributeError) as error:
        raise ConfigurationError(
            f"device is {device!r}; it must be 'cpu', 'cuda', 'cuda:0' or the like, or 'auto'."
        ) from error
    return whole


def check_policy(cls: type[BaseAlgorithm], policy: object) -> None:
    """Raise for an alias of a policy that an algorithm does not have.

    :param cls: the algorithm
    :param policy: an alias or a class
    :raises ConfigurationError: it has none of that name, or it is no policy's class
    """
    if not isinstance(policy, str):
        if not (isinstance(policy, type) and issubclass(policy, BasePolicy)):
            raise ConfigurationError(
                f"policy is {policy!r}; it must be one of {', '.join(cls.policy_aliases)}, or a "
                "class that derives from a policy of this library."
            )
    if isinstance(policy, str) and policy not in cls.policy_aliases:
        raise ConfigurationError(
            f"{cls.__name__} has no policy '{policy}'; it has {', '.join(cls.policy_aliases)}."
        )


def check_seed(seed: object) -> int | None:
    """Return a seed as a whole number; raise for one that NumPy's generators do not take.

    :param seed: any, or None
    :raises ConfigurationError: it is no whole number, below 0 or above 2^32 - 1
    """
    if seed is not None and not (is_whole(seed) and 0 <= int(seed) < 2**32):
        raise ConfigurationError(
            f"seed is {seed!r}; it must be a whole number in [0, {2**32 - 1}], or None for a run "
            "that cannot be repeated."
        )
    return None if seed is None else int(cast(int, seed))


def is_learning_rate(rate: Any) -> bool:  # noqa: ANN401
    """Return whether a number, or what a schedule begins with, can be a learning rate.

    :param rate: a number or a schedule
    """
    first = rate(1.0) if callable(rate) else rate
    return isinstance(first, Real) and bool(np.isfinite(float(first))) and float(first) >= 0


class CheckedSchedule:
    """A schedule of the learning rate whose values are looked at as they are used.

    :param schedule: from the share of the budget that remains, from 1 to 0, to a learning rate
    """

    def __init__(self, schedule: Schedule) -> None:
        self.schedule = schedule

    def __call__(self, progress_remaining: float) -> float:
        """Return the learning rate.

        :param progress_remaining: share of the budget
        :raises ConfigurationError: it is below 0, or not finite
        """
        rate = self.schedule(progress_remaining)
        if not is_learning_rate(rate):
            raise ConfigurationError(
                f"learning_rate is a schedule that gives {rate!r} where {progress_remaining:.3g} "
                "of the budget remains; its values must be finite and >= 0."
            )
        return rate


def check_learn(total_timesteps: object, callback: object, log_interval: object, n: int) -> int:
    """Return a budget as a whole number, and raise for arguments of ``learn`` that do not fit.

    :param total_timesteps: rollouts; a float such as ``1e4`` will do
    :param callback: as SB3 takes it
    :param log_interval: generations between two lines of the log, or None
    :param n: parallel environments
    :raises ConfigurationError: one does not fit
    """
    given = callback if isinstance(callback, list) else [callback]
    for each in given:
        is_one = isinstance(each, BaseCallback) or (callable(each) and not isinstance(each, type))
        if not is_one and callback is not None:
            hint = " (it is a class: add brackets)" if isinstance(each, type) else ""
            raise ConfigurationError(
                f"callback is {callback!r}{hint}; it must be a BaseCallback of SB3, a list of "
                "them, or a function of the local and global variables."
            )
    if log_interval is not None and not isinstance(log_interval, Integral):
        raise ConfigurationError(
            f"log_interval is {log_interval!r}; it must be a whole number of generations, or None."
        )
    return check_budget(total_timesteps, n)


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
