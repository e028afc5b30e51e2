"""Features of a context in which means and values are linear."""

from collections.abc import Mapping
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.common.settings import Rules

FloatArray = NDArray[np.float64]
#: ``"linear"``: 1 and the context's entries; ``"quadratic"``: their products of two each, besides
Features = Literal["linear", "quadratic"]


def make_features(scaled: NDArray[np.floating], kind: Features) -> FloatArray:
    """Return the features of contexts, shape (N, F), the first of which is 1.

    >>> make_features(np.array([[2.0, 3.0]]), "quadratic").tolist()
    [[1.0, 2.0, 3.0, 4.0, 6.0, 9.0]]

    :param scaled: contexts, of the order of 1, shape (N, C)
    :param kind: which features
    """
    rows = np.asarray(scaled, np.float64)
    linear = np.column_stack([np.ones(len(rows)), rows])
    if kind == "linear":
        return linear
    one, other = np.triu_indices(rows.shape[1])
    return np.column_stack([linear, rows[:, one] * rows[:, other]])


def feature_rule(kind: str) -> tuple[bool, str]:
    """Return whether there are such features, and the rule.

    :param kind: of the features
    """
    return kind in get_args(Features), f"one of {', '.join(get_args(Features))}"


def choose_features(kind: Features, shared: Mapping[str, Any]) -> dict[str, Any]:
    """Return a policy's arguments with the features of the mean, which may be among them.

    :param kind: of features, where the policy's arguments name none
    :param shared: an algorithm's arguments, with ``policy_kwargs`` or without
    """
    return {"context_features": kind} | (shared.get("policy_kwargs") or {})


def features_rules(context_features: str, value_features: str) -> Rules:
    """Return the rules of both kinds.

    :param context_features: of the mean
    :param value_features: of the value
    """
    return {
        "context_features": feature_rule(context_features),
        "value_features": feature_rule(value_features),
    }
