"""`ArchiveSearch`: CMA-ME over the coordinates of a `Subspace`, by ask and tell (pyribs).

pyribs is imported where it is used, as the extra ``qd`` brings it. Shape letters: N rollouts, n
coordinates, M measures, K cells, T time points, D dimensions of the trajectory.
"""

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from baselines.primitive_search import PointSearch
from sb3_nmp.bayesian.search import Subspace
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import saved_state

if TYPE_CHECKING:
    from ribs.archives import CVTArchive
    from ribs.emitters import EvolutionStrategyEmitter

FloatArray = NDArray[np.float64]
#: measures of exploration have a standard deviation of 1; beyond this they are of the outer cells
RANGE = 3.0


def check_ribs(algorithm: str) -> None:
    """Raise unless pyribs is installed.

    :param algorithm: that needs it
    :raises ConfigurationError: it is not
    """
    if find_spec("ribs") is None:
        raise ConfigurationError(
            f"{algorithm} needs pyribs, which is not installed; install it with "
            "'pip install sb3-nmp[qd]', or look for several ways with n_modes of RCNMP or GA."
        )


def part_means(directions: FloatArray, n_parts: int) -> FloatArray:
    """Return how coordinates turn into measures, shape (n, n_parts * D).

    A measure is the mean deviation in one dimension over one of equal parts of the time, in
    standard deviations of the exploration; 0 where it cannot deviate.

    >>> part_means(np.array([[[1.0], [1.0], [0.0], [0.0]], [[0.0], [0.0], [2.0], [2.0]]]), 2)
    array([[1., 0.],
           [0., 1.]])

    :param directions: of the exploration, shape (n, T, D)
    :param n_parts: at most T
    """
    parts = np.array_split(directions, n_parts, axis=1)
    means = np.concatenate([part.mean(axis=1) for part in parts], axis=1)
    spread = np.sqrt((means**2).sum(axis=0))
    return np.where(spread > 1e-12, means / np.maximum(spread, 1e-12), 0.0)


@saved_state("archive-search")
class ArchiveSearch(PointSearch):
    """CMA-ME in one context: evolution strategies that are rewarded for what is new in an archive.

    The archive keeps the best rollout of each cell; a cell is what is nearest to one of K points
    drawn from N(0, I) in the space of measures. A saved search holds what happened, from which the
    strategies' state follows again.

    :param space: of the trajectories that are searched
    :param n_emitters: strategies; they share a generation out as evenly as can be
    :param population_size: rollouts per generation
    :param n_cells: K
    :param n_parts: of the time over which deviations are averaged (`part_means`)
    :param sigma: of the strategies at first, in standard deviations of the exploration
    """

    def __init__(
        self,
        space: Subspace,
        n_emitters: int,
        population_size: int,
        n_cells: int,
        n_parts: int,
        sigma: float,
    ) -> None:
        super().__init__(space)
        self.n_emitters, self.population_size = n_emitters, population_size
        self.n_cells, self.n_parts, self.sigma = n_cells, n_parts, sigma
        self.seed: int | None = None
        #: of each `tell`: how many points, and how often the strategies were asked before it
        self.told: list[tuple[int, int]] = []
        self.n_asked = 0  # since the last `tell`
        self._prepare()

    def _prepare(self) -> None:
        self._to_measures = part_means(self.space.directions, self.n_parts)
        self._archive: CVTArchive | None = None
        self._emitters: list[EvolutionStrategyEmitter] = []

    @property
    def _shares(self) -> list[NDArray[np.intp]]:
        """The rows of a generation that each strategy proposes."""
        return np.array_split(np.arange(self.population_size), self.n_emitters)

    def _begin(self) -> None:
        """Make archive and strategies, whose random numbers follow from the seed."""
        from ribs.archives import CVTArchive
        from ribs.emitters import EvolutionStrategyEmitter

        rng = np.random.default_rng(self.seed)
        n_measures = self._to_measures.shape[1]
        self._archive = CVTArchive(
            solution_dim=self.space.size,
            centroids=np.clip(rng.standard_normal((self.n_cells, n_measures)), -RANGE, RANGE),
            ranges=[(-RANGE, RANGE)] * n_measures,
            seed=int(rng.integers(2**31)),
        )
        self._emitters = [
            EvolutionStrategyEmitter(
                self._archive,
                x0=np.zeros(self.space.size),
                sigma0=self.sigma,
                batch_size=len(rows),
                seed=int(rng.integers(2**31)),
            )
            for rows in self._shares
        ]

    def _propose(self, n: int, rng: np.random.Generator) -> FloatArray:
        if self.seed is None:
            self.seed = int(rng.integers(2**31))
        if self._archive is None:
            self._begin()
        self.n_asked += 1
        return np.concatenate([each.ask() for each in self._emitters]).astype(np.float64)

    def tell(self, rollouts: Generation) -> None:
        """Take in rollouts of this context.

        :param rollouts: their points are read from their trajectories
        """
        n_before = len(self.points)
        super().tell(rollouts)
        self.told.append((len(rollouts), self.n_asked))
        if self.n_asked:
            self._learn(slice(n_before, None))

    def _learn(self, rows: slice) -> None:
        """Tell the archive and the strategies of rows that they asked for."""
        archive, self.n_asked = cast("CVTArchive", self._archive), 0
        points, rewards = self.points[rows], self.rewards[rows]
        measures = points @ self._to_measures
        news = archive.add(points, rewards, measures)
        if rows.start == 0:  # the start was executed in place of the first strategy's first point
            news["status"][0], news["value"][0] = 0, -np.inf
        for each, own in zip(self._emitters, self._shares, strict=True):
            of_own = {name: values[own] for name, values in news.items()}
            each.tell(points[own], rewards[own], measures[own], of_own)

    def cells(self, points: FloatArray) -> NDArray[np.intp]:
        """Return the cell of each point, shape (N,).

        :param points: shape (N, n)
        """
        archive = cast("CVTArchive", self._archive)
        return np.asarray(archive.index_of(points @ self._to_measures), np.intp)

    def __getstate__(self) -> dict[str, Any]:
        """Return what is saved: what was told, from which archive and strategies follow again."""
        kept = dict(self.__dict__)
        for name in ("_to_measures", "_archive", "_emitters"):
            del kept[name]
        return kept

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Let everything happen again.

        :param state: what `__getstate__` returned
        """
        for name, value in state.items():
            setattr(self, name, value)
        self._prepare()
        row, pending, self.n_asked = 0, self.n_asked, 0
        for n, n_asked in self.told:
            self._propose_again(n_asked)
            if n_asked:
                self._learn(slice(row, row + n))
            row += n
        self._propose_again(pending)

    def _propose_again(self, n: int) -> None:
        for _ in range(n):
            self._propose(self.population_size, np.random.default_rng())  # draws no seed anew
