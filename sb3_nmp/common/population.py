"""`PopulationSearch`: what RC-NMP shares with a genetic search without a network.

Replay buffer, elites, mutation by smooth noise and the PD controller (thesis 6.1: I, V, VI). A
subclass supplies where a member's trajectory comes from before it is mutated.
"""

from abc import abstractmethod
from dataclasses import replace
from typing import Any, Protocol, cast

import numpy as np
import torch as th
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.type_aliases import GymEnv, Schedule

from sb3_nmp.common.algorithm import Generation, TrajectoryAlgorithm
from sb3_nmp.common.buffer import TrajectoryBuffer
from sb3_nmp.common.elites import EliteMemory
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.common.policies import TrajectoryPolicy


class RemembersElites(Protocol):
    """A policy that keeps the best trajectories."""

    elites: EliteMemory


class PopulationSearch(TrajectoryAlgorithm):
    """A search by populations around the best rollouts so far.

    The first generation executes the initial trajectories as they are and, for the rest of the
    members, mutated; later ones mutate what the subclass proposes. Every trajectory passes the PD
    controller before it is executed and stored.

    :param policy: the policy's class or alias
    :param env: the environment or its id
    :param n_plain: members of a generation that are no crossover children
    :param n_crossover: members that are crossover children, even
    :param mutation: noise of the first generation, in the trajectory's unit; None switches it off
    :param mutation_decay: factor on the noise after each generation, in (0, 1]
    :param mutation_rate: probability with which each of the noise's bases takes part, after the
        first generation
    :param n_explorers: members of every generation that are made as in the first one, so that a
        search whose noise has decayed can still leave a local optimum
    :param pd_controller: filter of every trajectory, from the initial trajectory's first point to
        its last one; None sends trajectories as they are
    :param initial_trajectories: guesses whose rewards are not known, shape (T, D) or (M, T, D); by
        default the environment's ``initial_trajectory``
    :param buffer_size: rollouts kept; None keeps all
    :param n_elites: best rollouts that a full buffer never drops
    :param temperature: in places, > 0: small ones prefer the best rollouts
    :param learning_rate: see `TrajectoryAlgorithm`, as for the rest
    :param policy_kwargs: further arguments of the policy
    :param stats_window_size: rollouts over which the log averages
    :param tensorboard_log: folder for TensorBoard
    :param verbose: amount of printing
    :param seed: of the search
    :param device: of the policy
    :param _init_setup_model: whether to build the policy at once
    :raises ConfigurationError: a value outside its range, or a population that does not fit
    """

    def __init__(
        self,
        policy: str | type[TrajectoryPolicy],
        env: GymEnv | str,
        n_plain: int,
        n_crossover: int,
        mutation: SmoothNoise | None,
        mutation_decay: float,
        mutation_rate: float,
        n_explorers: int,
        pd_controller: PDController | None,
        initial_trajectories: ArrayLike | None,
        buffer_size: int | None,
        n_elites: int,
        temperature: float,
        learning_rate: float | Schedule,
        policy_kwargs: dict[str, Any] | None,
        stats_window_size: int,
        tensorboard_log: str | None,
        verbose: int,
        seed: int | None,
        device: th.device | str,
        _init_setup_model: bool,
    ) -> None:
        self.n_plain = n_plain
        self.n_crossover = n_crossover
        self.mutation = mutation
        self.mutation_decay = mutation_decay
        self.mutation_rate = mutation_rate
        self.n_explorers = n_explorers
        self.pd_controller = pd_controller
        self.initial_trajectories = initial_trajectories
        self.buffer_size = buffer_size
        self.n_elites = n_elites
        self.temperature = temperature
        self._initial: NDArray[np.float64] | None = None
        self._noise: NDArray[np.float64] | None = None
        for name, (fits, rule) in self._rules().items():
            if not fits:
                raise ConfigurationError(f"{name} is {getattr(self, name)!r}; it must be {rule}.")
        super().__init__(
            policy=policy,
            env=env,
            population_size=n_plain + n_crossover,
            learning_rate=learning_rate,
            policy_kwargs=policy_kwargs,
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            seed=seed,
            device=device,
            _init_setup_model=_init_setup_model,
        )

    @abstractmethod
    def _draw_members(self) -> None:
        """Draw what the next generation's members are made of; the buffer is not empty."""

    @abstractmethod
    def _member(self, member: int, context: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return one member's trajectory before mutation, shape (T, D).

        :param member: which of the ``population_size`` members
        :param context: its context, shape (C,)
        """

    def _rules(self) -> dict[str, tuple[bool, str]]:
        """Return for each setting whether it fits, and its rule in words."""
        return {
            "n_plain": (self.n_plain >= 0, ">= 0"),
            "n_crossover": (
                self.n_crossover >= 0 and self.n_crossover % 2 == 0,
                "even and >= 0: each pair of parents has two children",
            ),
            "mutation_decay": (0 < self.mutation_decay <= 1, "in (0, 1]"),
            "mutation_rate": (0 < self.mutation_rate <= 1, "in (0, 1]"),
            "n_explorers": (
                0 <= self.n_explorers < self.n_plain + self.n_crossover,
                "at least 0 and less than the population",
            ),
            "temperature": (self.temperature > 0, "> 0; math.inf draws all rollouts alike"),
        }

    def _setup_model(self) -> None:
        super()._setup_model()
        self.replay_buffer = TrajectoryBuffer(
            self.policy.context_dim, self.policy.trajectory_shape, self.buffer_size, self.n_elites
        )

    @property
    def initial(self) -> NDArray[np.float64]:
        """The trajectories from which the search starts, shape (M, T, D)."""
        if self._initial is None:
            given = self.initial_trajectories
            initial = self.initial_trajectory() if given is None else np.asarray(given, np.float64)
            initial = initial[None] if initial.ndim == 2 else initial
            shape = self.policy.trajectory_shape
            if initial.shape[1:] != shape or not np.isfinite(initial).all():
                raise ConfigurationError(
                    f"initial_trajectories of shape {initial.shape} were given; they must be "
                    f"finite and of shape (T, D) = {shape} or (M, T, D)."
                )
            self._initial = initial
        return self._initial

    @property
    def _n_fresh(self) -> int:
        """How many members, the first ones, mutate an initial trajectory."""
        return self.population_size if len(self.replay_buffer) == 0 else self.n_explorers

    def _begin_generation(self) -> None:
        n, shape = self.population_size, self.policy.trajectory_shape
        noise = np.zeros((n, *shape))
        if self.mutation is not None:
            if self.mutation.sigma is None:
                self.mutation = replace(self.mutation, sigma=self.exploration_scale())
            fresh = self._n_fresh
            scale = self.mutation_decay**self._n_updates
            noise[:fresh] = self.mutation.sample(self.rng, fresh, shape)
            noise[fresh:] = scale * self.mutation.sample(
                self.rng, n - fresh, shape, self.mutation_rate
            )
            self.logger.record("train/mutation_scale", scale)
        if len(self.replay_buffer) == 0:
            noise[: len(self.initial)] = 0.0
        else:
            self._draw_members()
        self._noise = noise

    def _propose(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        """Make, mutate and filter one member at a time.

        Members are never batched, so that a member's bits do not depend on how many environments
        step together.
        """
        noise, ends = cast(NDArray[np.float64], self._noise), self.initial.mean(axis=0)[[0, -1]]
        proposed = []
        for member, context in zip(range(members.start, members.stop), contexts, strict=True):
            if member < self._n_fresh:
                desired = self.initial[member % len(self.initial)]
            else:
                desired = self._member(member, context)
            desired = desired + noise[member]
            if self.pd_controller is not None:
                desired = self.pd_controller(desired[None], ends[0], ends[1])[0]
            proposed.append(desired)
        return np.stack(proposed)

    def _observe(self, rollouts: Generation) -> None:
        elites = cast(RemembersElites, self.policy).elites
        elites.update(rollouts.contexts, rollouts.trajectories, rollouts.rewards)

    def _end_generation(self, generation: Generation) -> None:
        self.replay_buffer.add(generation.contexts, generation.trajectories, generation.rewards)
        self.logger.record("train/best_reward", float(self.replay_buffer.rewards.max()))
        self.logger.record("train/buffer_size", len(self.replay_buffer))

    # -- saving --------------------------------------------------------------------------------

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "replay_buffer"]

    def save_replay_buffer(self, path: str) -> None:
        """Write the replay buffer as .npz; with it, a saved model resumes exactly.

        :param path: of the file; SB3's CheckpointCallback calls this too
        """
        self.replay_buffer.save(path)

    def load_replay_buffer(self, path: str) -> None:
        """Read a replay buffer: to resume, or to seed a search with rollouts of known reward.

        :param path: of a file that `save_replay_buffer` wrote
        :raises FileFormatError: it is not such a file
        :raises InvalidDataError: its rollouts do not fit the environment
        """
        self.replay_buffer.load(path)
        buffer = self.replay_buffer
        elites = cast(RemembersElites, self.policy).elites
        elites.update(buffer.contexts, buffer.trajectories, buffer.rewards)


def blend(before: NDArray[Any], after: NDArray[Any], cut: int) -> NDArray[Any]:
    """Return the trajectory that follows one parent until the cut and the other from it on.

    :param before: shape (T, D)
    :param after: shape (T, D)
    :param cut: time index
    """
    return np.concatenate([before[:cut], after[cut:]])
