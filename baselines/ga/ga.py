"""GA: the elites, crossover and mutation of RC-NMP on the trajectories themselves, no network.

The row that a network must beat to earn its keep.
"""

from typing import Any, ClassVar

import numpy as np
import torch as th
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv

from baselines.ga.policies import ElitePolicy
from sb3_nmp.common.buffer import selection_weights
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.common.population import PopulationSearch, blend


class GA(PopulationSearch):
    """Genetic algorithm on trajectories: parents drawn by rank, crossover in time, mutation.

    It is `sb3_nmp.RCNMP` without its network: where RC-NMP decodes a latent, this copies a stored
    rollout, drawn by its place among all of them.

    :param policy: ``"MlpPolicy"``, kept for SB3's sake: there is no network
    :param env: the environment or its id
    :param n_copies: members of a generation that are mutated copies
    :param n_crossover: members that are crossover children, even
    :param mutation: noise of the first generation, in the trajectory's unit; None switches it off
    :param mutation_decay: factor on the noise after each generation, in (0, 1]
    :param mutation_rate: probability with which each basis of the noise takes part
    :param n_explorers: members of every generation, the first ones, that mutate the initial
        trajectory as in the first generation
    :param pd_controller: filter of every trajectory; None sends trajectories as they are
    :param initial_trajectories: guesses whose rewards are not known, shape (T, D) or (M, T, D)
    :param buffer_size: rollouts kept; None keeps all
    :param n_elites: best rollouts that a full buffer never drops
    :param temperature: parents are drawn with probability proportional to exp(-place / this)
    :param policy_kwargs: further arguments of the policy
    :param stats_window_size: rollouts over which the log averages
    :param tensorboard_log: folder for TensorBoard; None switches it off
    :param verbose: 0 nothing, 1 the log table, 2 debug messages
    :param seed: equal seeds give equal runs, bit for bit
    :param device: of the policy
    :param _init_setup_model: whether to build the policy at once
    :raises ConfigurationError: a value outside its range, or a population that does not fit
    """

    policy: ElitePolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": ElitePolicy}

    def __init__(
        self,
        policy: str | type[ElitePolicy],
        env: GymEnv | str,
        n_copies: int = 2,
        n_crossover: int = 18,
        mutation: SmoothNoise | None = SmoothNoise(),  # noqa: B008 (frozen)
        mutation_decay: float = 0.8,
        mutation_rate: float = 0.5,
        n_explorers: int = 0,
        pd_controller: PDController | None = PDController(),  # noqa: B008 (frozen)
        initial_trajectories: ArrayLike | None = None,
        buffer_size: int | None = None,
        n_elites: int = 1,
        temperature: float = 2.0,
        policy_kwargs: dict[str, Any] | None = None,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: th.device | str = "cpu",
        _init_setup_model: bool = True,
    ) -> None:
        self.n_copies = n_copies
        self._parents: NDArray[np.int_] = np.empty(0, int)
        self._before: NDArray[np.int_] = np.empty(0, int)
        self._after: NDArray[np.int_] = np.empty(0, int)
        self._cuts: NDArray[np.int_] = np.empty(0, int)
        super().__init__(
            policy=policy,
            env=env,
            n_plain=n_copies,
            n_crossover=n_crossover,
            mutation=mutation,
            mutation_decay=mutation_decay,
            mutation_rate=mutation_rate,
            n_explorers=n_explorers,
            pd_controller=pd_controller,
            initial_trajectories=initial_trajectories,
            buffer_size=buffer_size,
            n_elites=n_elites,
            temperature=temperature,
            learning_rate=0.0,
            policy_kwargs=policy_kwargs,
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            seed=seed,
            device=device,
            _init_setup_model=_init_setup_model,
        )

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
        if member < self.n_copies:
            return stored[self._parents[member]].astype(np.float64)
        child = member - self.n_copies
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
