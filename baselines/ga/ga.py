"""GA: the elites, crossover and mutation of RC-NMP on the trajectories themselves, no network.

The row that a network must beat to earn its keep.
"""

from typing import ClassVar, Unpack

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv

from baselines.ga.policies import GAPolicy
from sb3_nmp.common.buffer import selection_weights
from sb3_nmp.common.population import PopulationArguments, PopulationSearch, blend


class GAArguments(PopulationArguments, total=False):
    """Those that have the same defaults as in `PopulationSearch`, which describes them."""

    population_size: int
    n_crossover: int
    mutation_decay: float
    n_explorers: int
    temperature: float


class GA(PopulationSearch):
    """Genetic algorithm on trajectories: parents drawn by rank, crossover in time, mutation.

    It is `sb3_nmp.RCNMP` without its network: where RC-NMP decodes a latent, this copies a stored
    rollout, drawn by its place among all of them.

    >>> import benchmark_envs
    >>> GA("MlpPolicy", "nmp/Bottles-v0", population_size=10, n_crossover=8).learn(20).num_timesteps
    20
    """

    policy: GAPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": GAPolicy}
    #: the stored rollouts that members copy, and those before and after each child's cut
    _parents: NDArray[np.int_]
    _before: NDArray[np.int_]
    _after: NDArray[np.int_]
    _cuts: NDArray[np.int_]

    def __init__(
        self, policy: str | type[GAPolicy], env: GymEnv | str, **shared: Unpack[GAArguments]
    ) -> None:
        super().__init__(policy, env, **shared)

    def _draw_members(self) -> None:
        """Draw a stored rollout for each member, and a second one for crossover children."""
        weights = selection_weights(self.replay_buffer.rewards, self.temperature)
        n = self.population_size
        self._parents = self.rng.choice(len(self.replay_buffer), n, p=weights)
        before, after, cuts = crossover_pairs(
            self.rng, n, self.n_crossover, self.policy.trajectory_shape[0]
        )
        self._before, self._after = self._parents[before], self._parents[after]
        self._cuts = cuts

    def _member(self, member: int, context: NDArray[np.float32]) -> NDArray[np.float64]:
        del context  # parents are rollouts of any context
        stored = self.replay_buffer.trajectories
        if member < self.n_plain:
            return stored[self._parents[member]].astype(np.float64)
        child = member - self.n_plain
        before, after = stored[self._before[child]], stored[self._after[child]]
        return blend(before, after, int(self._cuts[child])).astype(np.float64)


def crossover_pairs(
    rng: np.random.Generator, parents: int, n_children: int, n_time_points: int
) -> tuple[NDArray[np.int_], NDArray[np.int_], NDArray[np.int_]]:
    """Draw random pairs of different parents and random times; both children of each (IV).

    :param rng: the generator to draw from
    :param parents: number of parents
    :param n_children: even
    :param n_time_points: T
    :return: the children's parents before and after the cut, and the cuts, each (n_children,)
    """
    pairs = np.array(
        [rng.choice(parents, 2, replace=False) for _ in range(n_children // 2)], dtype=int
    ).reshape(-1, 2)
    cuts = np.repeat(rng.integers(1, n_time_points, size=len(pairs)), 2)
    return pairs.reshape(-1), pairs[:, ::-1].reshape(-1), cuts
