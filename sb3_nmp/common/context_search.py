"""The search for a trajectory in one context: what it must offer, and how far it has come.

Shape letters: n trajectories, T time points, D dimensions, C context.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import saved_state

FloatArray = NDArray[np.float64]


class Search(Protocol):
    """The search for a trajectory in one context; it is saved with the model."""

    def ask(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return n trajectories to try, shape (n, T, D); a new search's first one is greedy."""
        ...

    def tell(self, rollouts: Generation) -> None:
        """Learn from rollouts in the search's context, whoever proposed them."""
        ...


@saved_state("context-search")
@dataclass
class ContextSearch:
    """A context that is searched, because the policy did not satisfy there or it is pinned.

    :param context: shape (C,)
    :param search: the search in it
    :param n_kept: the solution is the mean of so many successes, the best ones
    :param n_generations: searched so far
    :param successes: the best successful trajectories, best first, each of shape (T, D)
    :param rewards: theirs
    """

    context: NDArray[np.float32]
    search: Search
    n_kept: int = 1
    n_generations: int = 0
    successes: list[NDArray[np.float32]] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)

    def take(self, rollouts: Generation) -> bool:
        """Tell the search about rollouts, and keep the best successful ones.

        :param rollouts: made in this context
        :return: whether one of them is better than all before
        """
        self.search.tell(rollouts)
        before = self.reward
        rows = np.flatnonzero(rollouts.successes)
        known = [*zip(self.rewards, self.successes, strict=True)]
        known += [(float(rollouts.rewards[row]), rollouts.trajectories[row]) for row in rows]
        kept = sorted(known, key=lambda each: -each[0])[: self.n_kept]
        self.rewards, self.successes = [r for r, _ in kept], [t for _, t in kept]
        return self.reward > before

    @property
    def reward(self) -> float:
        """Of the best successful rollout; -inf before there is one."""
        return max(self.rewards, default=-np.inf)

    @property
    def solution(self) -> NDArray[np.float32] | None:
        """The mean of the successes that were kept, shape (T, D); None before there is one."""
        if not self.successes:
            return None
        return np.mean(self.successes, axis=0).astype(np.float32)

    def is_over(self, least_reward: float, max_generations: int) -> bool:
        """Tell whether a search among drawn contexts ends.

        :param least_reward: of all successes that make up the solution
        :param max_generations: after so many it ends without one
        """
        enough = sum(reward >= least_reward for reward in self.rewards) == self.n_kept
        return enough or self.n_generations >= max_generations


@saved_state("proposals")
@dataclass(frozen=True)
class Proposals:
    """What the G members of a generation execute.

    :param contexts: shape (G, C)
    :param trajectories: shape (G, T, D)
    :param searches: index of the search that proposed each member; -1 is the greedy trajectory in
        a context that is not searched, shape (G,)
    """

    contexts: NDArray[np.float32]
    trajectories: FloatArray
    searches: NDArray[np.int_]


def ask_all(searches: list[ContextSearch], n: int, rng: np.random.Generator) -> Proposals:
    """Return the proposals of all searches, n of each.

    :param searches: at least one
    :param n: trajectories per search
    :param rng: the generator to draw from
    """
    return Proposals(
        np.repeat(np.stack([each.context for each in searches]), n, axis=0),
        np.concatenate([each.search.ask(n, rng) for each in searches]),
        np.repeat(np.arange(len(searches)), n),
    )


def thresholds(given: float | tuple[float, float] | None) -> tuple[float, float]:
    """Return the least rewards with which no search begins, and with which one ends.

    >>> thresholds(None), thresholds(-0.1), thresholds((-0.1, -0.05))
    ((-inf, -inf), (-0.1, -0.1), (-0.1, -0.05))

    :param given: both of them, a single one for both, or None
    """
    if given is None:
        return -np.inf, -np.inf
    begin, end = given if isinstance(given, tuple | list) else (given, given)
    return float(begin), float(end)
