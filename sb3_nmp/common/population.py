"""`PopulationSearch`: what RC-NMP shares with a genetic search without a network.

Replay buffer, elites, mutation by smooth noise and the PD controller (thesis 6.1: I, V, VI). A
subclass supplies offspring before they are mutated, and may judge what they promise.
"""

import warnings
from abc import abstractmethod
from typing import Any, Unpack, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import GymEnv, Schedule

from sb3_nmp.common import environment
from sb3_nmp.common.buffer import TrajectoryBuffer
from sb3_nmp.common.exceptions import ResumeWarning
from sb3_nmp.common.niches import Niches, View
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.operators import take_turns
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.common.policies import ElitePolicy
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import Rules
from sb3_nmp.common.skill_search import SkillSearch, SkillSearchArguments


class PopulationArguments(SkillSearchArguments, total=False):
    """Those that all searches by populations share; `PopulationSearch` describes them."""

    mutation: SmoothNoise | None
    mutation_rate: float
    pd_controller: PDController | None
    buffer_size: int | None
    n_elites: int
    n_modes: int


class PopulationSearch(SkillSearch):
    """A search by populations around the best rollouts so far.

    The first generation executes the initial trajectories as they are and, for the rest of the
    members, mutated; later ones mutate offspring of what is stored. Every trajectory passes the PD
    controller before it is executed and stored. With several candidates for each member, those are
    executed that promise most.

    So much for one context. On an environment that draws contexts, a generation tries the present
    answer in new ones, with noise, and the policy's skill learns from what was right anywhere
    (`sb3_nmp.common.contextual`). The operators above have no part in it, and all rollouts are
    kept.

    :param n_crossover: members that are crossover children, even
    :param mutation_decay: factor on the noise after each generation, in (0, 1]
    :param n_explorers: members of every generation, the first ones, that are made as in the first
        generation, so that a search whose noise has decayed can still leave a local optimum
    :param temperature: stored rollouts are drawn with probability proportional to
        exp(-place / temperature), where the best has place 0; ``math.inf`` draws all alike
    :param demonstrations: whose trajectories the search starts from, whatever their contexts;
        None starts from the environment's ``initial_trajectory``. They are not saved with the
        model. Where contexts vary, they count as right in theirs from the beginning
    :param n_candidates: trajectories that are made for each member, of which one is executed; 1
        executes all that are made
    :param mutation: noise of the first generation, in units of ``exploration_scale``; None switches
        it off
    :param mutation_rate: probability with which each of the noise's bases takes part, after the
        first generation
    :param pd_controller: filter of every trajectory, from the initial trajectory's first point to
        its last one; None sends trajectories as they are
    :param buffer_size: rollouts kept; None keeps all
    :param n_elites: best rollouts that a full buffer never drops
    :param n_modes: ways to do the task that are looked for in one context; with several, half of a
        generation looks for those missing, and of the others a way found has the more, the
        fewer rollouts it has had
    """

    def __init__(
        self,
        policy: str | type[ElitePolicy],
        env: GymEnv | str,
        *,
        population_size: int = 20,
        n_crossover: int = 18,
        mutation_decay: float = 0.8,
        n_explorers: int = 0,
        temperature: float = 2.0,
        learning_rate: float | Schedule = 0.0,
        n_candidates: int = 1,
        mutation: SmoothNoise | None = SmoothNoise(),  # noqa: B008 (frozen)
        mutation_rate: float = 0.5,
        pd_controller: PDController | None = PDController(),  # noqa: B008 (frozen)
        buffer_size: int | None = None,
        n_elites: int = 1,
        n_modes: int = 1,
        **shared: Unpack[SkillSearchArguments],
    ) -> None:
        self.n_crossover, self.n_candidates = n_crossover, n_candidates
        self.mutation = mutation
        self.mutation_rate, self.mutation_decay = mutation_rate, mutation_decay
        self.n_explorers, self.temperature = n_explorers, temperature
        self.pd_controller = pd_controller
        self.buffer_size, self.n_elites = buffer_size, n_elites
        self._initial: NDArray[np.float64] | None = None
        self.n_modes, self._niches = n_modes, Niches(n_modes)
        self._members: NDArray[np.float64] | None = None
        self._n_before = 0  # generations in another context
        super().__init__(
            policy, env, population_size=population_size, learning_rate=learning_rate, **shared
        )

    @abstractmethod
    def _offspring(self, n: int, n_crossover: int, view: View) -> NDArray[np.float64]:
        """Return what stored rollouts give, before mutation, shape (n, T, D).

        :param n: how many
        :param n_crossover: so many, the last ones, are crossover children; even
        :param view: what the stored rollouts are worth
        """

    @abstractmethod
    def _promise(self, trajectories: NDArray[np.float64], view: View) -> NDArray[np.float64]:
        """Return how much candidates promise in the opinion of E judges, shape (E, N).

        :param trajectories: shape (N, T, D)
        :param view: what the stored rollouts are worth
        """

    def _rules(self) -> Rules:
        n = self.population_size
        return {
            "population_size": (n >= 1, ">= 1"),
            "n_crossover": (
                0 <= self.n_crossover <= n and self.n_crossover % 2 == 0,
                f"even, >= 0 and at most the population of {n}: two parents have two children",
            ),
            "n_modes": (
                self.n_modes == 1 or (1 < self.n_modes <= n // 2 and self.buffer_size is None),
                f">= 1, at most half the population of {n}, and above 1 the buffer_size None",
            ),
            "n_candidates": (self.n_candidates >= 1, ">= 1; 1 executes all that are made"),
            "mutation_decay": (0 < self.mutation_decay <= 1, "in (0, 1]"),
            "mutation_rate": (0 < self.mutation_rate <= 1, "in (0, 1]"),
            "n_explorers": (
                0 <= self.n_explorers < n - (self.n_modes > 1),
                "at least 0 and less than the population, and with several modes less by 2, for "
                "one rollout may be a test",
            ),
            "temperature": (self.temperature > 0, "> 0; math.inf draws all rollouts alike"),
        }

    def _setup_model(self) -> None:
        super()._setup_model()
        if self.demonstrations is not None:
            self._initial = self.demonstrations.trajectories

    def _empty_buffer(self) -> TrajectoryBuffer:
        shape = self.policy.trajectory_shape
        capacity = None if self._varies else self.buffer_size
        return TrajectoryBuffer(self.policy.context_dim, shape, capacity, self.n_elites)

    def _made_with(self) -> dict[str, Any]:
        return super()._made_with() | {"n_modes": self._niches.n_modes}

    @property
    def initial(self) -> NDArray[np.float64]:
        """The trajectories from which the search starts, shape (M, T, D)."""
        if self._initial is None:
            self._initial = self.initial_trajectory()[None]
        return self._initial

    def _begin_generation(self) -> None:
        is_elsewhere, before = self._is_elsewhere(), self._pinned_context
        if self._varies is None or is_elsewhere:
            self._look_at_contexts()
        if is_elsewhere and before is not None and not self._varies:
            self._begin_in_another_context(before)
        if self._search is not None:
            self._begin_exploration(self._search)
        elif len(self.replay_buffer) == 0:
            self._members = self._first_members()
        else:
            self._members = self._next_members()

    def _begin_in_another_context(self, before: NDArray[np.float32]) -> None:
        """Forget the search of the context before: its start, its goal, and what earned what.

        The policy still remembers the best rollout there, and the network keeps its weights.

        :param before: that context, shape (C,)
        """
        warnings.warn(
            f"the environment's context is {np.asarray(self._last_obs)[0].tolist()}, and the "
            f"search was in {before.tolist()}: it begins anew. To learn for many contexts, give an "
            "environment that draws them.",
            ResumeWarning,
            stacklevel=5,
        )
        self.replay_buffer = self._empty_buffer()
        self._forget_rollouts()
        self._initial = None if self.demonstrations is None else self.demonstrations.trajectories
        self.policy.ways.forget()

    def _forget_rollouts(self) -> None:
        super()._forget_rollouts()
        self._niches, self._n_before = Niches(self.n_modes), self._n_updates

    def _first_members(self) -> NDArray[np.float64]:
        """Return the initial trajectories, and mutations of them, shape (N, T, D)."""
        n = self.population_size
        noise = self._mutations(n, n, 0)
        noise[: len(self.initial)] = 0.0
        return self._filter(self.initial[np.arange(n) % len(self.initial)] + noise)

    def _next_members(self) -> NDArray[np.float64]:
        """Return explorers, and of mutated offspring those that promise most, shape (N, T, D)."""
        n, explorers = self.population_size, self.n_explorers
        line = self.initial.mean(axis=0)
        generation = self._n_updates - self._n_before
        test = self._niches.to_test(self.replay_buffer, line, generation)
        tested = [] if test is None else [test[None]]
        made = []
        for view in self._views(n - explorers - len(tested)):
            made.append(self._members_of(view, explorers))
            explorers = 0
        return np.concatenate([*tested, *made])

    def _views(self, n: int) -> list[View]:
        """Return what the rollouts are worth to n members of the next generation."""
        line = self.initial.mean(axis=0)
        return self._niches.views(self.replay_buffer, line, n, self._n_updates - self._n_before)

    def _members_of(self, view: View, explorers: int) -> NDArray[np.float64]:
        """Return explorers and the members of one view, shape (explorers + view.n, T, D)."""
        n_candidates, initial = view.n * self.n_candidates, self.initial
        n_made = explorers + n_candidates
        n_fresh = explorers + int(view.fresh * n_candidates)
        noise = self._mutations(n_made, n_fresh, view.age)
        share = (explorers + view.n) / self.population_size
        n_crossover = 2 * round(share * self.n_crossover / 2) * self.n_candidates
        n_crossover = min(n_crossover, n_made // 2 * 2)
        made = self._offspring(n_made, n_crossover, view)
        made[:n_fresh] = initial[np.arange(n_fresh) % len(initial)]
        made = self._filter(made + noise)
        if self.n_candidates == 1:
            return made
        space = cast(spaces.Box, self.action_space)
        candidates = np.clip(made[explorers:], space.low, space.high)
        chosen = take_turns(self._promise(candidates, view), view.n)
        return np.concatenate([made[:explorers], candidates[chosen]])

    def _mutations(self, n: int, n_fresh: int, age: int) -> NDArray[np.float64]:
        """Return smooth noise (V), shape (n, T, D).

        :param n: how many
        :param n_fresh: so many, the first ones, are as in the first generation
        :param age: generations since the noise of the others began to decay
        """
        shape = self.policy.trajectory_shape
        noise = np.zeros((n, *shape))
        if self.mutation is not None:
            sigma = np.asarray(self.first_scale())
            scale = self.mutation_decay**age
            noise[:n_fresh] = sigma * self.mutation.sample(self.rng, n_fresh, shape)
            later = self.mutation.sample(self.rng, n - n_fresh, shape, self.mutation_rate)
            noise[n_fresh:] = scale * (sigma * later)
            self.logger.record("train/mutation_scale", scale)
        return noise

    def _filter(self, desired: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what the PD controller makes of trajectories (VI), shape (N, T, D).

        :param desired: shape (N, T, D)
        """
        if self.pd_controller is None:
            return desired
        start, goal = self.initial.mean(axis=0)[[0, -1]]
        return self.pd_controller(desired, start, goal)

    def _propose(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        """Return some of the generation, which was made as a whole.

        So a member's bits do not depend on how many environments step together.
        """
        if self._search is not None:
            return self._explore(members, contexts)
        return cast(NDArray[np.float64], self._members)[members]

    def _observe(self, rollouts: Generation) -> None:
        self.policy.elites.update(
            rollouts.contexts, rollouts.trajectories, rollouts.rewards, rollouts.successes
        )

    def _end_generation(self, generation: Generation) -> None:
        space = cast(spaces.Box, self.observation_space)
        environment.check_achieved(generation.achieved, space)
        self.replay_buffer.add(
            generation.contexts,
            generation.trajectories,
            generation.rewards,
            generation.successes,
            generation.achieved,
        )
        if self._search is not None:
            self._learn_skill(generation, self._search)
        elif self.n_modes > 1:
            self._learn_modes(len(generation))
        self.logger.record("train/best_reward", float(self.replay_buffer.rewards.max()))
        self.logger.record("train/buffer_size", len(self.replay_buffer))

    def _learn_modes(self, n: int) -> None:
        """Look for new modes in the last n rollouts, and remember the best rollout of each."""
        buffer, niches, line = self.replay_buffer, self._niches, self.initial.mean(axis=0)
        niches.take(buffer, line, len(buffer) - n, self._n_updates - self._n_before + 1)
        if niches.best:
            rows = niches.best
            self.policy.ways.forget()
            numbers = np.arange(len(rows), dtype=np.float64)[:, None]
            self.policy.ways.update(numbers, buffer.trajectories[rows], buffer.rewards[rows])
        self.logger.record("train/modes", len(niches.best))
