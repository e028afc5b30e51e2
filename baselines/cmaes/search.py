"""`ResidualSearch`: CMA-ES over smooth deviations from a base trajectory, by ask and tell."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import cma
import numpy as np
from numpy.typing import NDArray

from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.rollouts import Generation

FloatArray = NDArray[np.float64]
#: From contexts (N, C) to trajectories (N, T, D).
BaseModel = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Normals:
    """Where pycma takes its normal numbers: from the generator that `ResidualSearch.ask` is given.

    pycma would otherwise draw from NumPy's global generator.
    """

    sources: list[np.random.Generator]

    def __call__(self, *shape: int) -> FloatArray:
        """Draw normal numbers.

        :param shape: of the array
        """
        return self.sources[0].standard_normal(shape)


@dataclass(frozen=True)
class ResidualSpace:
    """The parameters of the search, each with standard deviation 1, and what they mean.

    The first ``n_bases * D`` are the residual: a sum of smooth bases whose standard deviation is
    sigma at every time point (`SmoothNoise`), and where ``mixing`` is given, sigma in the mean over
    time and shaped like the demonstrations. Where ``context_step`` is given, C more parameters
    shift the context for which the base trajectory is predicted.

    :param noise: the bases and their sigma, in the trajectory's unit
    :param context: the context that is searched, shape (C,)
    :param context_step: the shift of a parameter of 1, in the context's units, shape (C,), or None
    :param mixing: at each time, how the residual in each dimension (rows) moves the trajectory's
        (columns), see `spread_over_time`, shape (T, D, D), or None
    """

    noise: SmoothNoise
    context: FloatArray
    context_step: FloatArray | None
    mixing: FloatArray | None = None

    def size(self, n_dimensions: int) -> int:
        """Return how many parameters there are.

        :param n_dimensions: D
        """
        shifts = 0 if self.context_step is None else len(self.context_step)
        return self.noise.n_bases * n_dimensions + shifts

    def contexts(self, parameters: FloatArray, n_dimensions: int) -> FloatArray:
        """Return the contexts for which base trajectories are needed, shape (N, C).

        :param parameters: shape (N, P)
        :param n_dimensions: D
        """
        if self.context_step is None:
            return np.tile(self.context, (len(parameters), 1))
        shifts = parameters[:, self.noise.n_bases * n_dimensions :]
        return self.context + shifts * self.context_step

    def residuals(self, parameters: FloatArray, shape: tuple[int, int]) -> FloatArray:
        """Return the deviations from the base trajectories, shape (N, T, D).

        :param parameters: shape (N, P)
        :param shape: (T, D)
        """
        n_time_points, n_dimensions = shape
        weights = parameters[:, : self.noise.n_bases * n_dimensions]
        shaped = weights.reshape(len(parameters), self.noise.n_bases, n_dimensions)
        smooth = self.noise.bases(n_time_points) @ shaped
        if self.mixing is not None:
            smooth = np.einsum("ntd,tde->nte", smooth, self.mixing)
        return np.asarray(self.noise.sigma) * smooth


class ResidualSearch:
    """CMA-ES (pycma) in one context.

    A saved search does not hold ``base``, which belongs to the policy; set it before going on.

    :param space: what is searched
    :param base: from contexts to base trajectories
    :param shape: (T, D)
    :param population_size: trajectories per generation
    """

    def __init__(
        self, space: ResidualSpace, base: BaseModel, shape: tuple[int, int], population_size: int
    ) -> None:
        self.space, self.shape = space, shape
        self.base: BaseModel | None = base
        self._sources: list[np.random.Generator] = []
        self._strategy = cma.CMAEvolutionStrategy(
            np.zeros(space.size(shape[1])),
            1.0,
            {
                "popsize": population_size,
                "randn": Normals(self._sources),
                "seed": np.nan,  # leaves NumPy's global generator alone
                "verbose": -9,
                "verb_log": 0,
            },
        )
        self._asked: list[FloatArray] | None = None
        self._is_new = True

    def __getstate__(self) -> dict[str, Any]:
        """Return what is saved: all but ``base``."""
        return self.__dict__ | {"base": None}

    @property
    def mean(self) -> FloatArray:
        """The parameters at the distribution's centre, shape (P,)."""
        return np.asarray(self._strategy.mean, np.float64)

    def trajectories(self, parameters: FloatArray) -> FloatArray:
        """Return the trajectories of some parameters, shape (N, T, D).

        :param parameters: shape (N, P)
        """
        base = cast(BaseModel, self.base)
        contexts = self.space.contexts(parameters, self.shape[1])
        return base(contexts) + self.space.residuals(parameters, self.shape)

    def ask(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return n trajectories to try, shape (n, T, D); a new search's first one is the base's.

        :param n: how many: the population size
        :param rng: the generator to draw from
        """
        self._sources[:] = [rng]
        asked = [np.asarray(x, np.float64) for x in self._strategy.ask(n)]
        self._sources.clear()
        if self._is_new:
            asked[0] = self.mean
        self._asked = asked
        return self.trajectories(np.stack(asked))

    def tell(self, rollouts: Generation) -> None:
        """Update the distribution.

        :param rollouts: those of the last `ask` in their order; others of this context say only
            that the base trajectory has been tried
        """
        asked, self._asked, self._is_new = self._asked, None, False
        if asked is not None:
            self._strategy.tell(asked, (-rollouts.rewards).tolist())
