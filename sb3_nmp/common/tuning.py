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

    def reaching(self, value: float) -> "Range":
        """Return this range where it holds a value, else one that reaches to it.

        A range of whole numbers reaches half as far again, for what lies beyond its end is not
        known to be the best.

        >>> Range(6, 15, integer=True).reaching(20).high, Range(0.5, 0.9).reaching(0.96).high
        (30, 0.96)

        :param value: that is to be held
        """
        if self.low <= value <= self.high:
            return self
        if value > self.high:
            return replace(self, high=value + value // 2 if self.integer else value)
        return replace(self, low=(value + 1) // 2 if self.integer else value)


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

    def reaching(self, value: Value) -> "Choice":
        """Return this choice where it has a value, else one that begins with it.

        >>> Choice((20, 30)).reaching(5).values
        (5, 20, 30)

        :param value: that is to be held
        """
        return self if value in self.values else Choice((value, *self.values))


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
        default = value_of(algorithm, argument, before)
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


def value_of(algorithm: type, name: str, given: Mapping[str, Any]) -> Any:  # noqa: ANN401
    """Return what an argument, or a field of settings, is; None where nothing is set.

    >>> from sb3_nmp import RCNMP
    >>> value_of(RCNMP, "mutation.n_bases", {}), value_of(RCNMP, "beta", {"beta": 1.0})
    (10, 1.0)

    :param algorithm: whose constructor has it
    :param name: ``"argument"`` or ``"argument.field"``
    :param given: arguments that go before the defaults
    :raises ConfigurationError: it has no such argument
    """
    argument, _, field = name.partition(".")
    value = given.get(argument, default_of(algorithm, argument))
    if not field:
        return value
    return value.get(field) if isinstance(value, Mapping) else getattr(value, field, None)


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
