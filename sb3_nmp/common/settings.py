"""Settings: their names in files, their presets, and the rules that they must fit.

A file that held ``module:Class`` could not be read after the class has moved, and reading it could
import anything. So every settings class has a name that stays, written beside it:
``@settings_name("smooth-noise")``. So has every class whose objects are part of a model's state,
such as a search that is under way: ``@saved_state("critic-search")``.
"""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Self, TypeVar

from sb3_nmp.common.argument_types import misfits
from sb3_nmp.common.exceptions import ConfigurationError

#: by a setting's name: whether its value fits, and the rule in words
Rules = Mapping[str, tuple[bool, str]]

Class = TypeVar("Class", bound=type)

_NAMES: dict[type, str] = {}
_STATES: set[type] = set()


def settings_name(name: str) -> Callable[[Class], Class]:
    """Return a decorator that registers a class under a name that stays.

    Objects of a registered dataclass are saved by their fields and made anew by the constructor.

    :param name: lower case, such as ``"smooth-noise"``
    :raises ConfigurationError: another class has this name
    """

    def register(cls: Class) -> Class:
        taken = next((one for one, known in _NAMES.items() if known == name), None)
        if taken is not None and taken.__qualname__ != cls.__qualname__:
            raise ConfigurationError(
                f"the settings name '{name}' belongs to {taken.__qualname__}; give "
                f"{cls.__qualname__} another one."
            )
        _NAMES[cls] = name
        return cls

    return register


def saved_state(name: str) -> Callable[[Class], Class]:
    """Return a decorator that registers a class whose objects are saved as they are.

    They are saved by their attributes, or by what ``__getstate__`` returns, and filled with these
    again, or by ``__setstate__``, without a call of the constructor.

    :param name: as in `settings_name`
    :raises ConfigurationError: another class has this name
    """

    def register(cls: Class) -> Class:
        _STATES.add(settings_name(name)(cls))
        return cls

    return register


def is_state(cls: type) -> bool:
    """Tell whether a class was registered by `saved_state`.

    :param cls: any class
    """
    return cls in _STATES


def class_named(name: str) -> type | None:
    """Return the class that is registered under a name; None where there is none.

    >>> class_named("smooth-noise").__name__
    'SmoothNoise'

    :param name: a name that stays
    """
    return next((cls for cls, known in _NAMES.items() if known == name), None)


def stable_name(cls: type) -> str:
    """Return the name under which a class stands in files.

    >>> from sb3_nmp import SmoothNoise
    >>> stable_name(SmoothNoise)
    'smooth-noise'

    :param cls: a registered class
    :raises ConfigurationError: it is not registered
    """
    if cls not in _NAMES:
        raise ConfigurationError(
            f"{cls.__qualname__} has no name for files: decorate it with "
            "@settings_name('a-name-that-stays') of sb3_nmp.common.settings, as those of "
            f"{', '.join(sorted(_NAMES.values()))} are."
        )
    return _NAMES[cls]


def whole(value: float, least: int) -> tuple[bool, str]:
    """Return the rule of a whole number.

    >>> whole(3, least=1), whole(0, least=1)
    ((True, 'a whole number >= 1'), (False, 'a whole number >= 1'))

    :param value: of it
    :param least: that it may be
    """
    return value >= least, f"a whole number >= {least}"


def layers(sizes: tuple[int, ...]) -> tuple[bool, str]:
    """Return the rule of hidden layers, of which there may be none.

    :param sizes: of each
    """
    return all(size >= 1 for size in sizes), "the sizes of hidden layers, all >= 1"


def limits(low: float, high: float, least: float = 0.0) -> tuple[bool, str]:
    """Return the rule of two limits.

    :param low: the first
    :param high: the second
    :param least: that the first may be; 0 stands for anything above it
    """
    above = low > 0 if least == 0 else low >= least
    sign = "0 <" if least == 0 else f"{least:g} <="
    return above and low <= high, f"(low, high) with {sign} low <= high"


def check_rules(owner: object, rules: Rules) -> None:
    """Raise for the first setting that does not fit its rule.

    :param owner: has the settings as attributes
    :param rules: of its settings
    :raises ConfigurationError: a setting does not fit
    """
    for name, (fits, rule) in rules.items():
        if not fits:
            raise ConfigurationError(
                f"{name.lstrip('_')} is {getattr(owner, name)!r}; it must be {rule}."
            )


class Settings:
    """Base of the settings of algorithms: checked when they are made, some to be had by name.

    All values have defaults.

    :raises ConfigurationError: a value of another type than is declared, or that breaks a rule
    """

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}

    def __post_init__(self) -> None:
        """Check types, then rules; a wrong type is told with its rule, too."""
        for name, asked in misfits(type(self), vars(self)):
            rule = type(self)().rules().get(name, (True, ""))[1]
            told = rule if rule.startswith(asked) else f"{asked}, {rule}".rstrip(", ")
            raise ConfigurationError(f"{name} is {getattr(self, name)!r}; it must be {told}.")
        check_rules(self, self.rules())

    def rules(self) -> Rules:
        """Return the rules that the values must fit, which are of their declared types."""
        return {}

    @classmethod
    def preset(cls, name: str) -> Self:
        """Return the settings of a name.

        :param name: one of ``presets``
        :raises ConfigurationError: there are none of that name
        """
        if name not in cls.presets:
            has = ", ".join(cls.presets) or "none"
            raise ConfigurationError(f"{cls.__name__} has no preset '{name}'; it has {has}.")
        return cls(**cls.presets[name])
