"""`PointSearch`: a search by ask and tell in the coordinates of a `Subspace`.

Shape letters: N rollouts so far, n coordinates, T time points, D dimensions of the trajectory.
"""

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.bayesian.search import Subspace
from sb3_nmp.common.rollouts import Generation

FloatArray = NDArray[np.float64]


class PointSearch(ABC):
    """Keeps the points tried and their rewards; a subclass proposes the next ones.

    A coordinate of 1 is one standard deviation of the exploration.

    :param space: of the trajectories that are searched
    """

    def __init__(self, space: Subspace) -> None:
        self.space = space
        self.points: FloatArray = np.empty((0, space.size))
        self.rewards: FloatArray = np.empty(0)

    @abstractmethod
    def _propose(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return the points to try next, shape (n, size)."""

    def ask(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return trajectories to try, shape (n, T, D); the first one ever is the space's origin.

        :param n: how many
        :param rng: the generator to draw from
        """
        points = self._propose(n, rng)
        if len(self.points) == 0:
            points[0] = 0.0
        return self.space.trajectories(points)

    def tell(self, rollouts: Generation) -> None:
        """Take in rollouts of this context.

        :param rollouts: their points are read from their trajectories
        """
        self.points = np.concatenate([self.points, self.space.coordinates(rollouts.trajectories)])
        self.rewards = np.concatenate([self.rewards, rollouts.rewards])
