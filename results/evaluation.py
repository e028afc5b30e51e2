"""The learning curve of a run: what has been found, and what the greedy policy does."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback

from benchmark_envs import Rollouts, Task

CURVE_COLUMNS = (
    "rollouts",
    "best_reward",
    "best_success",
    "any_success",
    "greedy_reward",
    "greedy_success",
)


class GreedyEvaluation(BaseCallback):
    """Writes one row of the learning curve after every step of the environments.

    A row tells what the algorithm knows from its first ``rollouts`` rollouts: the best of them,
    whether any of them succeeded, and the outcome of the greedy trajectory
    (``predict(context, deterministic=True)``) of the policy that those rollouts gave, any update
    at the end of a generation included. Greedy trajectories run in a task of their own and are
    not counted as rollouts. As the simulation is deterministic, one that has not changed is not
    run again.

    :param task: in which greedy trajectories run
    :param context: the run's one context, shape (C,)
    :param on_rollouts: told the number of rollouts so far after every step
    """

    def __init__(
        self,
        task: Task,
        context: NDArray[np.float64],
        on_rollouts: Callable[[int], None] | None = None,
    ) -> None:
        super().__init__()
        self.task = task
        self.context = context
        self.on_rollouts = on_rollouts or (lambda _: None)
        self.rows: list[dict[str, Any]] = []
        self.seconds = 0.0
        self._evaluated = b""
        self._greedy: Rollouts | None = None
        self._best: tuple[float, bool] = (-np.inf, False)
        self._any_success = False

    @property
    def greedy(self) -> Rollouts:
        """The last greedy rollout, a batch of one."""
        if self._greedy is None:
            raise RuntimeError("no greedy trajectory has been evaluated yet: call learn() first.")
        return self._greedy

    @property
    def curve(self) -> dict[str, list[Any]]:
        """The rows, as lists by column."""
        return {name: [row[name] for row in self.rows] for name in CURVE_COLUMNS}

    def _on_step(self) -> bool:
        for reward, info in zip(self.locals["rewards"], self.locals["infos"], strict=True):
            success = bool(info["is_success"])
            self._any_success |= success
            if float(reward) > self._best[0]:
                self._best = (float(reward), success)
        self.rows.append(
            {
                "rollouts": self.num_timesteps,
                "best_reward": self._best[0],
                "best_success": self._best[1],
                "any_success": self._any_success,
            }
        )
        self._evaluate()
        self.on_rollouts(self.num_timesteps)
        return True

    def _on_rollout_start(self) -> None:
        """Look again after a generation's update: the last row has not seen it."""
        if self.rows:
            self._evaluate()

    def _on_training_end(self) -> None:
        """Look again after the last update."""
        if self.rows:
            self._evaluate()

    def _evaluate(self) -> None:
        """Put the current greedy policy's outcome into the last row."""
        start = time.perf_counter()
        action, _ = self.model.predict(self.context.astype(np.float32), deterministic=True)
        trajectory = np.asarray(action)
        if trajectory.tobytes() != self._evaluated:
            self._greedy = self.task.simulate(self.context, trajectory)
            self._evaluated = trajectory.tobytes()
        self.rows[-1] |= {
            "greedy_reward": float(self.greedy.rewards[0]),
            "greedy_success": bool(self.greedy.successes[0]),
        }
        self.seconds += time.perf_counter() - start
