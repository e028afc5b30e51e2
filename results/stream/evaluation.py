"""The learning curve of a run on a stream of contexts: how many unseen contexts fail."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark_envs import Task
from results.harness.evaluation import Evaluation
from results.harness.greedy import exact
from results.harness.records import Measurements

N_BY_ROLLOUTS = 24  # evaluations at counts of rollouts, evenly on a logarithmic scale
N_BY_CONTEXTS = 20  # and at counts of contexts, evenly
FIRST_ROLLOUTS = 20
N_KEPT = 25  # held-out contexts whose last answers records keep


class StreamEvaluation(Evaluation):
    """Tries the greedy policy in held-out contexts, now and then.

    Each row of the curve tells after how many rollouts, in how many distinct contexts, which
    share of the held-out contexts fails, and the mean reward there. All of them are tried in one
    batch, in a task of their own; this is neither counted nor timed as training. An evaluation
    that is due waits for the update of its generation. The run is stopped where it tries a context
    beyond its allowance; that rollout reaches no update.

    At the end, what the policy's model answers without any rollout remembered is tried too.

    A context counts when a rollout is done in it, so an algorithm may come back to one (reset
    option ``context``) and may turn one down.

    :param task: in which greedy trajectories run
    :param test_contexts: held-out contexts, shape (N, C)
    :param n_contexts: distinct contexts that the run may try
    :param budget: its rollouts
    :param on_rollouts: told the number of rollouts so far after every step
    :param from_start: evaluate before the first rollout, too
    :param n_evaluations: see `schedule`
    """

    def __init__(
        self,
        task: Task,
        test_contexts: NDArray[np.float64],
        n_contexts: int,
        budget: int,
        on_rollouts: Callable[[int], None] | None = None,
        from_start: bool = False,
        n_evaluations: int = N_BY_ROLLOUTS,
    ) -> None:
        super().__init__(on_rollouts)
        self.task = task
        self.test_contexts = test_contexts
        self.n_contexts = n_contexts
        self.from_start = from_start
        self.tried: dict[bytes, int] = {}  # rollouts by context, in the order of the first ones
        self.exhausted = False
        self.own: dict[str, float] | None = None
        self._greedy = np.empty(0, np.float32)
        self._kept: dict[str, Any] = {}
        self._due_rollouts, self._due_contexts = schedule(budget, n_contexts, n_evaluations)

    def measured(self) -> Measurements:
        """Return the curve, and under ``contexts`` the rollouts in each, by first visit.

        ``exhausted`` tells whether the run ended because it asked for more contexts. ``own`` has
        the ``failure_rate`` of the model's own answers, and ``remembered``, the share of held-out
        contexts in which the greedy answer was another one; it is None where there is no model.
        ``kept`` has the first ``N_KEPT`` held-out contexts with their last greedy trajectories in
        single precision, their rewards and successes: who simulates them gets the same bits.
        """
        names = ("rollouts", "contexts", "failure_rate", "mean_reward")
        visits = {"rollouts": list(self.tried.values()), "exhausted": self.exhausted}
        curve = {name: [row[name] for row in self.rows] for name in names}
        return Measurements(curve, more={"contexts": visits, "own": self.own, "kept": self._kept})

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            context = np.asarray(info["terminal_observation"], np.float32).tobytes()
            if context in self.tried or len(self.tried) < self.n_contexts:
                self.tried[context] = self.tried.get(context, 0) + 1
            else:
                self.exhausted = True
        self.on_rollouts(self.num_timesteps)
        return not self.exhausted

    def _on_rollout_start(self) -> None:
        """Evaluate, if it is due, with the last generation's update."""
        by_rollouts = self._due_rollouts <= self.num_timesteps
        by_contexts = self._due_contexts <= len(self.tried)
        first = self.from_start and not self.rows
        if first or by_rollouts.any() or by_contexts.any():
            self._due_rollouts = self._due_rollouts[~by_rollouts]
            self._due_contexts = self._due_contexts[~by_contexts]
            self._evaluate()

    def _on_training_end(self) -> None:
        if not self.rows or self.rows[-1]["rollouts"] < self.num_timesteps:
            self._evaluate()
        self._evaluate_own()

    def _evaluate_own(self) -> None:
        """Try the model's own answers, where the greedy ones are not the same."""
        with self.stopwatch():
            answered = self.own_answer(self.test_contexts)
            if answered is None:
                return
            remembered = float(np.mean((answered != self._greedy).any(axis=(1, 2))))
            failing = self.rows[-1]["failure_rate"]
            if remembered:
                rollouts = self.task.simulate(self.test_contexts, answered)
                failing = float(np.mean(~rollouts.successes))
        self.own = {"failure_rate": failing, "remembered": remembered}

    def _evaluate(self) -> None:
        """Write a row of the curve."""
        with self.stopwatch():
            action, _ = self.model.predict(
                self.test_contexts.astype(np.float32), deterministic=True
            )
            self._greedy = np.asarray(action)
            rollouts = self.task.simulate(self.test_contexts, self._greedy)
        self._kept = {
            "contexts": exact(self.test_contexts[:N_KEPT]),
            "trajectories": exact(self._greedy[:N_KEPT]),
            "rewards": rollouts.rewards[:N_KEPT].tolist(),
            "successes": rollouts.successes[:N_KEPT].tolist(),
        }
        self.rows.append(
            {
                "rollouts": self.num_timesteps,
                "contexts": len(self.tried),
                "failure_rate": float(np.mean(~rollouts.successes)),
                "mean_reward": float(np.mean(rollouts.rewards)),
            }
        )


def schedule(
    budget: int, n_contexts: int, n_evaluations: int = N_BY_ROLLOUTS
) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Return at which counts of rollouts, and of contexts, an evaluation is due.

    :param budget: rollouts of the run
    :param n_contexts: distinct contexts that it may try
    :param n_evaluations: at counts of rollouts, evenly on a logarithmic scale, the end included
    :return: two ascending arrays; the ends of the run are not in them
    """
    rollouts = np.geomspace(min(FIRST_ROLLOUTS, budget), budget, n_evaluations).round()
    contexts = np.linspace(0, n_contexts, N_BY_CONTEXTS + 1).round()
    return (
        np.unique(rollouts[:-1].astype(int)),
        np.unique(contexts[1:-1].astype(int)),
    )
