"""`ResidualSearch`: CMA-ES over smooth deviations from a base trajectory, by ask and tell."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import cma
import numpy as np
from numpy.typing import NDArray

from baselines.primitives.pd_filtered import bends
from sb3_nmp.common.exceptions import ResumeWarning
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import saved_state

FloatArray = NDArray[np.float64]
#: From contexts (N, C) to trajectories (N, T, D).
BaseModel = Callable[[FloatArray], FloatArray]


class Normals:
    """Where pycma takes its normal numbers: from the generator that `ResidualSearch.ask` is given.

    pycma would otherwise draw from NumPy's global generator. What is drawn is kept, so that the
    search can be made again from it.
    """

    def __init__(self) -> None:
        self.rng: np.random.Generator | None = None
        self.drawn: list[FloatArray] = []
        self.again: list[FloatArray] = []

    def __call__(self, *shape: int) -> FloatArray:
        """Draw normal numbers, or give those again that were drawn before.

        :param shape: of the array
        """
        if self.again:
            numbers = self.again.pop(0)
        else:
            numbers = cast(np.random.Generator, self.rng).standard_normal(shape)
        self.drawn.append(numbers)
        return numbers


@saved_state("residual-space")
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
    :param controller: through which residuals are executed; they keep their size
    """

    noise: SmoothNoise
    context: FloatArray
    context_step: FloatArray | None
    mixing: FloatArray | None = None
    controller: PDController | None = None

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

    def _bases(self, n_time_points: int) -> FloatArray:
        """Return the bases, after the controller where there is one, shape (T, n_bases)."""
        bases = self.noise.bases(n_time_points)
        if self.controller is None:
            return bases
        return bends(self.controller, bases.T[..., None])[..., 0].T

    def residuals(self, parameters: FloatArray, shape: tuple[int, int]) -> FloatArray:
        """Return the deviations from the base trajectories, shape (N, T, D).

        :param parameters: shape (N, P)
        :param shape: (T, D)
        """
        n_time_points, n_dimensions = shape
        weights = parameters[:, : self.noise.n_bases * n_dimensions]
        shaped = weights.reshape(len(parameters), self.noise.n_bases, n_dimensions)
        smooth = self._bases(n_time_points) @ shaped
        if self.mixing is not None:
            smooth = np.einsum("ntd,tde->nte", smooth, self.mixing)
        return np.asarray(self.noise.sigma) * smooth


@saved_state("residual-search")
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
        self.population_size = population_size
        self.base: BaseModel | None = base
        self._begin()

    def _begin(self) -> None:
        self._normals = Normals()
        self._strategy = cma.CMAEvolutionStrategy(
            np.zeros(self.space.size(self.shape[1])),
            1.0,
            {
                "popsize": self.population_size,
                "randn": self._normals,
                "seed": np.nan,  # leaves NumPy's global generator alone
                "verbose": -9,
                "verb_log": 0,
            },
        )
        self._asked: list[FloatArray] | None = None
        self._is_new = True
        #: of every call in its order: how many were asked, or the costs that were told
        self._history: list[int | FloatArray] = []

    def __getstate__(self) -> dict[str, Any]:
        """Return what is saved: what happened, from which pycma's state follows again."""
        return {
            "space": self.space,
            "shape": self.shape,
            "population_size": self.population_size,
            "normals": self._normals.drawn,
            "history": self._history,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Let everything happen again.

        :param state: what `__getstate__` returned
        """
        self.space, self.shape = state["space"], state["shape"]
        self.population_size, self.base = state["population_size"], None
        self._begin()
        self._normals.again = list(state["normals"])
        for event in state["history"]:
            if isinstance(event, np.ndarray):
                self._tell(event)
            else:
                self._ask(event)

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

        :param n: how many: the population size. CMA-ES selects from the one that it was begun with,
            so with a smaller one it begins anew
        :param rng: the generator to draw from
        """
        if n < self.population_size:
            warnings.warn(
                f"CMA-ES was begun with generations of {self.population_size} rollouts, and they "
                f"have {n} now: its search begins anew.",
                ResumeWarning,
                stacklevel=6,
            )
            self.population_size = n
            self._begin()
        self._normals.rng = rng
        asked = self._ask(n)
        self._normals.rng = None
        return self.trajectories(np.stack(asked))

    def _ask(self, n: int) -> list[FloatArray]:
        """Return n vectors of parameters, each of shape (P,)."""
        self._history.append(int(n))
        asked = [np.asarray(x, np.float64) for x in self._strategy.ask(n)]
        if self._is_new:
            asked[0] = self.mean
        self._asked = asked
        return asked

    def tell(self, rollouts: Generation) -> None:
        """Update the distribution.

        :param rollouts: those of the last `ask` in their order; others of this context say only
            that the base trajectory has been tried
        """
        self._tell(-rollouts.rewards)

    def _tell(self, costs: FloatArray) -> None:
        self._history.append(costs)
        asked, self._asked, self._is_new = self._asked, None, False
        if asked is not None:
            self._strategy.tell(asked, costs.tolist())
