"""How many rollouts the runs of a plan have done, told across processes."""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np


class RolloutCounters:
    """How many rollouts each run has done, in a file that the worker processes write to.

    Use it as a context manager, which removes the file in the end.

    :param n_runs: how many runs
    """

    def __init__(self, n_runs: int) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="nmp-bench-")
        self.path = Path(self._folder.name) / "rollouts"
        np.zeros(n_runs, np.int64).tofile(self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def total(self) -> int:
        """Return the rollouts of all runs together."""
        return int(np.fromfile(self.path, np.int64).sum())

    def writer(self, index: int) -> "CounterWriter":
        """Return what tells this object about one run's rollouts.

        :param index: of the run
        """
        return CounterWriter(self.path, index)


@dataclass(frozen=True)
class CounterWriter:
    """Picklable end of `RolloutCounters`.

    :param path: of the counters' file
    :param index: of the run
    """

    path: Path
    index: int

    def __call__(self, n_rollouts: int) -> None:
        """Store the run's number of rollouts so far.

        :param n_rollouts: since its start
        """
        with self.path.open("r+b") as file:
            file.seek(8 * self.index)
            file.write(np.int64(n_rollouts).tobytes())
