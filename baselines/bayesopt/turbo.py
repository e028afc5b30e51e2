"""`TuRBOSearch`: Bayesian optimisation in a trust region, by Thompson sampling.

Eriksson, Pearce, Gardner, Turner and Poloczek, "Scalable global optimization via local Bayesian
optimization", 2019 (TuRBO-1). Shape letters: N rollouts, n coordinates, M candidates.
"""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, cast

import numpy as np
import torch as th

from baselines.bayesopt.boxed import BoxedSearch
from baselines.bayesopt.surrogate import FloatArray, Surrogate, isolated, sobol, values_of
from sb3_nmp.bayesian.search import Subspace, best_and_newest
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import saved_state

if TYPE_CHECKING:
    from gpytorch.kernels import MaternKernel

FIRST_LENGTH, LEAST_LENGTH, LARGEST_LENGTH = 0.8, 0.5**7, 1.6  # edges in the unit cube
LEAST_GAIN = 1e-3  # a success is better than the best by this share of its size
N_CHANGED = 20  # coordinates of a candidate that differ from the centre's, on average


@saved_state("turbo-region")
@dataclass
class TrustRegion:
    """The edge of the region: twice as long after successes in a row, half after failures.

    >>> region = TrustRegion(success_tolerance=1, failure_tolerance=2)
    >>> lengths = []
    >>> for best, found in [(0.0, 1.0), (1.0, 0.5), (1.0, 0.2)]:
    ...     region.update(best, found)
    ...     lengths.append(region.length)
    >>> lengths
    [1.6, 1.6, 0.8]

    :param success_tolerance: generations in a row with a new best rollout until it doubles
    :param failure_tolerance: generations in a row without one until it halves
    :param length: of the edge, in the unit cube
    """

    success_tolerance: int
    failure_tolerance: int
    length: float = FIRST_LENGTH
    n_successes: int = field(default=0, init=False)
    n_failures: int = field(default=0, init=False)

    @property
    def is_exhausted(self) -> bool:
        """Whether it is so small that the search begins anew."""
        return self.length < LEAST_LENGTH

    def update(self, best: float, found: float) -> None:
        """Count a success or a failure.

        :param best: the best reward before the generation
        :param found: the best reward of the generation
        """
        success = found > best + LEAST_GAIN * abs(best)
        self.n_successes = self.n_successes + 1 if success else 0
        self.n_failures = 0 if success else self.n_failures + 1
        if self.n_successes == self.success_tolerance:
            self.length, self.n_successes = min(2.0 * self.length, LARGEST_LENGTH), 0
        elif self.n_failures == self.failure_tolerance:
            self.length, self.n_failures = self.length / 2.0, 0


@saved_state("turbo-settings")
@dataclass(frozen=True)
class TuRBOSettings:
    """How TuRBO models and chooses.

    :param n_initial: rollouts of the first design, and of that after each restart
    :param reach: half of the box's edge, in standard deviations of the exploration
    :param success_tolerance: see `TrustRegion`
    :param failure_tolerance: see `TrustRegion`; None: n coordinates / population size, at least 4
        over it
    :param copula: see `values_of`
    :param n_candidates: among which Thompson samples choose
    :param n_remembered: rollouts to which the process is fitted at most: half of them the best, the
        others the newest
    :param max_iterations: of a fit
    """

    n_initial: int
    reach: float
    success_tolerance: int
    failure_tolerance: int | None
    copula: bool
    n_candidates: int
    n_remembered: int
    max_iterations: int


@saved_state("turbo-search")
class TuRBOSearch(BoxedSearch):
    """TuRBO-1 in one context.

    :param space: of the trajectories that are searched
    :param population_size: rollouts per generation
    :param settings: how it models and chooses
    """

    def __init__(self, space: Subspace, population_size: int, settings: TuRBOSettings) -> None:
        super().__init__(space, settings.reach, settings.n_initial)
        self.settings, self.population_size = settings, population_size
        self.surrogate = Surrogate("matern", settings.max_iterations)
        self.region = self._new_region()

    def _new_region(self) -> TrustRegion:
        n, failures = self.population_size, self.settings.failure_tolerance
        if failures is None:
            failures = math.ceil(max(4.0 / n, self.space.size / n))
        return TrustRegion(self.settings.success_tolerance, failures)

    def tell(self, rollouts: Generation) -> None:
        """Take in rollouts, and adapt the region once the design is done.

        :param rollouts: of this context
        """
        before = self.rewards[self._begin :]
        super().tell(rollouts)
        n_begun = len(self._design) + max(0, self._first - self._begin)
        if len(before) < n_begun or len(before) == 0:
            return
        self.region.update(float(before.max()), float(rollouts.rewards.max()))
        if self.region.is_exhausted:
            self.region = self._new_region()
            self.restart()

    def _propose_by_model(self, n: int, rng: np.random.Generator) -> FloatArray:
        rewards, s = self.rewards[self._begin :], self.settings
        rows = best_and_newest(rewards, s.n_remembered)
        cube, values = self.cube[rows], values_of(rewards[rows], s.copula)
        with isolated(rng):
            from botorch.generation import MaxPosteriorSampling

            process = self.surrogate.fit(cube, values, len(rewards))
            kernel = cast("MaternKernel", process.covar_module)
            lengths = kernel.lengthscale.detach().numpy().ravel()
            centre = cube[values.argmax()]
            drawn = candidates(centre, lengths, self.region.length, s.n_candidates, rng)
            choose = MaxPosteriorSampling(process, replacement=False)
            with th.no_grad():
                return choose(th.as_tensor(drawn), num_samples=n).numpy()


def region_box(
    centre: FloatArray, lengths: FloatArray, edge: float
) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the trust region: longer where the process varies slowly, each (n,).

    Its volume is that of a cube, before it is cut to the unit cube.

    :param centre: the best point, in the unit cube, shape (n,)
    :param lengths: length scales of the process, shape (n,)
    :param edge: of a cube of the same volume
    """
    shape = lengths / np.exp(np.mean(np.log(lengths)))
    half = shape * edge / 2.0
    return np.clip(centre - half, 0.0, 1.0), np.clip(centre + half, 0.0, 1.0)


def candidates(
    centre: FloatArray, lengths: FloatArray, edge: float, n: int, rng: np.random.Generator
) -> FloatArray:
    """Return points of the trust region, most of whose coordinates are the centre's, (M, n).

    :param centre: the best point, in the unit cube, shape (n,)
    :param lengths: length scales of the process, shape (n,)
    :param edge: of the trust region
    :param n: how many, M
    :param rng: the generator to draw from
    """
    low, high = region_box(centre, lengths, edge)
    size = len(centre)
    drawn = low + (high - low) * sobol(n, size, rng)
    changed = rng.uniform(size=(n, size)) <= min(N_CHANGED / size, 1.0)
    changed[np.arange(n), rng.integers(size, size=n)] = True  # at least one
    return np.where(changed, drawn, centre)
