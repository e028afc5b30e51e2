"""What may be tuned of an algorithm: declared beside it, as ``tunable``, read by any tuner."""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass, replace
from typing import Any

from sb3_nmp.common.exceptions import ConfigurationError

Value = float | int | str | bool | None


@dataclass(frozen=True)
class Range:
    """Numbers between two bounds, both included.

    :param low: smallest value
    :param high: largest value
    :param log: spread evenly over the logarithm
    :param integer: whole numbers alone
    :raises ConfigurationError: no such range
    """

    low: float
    high: float
    log: bool = False
    integer: bool = False

    def __post_init__(self) -> None:
        """Check the bounds."""
        if not self.low < self.high or (self.log and self.low <= 0):
            raise ConfigurationError(
                f"the range {self.low} to {self.high} must have low < high, and low > 0 where it "
                "is logarithmic."
            )


@dataclass(frozen=True)
class Choice:
    """Some values.

    :param values: at least two
    :raises ConfigurationError: fewer
    """

    values: tuple[Value, ...]

    def __post_init__(self) -> None:
        """Check the number of values."""
        if len(self.values) < 2:
            raise ConfigurationError(f"a choice among {self.values} is none; give at least two.")


#: by the name of a constructor argument, or ``"argument.field"`` of settings that are its default
SearchSpace = Mapping[str, Range | Choice]


def arguments_of(
    algorithm: type, chosen: Mapping[str, Value], given: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return constructor arguments of chosen values.

    >>> from sb3_nmp import RCNMP
    >>> arguments_of(RCNMP, {"temperature": 3.0, "mutation.n_bases": 8})["mutation"].n_bases
    8

    :param algorithm: whose constructor has them
    :param chosen: by the names of a `SearchSpace`; where a default is None, fields are those of a
        dictionary
    :param given: arguments whose fields are kept but for the chosen ones; else the defaults' are
    :raises ConfigurationError: the constructor has no such argument, or its default no such field
    """
    before, made = given or {}, dict[str, Any]()
    for name, value in chosen.items():
        argument, _, field = name.partition(".")
        if not field:
            made[argument] = value
            continue
        default = before.get(argument, default_of(algorithm, argument))
        settings = made.get(argument, default)
        if settings is None or isinstance(settings, Mapping):
            made[argument] = {**(settings or {}), field: value}
            continue
        if not is_dataclass(settings) or isinstance(settings, type) or not hasattr(settings, field):
            raise ConfigurationError(
                f"'{name}' cannot be set: {algorithm.__name__}'s {argument} is {settings!r}, which "
                f"has no field '{field}'."
            )
        made[argument] = replace(settings, **{field: value})
    return made


def default_of(algorithm: type, name: str) -> Any:  # noqa: ANN401
    """Return the default of a constructor argument, or of a field of settings.

    :param algorithm: whose constructor has it
    :param name: ``"argument"`` or ``"argument.field"``
    :raises ConfigurationError: it has no such argument
    """
    argument, _, field = name.partition(".")
    parameters = inspect.signature(algorithm).parameters
    if argument not in parameters:
        raise ConfigurationError(
            f"{algorithm.__name__} has no argument '{argument}'; it has {', '.join(parameters)}."
        )
    default = parameters[argument].default
    return getattr(default, field) if field else default
