"""`TuningContext`: where algorithms that are shown demonstrations are tuned.

Contexts and demonstrations are apart from the reported ones, and as far beyond what is shown as
those are.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from results.adaptation.protocol import Adaptation
from results.exceptions import BenchmarkError
from results.harness.environments import FloatArray


def _around(bearings: tuple[float, ...], distance: float) -> FloatArray:
    """Return targets about the base, shape (K, 2) in m, from bearings in degrees."""
    angles = np.radians(bearings)
    return distance * np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def _grid(first: tuple[float, ...], second: tuple[float, ...]) -> FloatArray:
    """Return all pairs, shape (K, 2)."""
    return np.array([(one, other) for one in first for other in second])


#: by task: contexts that are shown, shape (K, C), and those to adapt to, shape (N, C)
SPLITS: Mapping[str, tuple[FloatArray, FloatArray]] = {
    # m: between the reported targets, and beyond both ends
    "nmp/Push-v0": (
        _around((-32.0, -18.0, 2.0, 24.0, 43.0, 68.0, 94.0), 0.365),
        np.concatenate([_around((122.0, -47.5), 0.36), _around((125.0, -48.0), 0.395)]),
    ),
    # g: amount at first, and to pour
    "nmp/Pouring-v1": (
        _grid((865.0, 890.0, 910.0, 935.0), (180.0, 330.0, 420.0, 570.0)),
        np.array([[1350.0, 1250.0], [1250.0, 900.0], [1150.0, 800.0], [1420.0, 1090.0]]),
    ),
    # m: heights of object and tower
    "nmp/PickAndPlace-v1": (
        _grid((0.025, 0.055), (0.025, 0.045, 0.055, 0.075)),
        np.array([[0.075, 0.105], [0.085, 0.095]]),
    ),
}


@dataclass(frozen=True)
class TuningContext(Adaptation):
    """Adapt to a context that no table reports, after demonstrations that none has.

    >>> shown, held_out = TuningContext(0).split("nmp/Pouring-v1")
    >>> shown.shape, held_out.tolist()
    ((16, 2), [1350.0, 1250.0])

    :param target: the number of the context
    """

    target: int

    name: ClassVar[str] = "tuning"

    @property
    def kind(self) -> str:
        """Each context is a kind of its own."""
        return f"tuning context {self.target}"

    def split(self, task_id: str) -> tuple[FloatArray, FloatArray]:
        """Return the demonstrated contexts, and the one of this number.

        :param task_id: of the task
        :raises BenchmarkError: the task has no such context
        """
        shown, beyond = _split(task_id)
        if not 0 <= self.target < len(beyond):
            raise BenchmarkError(
                f"{task_id} has no tuning context {self.target}; they are numbered 0 to "
                f"{len(beyond) - 1}."
            )
        return shown.copy(), beyond[self.target].copy()


def _split(task_id: str) -> tuple[FloatArray, FloatArray]:
    if task_id not in SPLITS:
        raise BenchmarkError(
            f"{task_id} has no tuning contexts; these have some: {', '.join(SPLITS)}."
        )
    return SPLITS[task_id]


def tuning_contexts(task_id: str) -> tuple[TuningContext, ...]:
    """Return all of a task.

    :param task_id: of the task
    :raises BenchmarkError: it has none
    """
    return tuple(TuningContext(number) for number in range(len(_split(task_id)[1])))
