"""`GreedyEvaluation`: the curve of a run in one context."""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark_envs import Rollouts, Task
from results.harness.evaluation import Evaluation
from results.harness.records import ContextRecord, Measurements, RolloutRecord

CURVE_COLUMNS = (
    "rollouts",
    "best_reward",
    "best_success",
    "any_success",
    "greedy_reward",
    "greedy_success",
)
DECIMALS = 5  # of what the robot did, as records keep it


class GreedyEvaluation(Evaluation):
    """Writes one row of the learning curve after every step of the environments.

    A row tells what the algorithm knows from its first ``rollouts`` rollouts: the best of them,
    whether any of them succeeded, and the outcome of the greedy trajectory
    (``predict(context, deterministic=True)``) of the policy that those rollouts gave, any update
    at the end of a generation included. Greedy trajectories run in a task of their own and are
    not counted as rollouts. As the simulation is deterministic, one that has not changed is not
    run again.

    At the end, what the policy's model answers without any rollout remembered runs too. Records
    keep contexts and trajectories in single precision, as they are simulated, so that whoever
    simulates them again gets the same bits; the greedy trajectory from which on all succeed is
    kept as ``solving``.

    :param task: in which greedy trajectories run
    :param context: the run's one context, shape (C,)
    :param on_rollouts: told the number of rollouts so far after every step
    :param from_start: begin with a row for 0 rollouts; the algorithm must have a policy by then
    :param changes_only: leave out rows that repeat the one before, but for the last
    """

    def __init__(
        self,
        task: Task,
        context: NDArray[np.float64],
        on_rollouts: Callable[[int], None] | None = None,
        from_start: bool = False,
        changes_only: bool = False,
    ) -> None:
        super().__init__(on_rollouts)
        self.task = task
        self.context = context
        self.from_start = from_start
        self.changes_only = changes_only
        self._evaluated = b""
        self._greedy: Rollouts | None = None
        self._first: Rollouts | None = None
        self._own: Rollouts | None = None
        self._solving: Rollouts | None = None
        self._best: tuple[float, bool] = (-np.inf, False)
        self._any_success = False
        #: of all rollouts, one by one
        self.rewards: list[float] = []

    @property
    def greedy(self) -> Rollouts:
        """The last greedy rollout, a batch of one."""
        if self._greedy is None:
            raise RuntimeError("no greedy trajectory has been evaluated yet: call learn() first.")
        return self._greedy

    @property
    def rollouts(self) -> dict[str, Rollouts]:
        """Batches of one by name: ``greedy``, ``untrained``, ``own`` and ``solving``."""
        found = {"greedy": self.greedy}
        if self.from_start and self._first is not None:
            found["untrained"] = self._first
        if self._own is not None:
            found["own"] = self._own
        if self._solving is not None:
            found["solving"] = self._solving
        return found

    @property
    def curve(self) -> dict[str, list[Any]]:
        """The rows, as lists by column; before the first rollout the best one is None."""
        rows = changes(self.rows) if self.changes_only else self.rows
        return {name: [row[name] for row in rows] for name in CURVE_COLUMNS}

    def measured(self) -> Measurements:
        """Return the curve, the last greedy rollout, the first one, and the model's own answer."""
        rollouts = {name: self._rollout(each) for name, each in self.rollouts.items()}
        values = tuple(exact(self.context))
        return Measurements(
            self.curve, ContextRecord(values, self.task.scene(self.context)), rollouts
        )

    def _rollout(self, rollouts: Rollouts) -> RolloutRecord:
        """Return a batch of one as a record keeps it."""
        success, executed = bool(rollouts.successes[0]), rollouts.executed[0]
        return RolloutRecord(
            exact(rollouts.trajectories[0]),
            executed.round(DECIMALS).tolist(),
            success,
            self.task.mode_of(self.context, executed) if success else "",
            float(rollouts.rewards[0]),
        )

    def _on_step(self) -> bool:
        for reward, info in zip(self.locals["rewards"], self.locals["infos"], strict=True):
            success = bool(info["is_success"])
            self._any_success |= success
            self.rewards.append(float(reward))
            if float(reward) > self._best[0]:
                self._best = (float(reward), success)
        self._add_row()
        self._evaluate()
        self.on_rollouts(self.num_timesteps)
        return True

    def _on_rollout_start(self) -> None:
        """Look again after a generation's update: the last row has not seen it."""
        if self.from_start and not self.rows:
            self._add_row()
        if self.rows:
            self._evaluate()

    def _on_training_end(self) -> None:
        """Look again after the last update, and at the model's own answer."""
        if self.rows:
            self._evaluate()
        with self.stopwatch():
            own = self.own_answer(self.context[None])
            self._own = None if own is None else self.task.simulate(self.context, own[0])

    def _add_row(self) -> None:
        found = np.isfinite(self._best[0])
        self.rows.append(
            {
                "rollouts": self.num_timesteps,
                "best_reward": self._best[0] if found else None,
                "best_success": self._best[1],
                "any_success": self._any_success,
            }
        )

    def _evaluate(self) -> None:
        """Put the current greedy policy's outcome into the last row."""
        with self.stopwatch():
            action, _ = self.model.predict(self.context.astype(np.float32), deterministic=True)
            trajectory = np.asarray(action, np.float32)
            if trajectory.tobytes() != self._evaluated:
                self._greedy = self.task.simulate(self.context, trajectory)
                if self._first is None:
                    self._first = self._greedy
                self._evaluated = trajectory.tobytes()
                if not self._greedy.successes[0]:
                    self._solving = None
                elif self._solving is None:
                    self._solving = self._greedy
        self.rows[-1] |= {
            "greedy_reward": float(self.greedy.rewards[0]),
            "greedy_success": bool(self.greedy.successes[0]),
        }


def exact(values: NDArray[np.floating]) -> list[Any]:
    """Return numbers of single precision as short decimals that lose nothing.

    >>> exact(np.array([0.1, 0.25], np.float32).astype(np.float64))
    [0.1, 0.25]

    :param values: of any shape; read them again as float32
    """
    return values.astype(np.float32).astype(str).astype(float).tolist()


def changes(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows that differ from the one before in more than their rollouts, and the last.

    :param rows: of a curve, at least one
    """
    unlike = [
        row
        for before, row in pairwise(rows)
        if {**before, "rollouts": None} != {**row, "rollouts": None}
    ]
    kept = [rows[0], *unlike]
    return kept if kept[-1] is rows[-1] else [*kept, rows[-1]]
