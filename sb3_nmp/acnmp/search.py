"""`PolicySearch`: the search of the thesis, around the policy's answer.

Shape letters: N rollouts, n coordinates, T time points, D dimensions of the trajectory.
"""

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.bayesian.search import Subspace
from sb3_nmp.common.rollouts import Generation

FloatArray = NDArray[np.float64]


class PolicySearch:
    """Draws every generation around the policy's answer, as the thesis does.

    A new search's first trajectory is that answer. After each update of the policy, `follow` takes
    the search along.

    :param space: with the policy's answer as origin
    :param radius: of the draws, in standard deviations of the exploration
    """

    def __init__(self, space: Subspace, radius: float) -> None:
        self.space, self.radius = space, radius
        self.rollouts: list[Generation] = []

    def ask(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return trajectories to try, the policy's answer first, shape (n, T, D).

        :param n: how many
        :param rng: the generator to draw from
        """
        points = self.radius * rng.standard_normal((n, self.space.size))
        points[0] = 0.0
        return self.space.trajectories(points)

    def tell(self, rollouts: Generation) -> None:
        """Take in rollouts of this context.

        :param rollouts: those of the last `ask`, or others
        """
        self.rollouts.append(rollouts)

    def follow(self, answer: FloatArray) -> None:
        """Go on around the policy's new answer.

        :param answer: shape (T, D)
        """
        self.space = Subspace(answer, self.space.directions)
