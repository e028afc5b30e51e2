"""`BoxedSearch`: a search in a box of points, begun by a space-filling design."""

from abc import abstractmethod

import numpy as np

from baselines.bayesopt.surrogate import FloatArray, sobol
from baselines.primitive_search import PointSearch
from sb3_nmp.bayesian.search import Subspace


class BoxedSearch(PointSearch):
    """Points in a box around the origin, seen as the unit cube; the first ones are Sobol's.

    :param space: of the trajectories that are searched
    :param reach: half of the box's edge, in standard deviations of the exploration
    :param n_initial: points of the design
    """

    def __init__(self, space: Subspace, reach: float, n_initial: int) -> None:
        super().__init__(space)
        self.reach, self.n_initial = reach, n_initial
        self._begin = self._first = 0  # rows: of what the model sees, and of the design
        self._design: FloatArray = np.empty((0, space.size))

    @abstractmethod
    def _propose_by_model(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return points of the unit cube to try next, shape (n, size)."""

    @property
    def cube(self) -> FloatArray:
        """The points since the search last began, in the unit cube, shape (N, size)."""
        return np.clip(0.5 + self.points[self._begin :] / (2 * self.reach), 0.0, 1.0)

    def _propose(self, n: int, rng: np.random.Generator) -> FloatArray:
        if len(self._design) == 0:
            self._first = len(self.points)  # others may have been told, such as a greedy rollout
        tried, known = len(self.points) - self._first, len(self.points) - self._begin
        if tried == 0 and known < self.n_initial:
            n_design = n * -(-(self.n_initial - known) // n)
            self._design = sobol(n_design, self.space.size, rng)
        if tried + n <= len(self._design):
            chosen = self._design[tried : tried + n]
        else:
            chosen = self._propose_by_model(n, rng)
        return (2.0 * chosen - 1.0) * self.reach

    def restart(self) -> None:
        """Forget all points for the model's sake, and begin with another design."""
        self._begin, self._design = len(self.points), self._design[:0]
