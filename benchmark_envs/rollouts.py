"""What came of a batch of rollouts: as a task measured it, and as everyone else sees it.

Shape letters used everywhere: N rollouts, T time points, D dimensions of the trajectory,
C context.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Measured:
    """What a task measured in N rollouts; `assemble` makes `Rollouts` of it.

    Rows of rollouts that diverged may hold anything finite, but in ``outcomes``, which are kept.

    >>> import numpy as np
    >>> measured = Measured(
    ...     executed=np.zeros((1, 5, 2)),
    ...     terms={"distance": np.array([-0.2]), "effort": np.array([-0.1])},
    ...     successes=np.array([True]),
    ... )
    >>> contexts, trajectories, no = np.zeros((1, 3)), np.zeros((1, 5, 2)), np.array([False])
    >>> round(float(assemble(contexts, trajectories, no, measured, worst=-9.0).rewards[0]), 6)
    -0.3

    :param executed: what the robot really did at the time points, shape (N, T, D)
    :param terms: the reward's terms by name, each of shape (N,); the reward is their sum
    :param successes: whether the task was solved, shape (N,)
    :param diverged: whether the simulation broke down, shape (N,); by default none did
    :param clipped: whether a set-point was not followed because the task limits the robot's speed,
        shape (N,); by default all were
    :param paths: positions of moved objects by name, each of shape (N, T, 2 or 3) in m
    :param step_rewards: where the reward is a sum over time, its summands, shape (N, T)
    :param outcomes: what else happened, by name, each of shape (N,)
    :param achieved_contexts: in which contexts the rollouts would have been right, NaN where in
        none, shape (N, C); None where the task cannot tell
    """

    executed: FloatArray
    terms: Mapping[str, NDArray[np.floating]]
    successes: BoolArray
    diverged: BoolArray | None = None
    clipped: BoolArray | None = None
    paths: dict[str, FloatArray] = field(default_factory=dict)
    step_rewards: FloatArray | None = None
    outcomes: dict[str, FloatArray] = field(default_factory=dict)
    achieved_contexts: FloatArray | None = None


@dataclass(frozen=True)
class Rollouts:
    """The outcome of a batch of N rollouts.

    >>> from benchmark_envs import make_task
    >>> task, context = make_task("nmp/Aperture-v0", n_threads=1), [5.0, 8.0, 9.0, 5.0]
    >>> tried = [task.initial_trajectory(context), task.demonstrate(context)]
    >>> rollouts = task.simulate(context, tried)
    >>> rollouts.successes.tolist(), rollouts.executed.shape
    ([False, True], (2, 200, 2))
    >>> list(rollouts.terms), round(float(rollouts.terms["wall"][0]), 2)
    (['start', 'goal', 'wall', 'diverged'], -2.63)

    :param contexts: task parameters, shape (N, C)
    :param trajectories: the set-points that were commanded, after clipping, shape (N, T, D)
    :param executed: what the robot really did at the same time points, shape (N, T, D)
    :param rewards: one reward per rollout, always finite, shape (N,)
    :param successes: whether the task was solved, shape (N,)
    :param diverged: whether the simulation broke down (the reward is then the worst), shape (N,)
    :param clipped: whether a set-point lay outside the trajectory space, or was not followed
        because the task limits the robot's speed, shape (N,)
    :param terms: the reward's terms by name, each of shape (N,); they add up to the reward
    :param paths: positions of moved objects by name, each of shape (N, T, 2 or 3) in m
    :param step_rewards: where the reward is a sum over time, its summands, shape (N, T)
    :param outcomes: what else happened, by name, such as 1.0 for an object that was dropped and
        0.0 for one that was not, each of shape (N,); they are no part of the reward
    :param achieved_contexts: in which contexts the rollouts would have been right, NaN where in
        none, shape (N, C); None where the task cannot tell
    """

    contexts: FloatArray
    trajectories: FloatArray
    executed: FloatArray
    rewards: FloatArray
    successes: BoolArray
    diverged: BoolArray
    clipped: BoolArray
    terms: dict[str, FloatArray] = field(default_factory=dict)
    paths: dict[str, FloatArray] = field(default_factory=dict)
    step_rewards: FloatArray | None = None
    outcomes: dict[str, FloatArray] = field(default_factory=dict)
    achieved_contexts: FloatArray | None = None

    def __len__(self) -> int:
        """Return the number of rollouts, N."""
        return len(self.rewards)

    def __getitem__(self, index: int | slice | NDArray[Any]) -> "Rollouts":
        """Return the chosen rollouts; an integer gives a batch of one.

        :param index: an integer, a slice, or an array of indices or booleans
        """
        rows = [index] if isinstance(index, int | np.integer) else index
        return Rollouts(
            contexts=self.contexts[rows],
            trajectories=self.trajectories[rows],
            executed=self.executed[rows],
            rewards=self.rewards[rows],
            successes=self.successes[rows],
            diverged=self.diverged[rows],
            clipped=self.clipped[rows],
            terms={name: term[rows] for name, term in self.terms.items()},
            paths={name: path[rows] for name, path in self.paths.items()},
            step_rewards=None if self.step_rewards is None else self.step_rewards[rows],
            outcomes={name: outcome[rows] for name, outcome in self.outcomes.items()},
            achieved_contexts=None
            if self.achieved_contexts is None
            else self.achieved_contexts[rows],
        )

    def info(self, index: int) -> dict[str, Any]:
        """Return one rollout as a Gymnasium ``info`` dictionary.

        :param index: which of the N rollouts
        :return: scalars ``is_success``, ``diverged``, ``clipped``, ``reward_<term>`` and the
            task's outcomes by their names, and the arrays ``executed_trajectory`` (T, D),
            ``path_<object>`` (T, 2 or 3) and, where the reward is a sum over time,
            ``step_rewards`` (T,); where the rollout would have been right in some context,
            that one as ``achieved_context`` (C,)
        """
        info: dict[str, Any] = {
            "is_success": bool(self.successes[index]),
            "diverged": bool(self.diverged[index]),
            "clipped": bool(self.clipped[index]),
            "executed_trajectory": self.executed[index],
        }
        info |= {f"reward_{name}": float(term[index]) for name, term in self.terms.items()}
        info |= {name: float(outcome[index]) for name, outcome in self.outcomes.items()}
        if self.step_rewards is not None:
            info["step_rewards"] = self.step_rewards[index]
        achieved = None if self.achieved_contexts is None else self.achieved_contexts[index]
        if achieved is not None and np.isfinite(achieved).all():
            info["achieved_context"] = achieved
        return info | {f"path_{name}": path[index] for name, path in self.paths.items()}


def assemble(
    contexts: FloatArray,
    trajectories: FloatArray,
    outside: BoolArray,
    measured: Measured,
    worst: float,
) -> Rollouts:
    """Return the rollouts: the terms summed, and those that diverged marked by the worst reward.

    :param contexts: shape (N, C)
    :param trajectories: within the trajectory space, shape (N, T, D)
    :param outside: whether a set-point had to be clipped to that space, shape (N,)
    :param measured: of these rollouts
    :param worst: the reward of a rollout that diverged
    """
    none = np.zeros(len(contexts), bool)
    diverged = none if measured.diverged is None else measured.diverged
    terms = {name: np.where(diverged, 0.0, term) for name, term in measured.terms.items()}
    terms["diverged"] = np.where(diverged, worst, 0.0)
    steps = measured.step_rewards
    if steps is not None:
        steps = np.where(diverged[:, None], worst / steps.shape[1], steps)
    achieved = measured.achieved_contexts
    if achieved is not None:
        achieved = np.where(diverged[:, None], np.nan, achieved)
    return Rollouts(
        contexts=contexts,
        trajectories=trajectories,
        executed=np.where(diverged[:, None, None], trajectories, measured.executed),
        rewards=np.sum(list(terms.values()), axis=0),
        successes=measured.successes & ~diverged,
        diverged=diverged,
        clipped=outside if measured.clipped is None else outside | measured.clipped,
        terms=terms,
        paths=measured.paths,
        step_rewards=steps,
        outcomes=measured.outcomes,
        achieved_contexts=achieved,
    )
