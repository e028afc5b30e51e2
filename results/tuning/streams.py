"""`TuningStream`: where algorithms that learn from streams of contexts are tuned."""

from dataclasses import dataclass
from typing import ClassVar

from results.stream.protocol import Stream


@dataclass(frozen=True)
class TuningStream(Stream):
    """A stream whose held-out contexts no table reports.

    Those that a run tries and is shown are drawn by its seed, and no reported run has a tuning
    seed.

    >>> from benchmark_envs import make_task
    >>> task = make_task("nmp/Bottles-v0", random_bottles=True)
    >>> tuning, reported = (each(n_test=5).test_contexts(task) for each in (TuningStream, Stream))
    >>> bool((tuning == reported).any())
    False
    """

    name: ClassVar[str] = "tuning stream"
    held_out_by: ClassVar[tuple[int, int]] = (1, 2)
