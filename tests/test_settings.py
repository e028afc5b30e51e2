"""What all settings of algorithms have in common: they are checked when they are made."""

import math
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import pytest

import baselines  # noqa: F401 (its settings are among those that are asked)
from sb3_nmp import ConfigurationError, RCNMPTraining
from sb3_nmp.common.argument_types import fits
from sb3_nmp.common.settings import Settings, layers, limits


def every_kind(base: type[Settings] = Settings) -> Iterator[type[Settings]]:
    for kind in base.__subclasses__():
        yield kind
        yield from every_kind(kind)


def is_number(kind: Any, name: str) -> bool:
    value = getattr(kind(), name)
    return not isinstance(value, bool) and fits(value, float | tuple[float, ...])


FIELDS = [(kind, field.name) for kind in every_kind() for field in fields(kind)]  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]


def test_all_are_asked() -> None:
    names = {kind.__name__ for kind, _ in FIELDS}
    assert {"ACNMPCritic", "CNMPArchitecture", "RCNMPSkill", "TransferTraining"} <= names
    assert len(names) >= 14


@pytest.mark.parametrize(("kind", "name"), FIELDS)
def test_a_text_is_refused_by_name(kind: Any, name: str) -> None:
    with pytest.raises(ConfigurationError, match=rf"^{name} is 'x'; it must be "):
        kind(**{name: "x"})


@pytest.mark.parametrize(("kind", "name"), FIELDS)
def test_what_is_no_number_is_refused_by_name(kind: Any, name: str) -> None:
    given: Any = math.nan
    if isinstance(getattr(kind(), name), tuple):
        given = (math.nan,) * len(getattr(kind(), name))
    with pytest.raises(ConfigurationError, match=rf"^{name} is "):
        kind(**{name: given})


@pytest.mark.parametrize(("kind", "name"), [each for each in FIELDS if is_number(*each)])
def test_far_below_every_range_is_refused_by_name(kind: Any, name: str) -> None:
    value = getattr(kind(), name)
    below = tuple(-9 for _ in value) if isinstance(value, tuple) else -9
    with pytest.raises(ConfigurationError, match=rf"^{name} is "):
        kind(**{name: below})


def test_the_shared_rules() -> None:
    assert layers(())[0] and layers((64, 1))[0] and not layers((64, 0))[0]
    assert limits(0.1, 0.1)[0] and not limits(0.0, 1.0)[0] and not limits(0.2, 0.1)[0]
    assert limits(1, 3, least=1) == (True, "(low, high) with 1 <= low <= high")
    assert not limits(0, 3, least=1)[0]


def test_a_preset_of_none_says_so() -> None:
    with pytest.raises(ConfigurationError, match="RCNMPTraining has no preset 'long'; it has none"):
        RCNMPTraining.preset("long")
