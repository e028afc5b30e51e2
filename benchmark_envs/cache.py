"""A bounded cache of values that belong to a context and are costly to make."""

import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from benchmark_envs.rollouts import FloatArray

Value = TypeVar("Value")
#: one for all caches, as making a value may ask another one
_TURN = threading.RLock()


class ContextCache(Generic[Value]):
    """Makes a context's value when it is first asked for, and keeps the newest of them.

    >>> import numpy as np
    >>> cache = ContextCache(lambda context: float(context.sum()), size=100)
    >>> cache[np.array([1.0, 2.0])], len(cache)
    (3.0, 1)

    :param make: from a context, shape (C,)
    :param size: the most values that are kept
    """

    def __init__(self, make: Callable[[FloatArray], Value], size: int) -> None:
        self.make = make
        self.size = size
        self._values: dict[bytes, Value] = {}

    def __getitem__(self, context: FloatArray) -> Value:
        """Return the context's value.

        :param context: shape (C,)
        """
        key = context.tobytes()
        with _TURN:
            if key not in self._values:
                value = self.make(context)
                if len(self._values) >= self.size:
                    self._values.pop(next(iter(self._values)))
                self._values[key] = value
            return self._values[key]

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process or a copy needs: values are made anew."""
        return {**self.__dict__, "_values": {}}

    def __len__(self) -> int:
        """Return how many values are kept."""
        return len(self._values)
