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
from sb3_nmp.common.contextual import TUNABLE_OVER_CONTEXTS
from sb3_nmp.common.judging import Wanted, features
from sb3_nmp.common.niches import View
from sb3_nmp.common.operators import blend
from sb3_nmp.common.population import PopulationArguments, PopulationSearch
from sb3_nmp.common.regression import NEWEST, gaussian_process
from sb3_nmp.common.tuning import Choice, Range, SearchSpace


class GAArguments(PopulationArguments, total=False):
    """Those that have the same defaults as in `PopulationSearch`, which describes them."""

    population_size: int
    n_crossover: int
    mutation_decay: float
    n_explorers: int
    temperature: float
    n_candidates: int


class GA(PopulationSearch):
    """Genetic algorithm on trajectories: parents drawn by rank, crossover in time, mutation.

    It is `sb3_nmp.RCNMP` without its networks: where RC-NMP decodes a latent, this copies a stored
    rollout, drawn by its place among all of them. By default all that is made is executed; with
    several candidates for each member, Gaussian processes judge them.

    >>> import benchmark_envs
    >>> GA("MlpPolicy", "nmp/Bottles-v0", population_size=10, n_crossover=8).learn(20).num_timesteps
    20
    """

    policy: GAPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": GAPolicy}

    tunable: ClassVar[SearchSpace] = {
        "population_size": Choice((20, 30)),
        "mutation_decay": Range(0.65, 0.95),
        "mutation.n_bases": Range(6, 15, integer=True),
        "temperature": Range(1.0, 10.0, log=True),
    }
    tunable_over_contexts: ClassVar[SearchSpace] = TUNABLE_OVER_CONTEXTS

    def __init__(
        self, policy: str | type[GAPolicy], env: GymEnv | str, **shared: Unpack[GAArguments]
    ) -> None:
        super().__init__(policy, env, **shared)

    def _offspring(self, n: int, n_crossover: int, view: View) -> NDArray[np.float64]:
        """Copy stored rollouts, and cross pairs of the copies over."""
        buffer = self.replay_buffer
        weights = selection_weights(view.rewards, self.temperature)
        rows = self.rng.choice(len(buffer), n, p=weights)
        before, after, cuts = crossover_pairs(
            self.rng, n, n_crossover, self.policy.trajectory_shape[0]
        )
        stored = buffer.trajectories
        made = stored[rows].astype(np.float64)
        made[n - n_crossover :] = blend(stored[rows[before]], stored[rows[after]], cuts)
        return made

    def _promise(self, trajectories: NDArray[np.float64], view: View) -> NDArray[np.float64]:
        """Let Gaussian processes judge, in the place of RC-NMP's networks."""
        buffer = self.replay_buffer
        known, asked = features(buffer.trajectories[-NEWEST:], trajectories)
        wanted = Wanted.of(view.rewards[-NEWEST:], view.successes[-NEWEST:])
        if not wanted.is_split:
            return gaussian_process(known, wanted.score[:, None])(asked).T
        success = gaussian_process(known, wanted.success[:, None])(asked)
        rows = np.flatnonzero(wanted.success)
        value = gaussian_process(known[rows], wanted.score[rows, None])(asked)
        return np.log(np.clip(success, 1e-3, 1.0)).T + value.T


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
