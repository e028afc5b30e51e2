"""`PolicySearch`: the network drives the search, which stays around its answer (thesis 5.1).

Shape letters: N rollouts, n coordinates, T time points, D dimensions of the trajectory.
"""

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.acnmp.settings import ACNMPExploration
from sb3_nmp.bayesian.search import Subspace, TrustRegion
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import saved_state

FloatArray = NDArray[np.float64]


@saved_state("policy-search")
class PolicySearch:
    """Draws every generation around the policy's answer, as the thesis does.

    A new search's first trajectory is that answer. After each update of the policy, `follow` takes
    the search along. How far it draws shrinks and grows as a trust region does; the thesis lets it
    shrink with the reward.

    :param space: with the policy's answer as origin
    :param settings: how far the draws go, in standard deviations of the exploration
    """

    def __init__(self, space: Subspace, settings: ACNMPExploration) -> None:
        s = settings
        self.space = space
        self.region = TrustRegion(s.radius, s.growth, s.shrinkage, s.radius_limits)
        self.retries = s.retry_answer
        self.rollouts: list[Generation] = []

    def ask(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return trajectories to try, a new search's first one being the answer, shape (n, T, D).

        :param n: how many
        :param rng: the generator to draw from
        """
        points = self.region.radius * rng.standard_normal((n, self.space.size))
        if self.retries or not self.rollouts:
            points[0] = 0.0
        return self.space.trajectories(points)

    def tell(self, rollouts: Generation) -> None:
        """Take in rollouts of this context.

        :param rollouts: those of the last `ask`, or others
        """
        before = max((part.rewards.max() for part in self.rollouts), default=None)
        self.rollouts.append(rollouts)
        if before is not None:
            self.region.update(bool(rollouts.rewards.max() > before))

    def follow(self, answer: FloatArray) -> None:
        """Go on around the policy's new answer.

        :param answer: shape (T, D)
        """
        self.space = Subspace(answer, self.space.directions)
