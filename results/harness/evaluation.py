"""`Evaluation`: the callback that writes a run's curve while it learns."""

from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback

from results.harness.records import Measurements
from sb3_nmp.common.lockstep import clock
from sb3_nmp.common.policies import TrajectoryPolicy


class Evaluation(BaseCallback):
    """A callback that writes a run's curve while it learns.

    :param on_rollouts: told the number of rollouts so far after every step
    """

    def __init__(self, on_rollouts: Callable[[int], None] | None = None) -> None:
        super().__init__()
        self.on_rollouts = on_rollouts or (lambda _: None)
        self.rows: list[dict[str, Any]] = []
        self.seconds = 0.0

    @abstractmethod
    def measured(self) -> Measurements:
        """Return what a finished run's record holds of it."""

    def own_answer(self, contexts: NDArray[np.float64]) -> NDArray[np.float32] | None:
        """Return what the model alone answers, shape (N, T, D); None where there is no model.

        :param contexts: shape (N, C)
        """
        policy = self.model.policy
        if not isinstance(policy, TrajectoryPolicy):
            return None
        answered = policy.own_answer(contexts)
        return None if answered is None else answered.astype(np.float32)

    @contextmanager
    def stopwatch(self) -> Iterator[None]:
        """Count the time inside as ``seconds`` of evaluation."""
        start = clock()
        yield
        self.seconds += clock() - start
