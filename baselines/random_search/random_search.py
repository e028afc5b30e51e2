"""`RandomSearch`: the row that every search must beat."""

from typing import ClassVar, Unpack

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import GymEnv

from baselines.primitive_search import (
    PointSearch,
    PrimitiveSearch,
    PrimitiveSearchArguments,
    StartPolicy,
)
from sb3_nmp.bayesian.search import Subspace
from sb3_nmp.common.settings import saved_state
from sb3_nmp.common.tuning import Range, SearchSpace


@saved_state("normal-search")
class NormalSearch(PointSearch):
    """Draws every point from N(0, I), whatever came of the others."""

    def _propose(self, n: int, rng: np.random.Generator) -> NDArray[np.float64]:
        return rng.standard_normal((n, self.space.size))


class RandomSearch(PrimitiveSearch):
    """The best of smooth random bends of the trajectory from which it starts.

    It learns nothing from a rollout but whether it is the best one so far: what a budget is worth
    by luck alone.

    >>> import benchmark_envs
    >>> RandomSearch("MlpPolicy", "nmp/Bottles-v0", seed=0).learn(20).num_timesteps
    20
    """

    tunable: ClassVar[SearchSpace] = {"n_bases": Range(4, 15, integer=True)}

    def __init__(
        self,
        policy: str | type[StartPolicy],
        env: GymEnv | str,
        **shared: Unpack[PrimitiveSearchArguments],
    ) -> None:
        super().__init__(policy, env, **shared)

    def _search_in(self, space: Subspace) -> NormalSearch:
        return NormalSearch(space)
