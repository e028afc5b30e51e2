"""`WaysSearch`: where demonstrations go several ways, the other ways' answers are tried first.

Shape letters: n trajectories, T time points, D dimensions of the trajectory, K ways.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.bayesian.search import CriticSearch
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import saved_state

FloatArray = NDArray[np.float64]


@saved_state("ways-search")
@dataclass
class WaysSearch:
    """A search around the answer of one mode, chosen once every mode's answer has been tried.

    :param modes: the numbers of the K modes, the one that answered first at the head
    :param searches: one around each mode's answer
    :param least_reward: of an answer that satisfies
    :param is_answered: whether the answer of a mode satisfied, so that nothing is to be searched
    :param news: by mode, whether its answer satisfied; of the other ways that were tried of late
    :param asked: the places of the searches that the rollouts under way belong to; at first the
        answer that was tried before there was a search
    """

    modes: list[int]
    searches: list[CriticSearch]
    least_reward: float
    is_answered: bool = False
    news: dict[int, bool] = field(default_factory=dict)
    asked: list[int] = field(default_factory=lambda: [0])

    @property
    def best(self) -> CriticSearch:
        """The search that has had the best rollout, a success before any failure."""
        return self.searches[self._best]

    @property
    def _best(self) -> int:
        def worth(place: int) -> tuple[bool, float]:
            search = self.searches[place]
            return search.has_succeeded, float(search.rewards.max(initial=-np.inf))

        return max(range(len(self.searches)), key=worth)

    @property
    def has_aimed(self) -> bool:
        """Whether what rollouts achieved has changed anything."""
        return any(each.has_aimed for each in self.searches)

    def take_news(self) -> dict[int, bool]:
        """Return by mode whether its answer satisfied; of other ways tried since it was asked."""
        told, self.news = self.news, {}
        return told

    def ask(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return trajectories to try, answers that were not tried yet before others, (n, T, D).

        :param n: how many
        :param rng: the generator to draw from
        """
        waiting = [i for i, each in enumerate(self.searches) if not each.rollouts][:n]
        asked = [self.searches[i].space.origin[None] for i in waiting]
        self.asked = waiting + [self._best] * (n - len(waiting))
        if len(waiting) < n:
            asked.append(self.best.ask(n - len(waiting), rng))
        return np.concatenate(asked)

    def tell(self, rollouts: Generation) -> None:
        """Tell each way's search its own rollouts.

        :param rollouts: of this context, as they were asked for
        """
        for place in dict.fromkeys(self.asked):
            search, own = self.searches[place], np.flatnonzero(np.equal(self.asked, place))
            if place and not search.rollouts:  # the first one is the answer
                first = own[0]
                enough = rollouts.rewards[first] >= self.least_reward
                self.news[self.modes[place]] = bool(rollouts.successes[first] and enough)
                self.is_answered |= self.news[self.modes[place]]
            search.tell(rollouts[own])
