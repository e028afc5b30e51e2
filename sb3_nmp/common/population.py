"""`PopulationSearch`: what RC-NMP shares with a genetic search without a network.

Replay buffer, elites, mutation by smooth noise and the PD controller (thesis 6.1: I, V, VI). A
subclass supplies where a member's trajectory comes from before it is mutated.
"""

from abc import abstractmethod
from typing import Any, Unpack, cast

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import GymEnv, Schedule
from stable_baselines3.common.vec_env import VecEnv

from sb3_nmp.common import environment
from sb3_nmp.common.arguments import SharedArguments
from sb3_nmp.common.buffer import TrajectoryBuffer
from sb3_nmp.common.buffered import BufferedAlgorithm
from sb3_nmp.common.contextual import ContextualExploration, ContextualSearch, Experience, Skill
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.elites import SAME_CONTEXT
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.common.policies import ElitePolicy
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import Rules


class PopulationArguments(SharedArguments, total=False):
    """Those that all searches by populations share; `PopulationSearch` describes them."""

    mutation: SmoothNoise | None
    mutation_rate: float
    pd_controller: PDController | None
    buffer_size: int | None
    n_elites: int
    contextual: ContextualExploration
    relabel: bool | None


class PopulationSearch(BufferedAlgorithm):
    """A search by populations around the best rollouts so far.

    The first generation executes the initial trajectories as they are and, for the rest of the
    members, mutated; later ones mutate what the subclass proposes. Every trajectory passes the PD
    controller before it is executed and stored.

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
    :param mutation: noise of the first generation, in units of ``exploration_scale``; None switches
        it off
    :param mutation_rate: probability with which each of the noise's bases takes part, after the
        first generation
    :param pd_controller: filter of every trajectory, from the initial trajectory's first point to
        its last one; None sends trajectories as they are
    :param buffer_size: rollouts kept; None keeps all
    :param n_elites: best rollouts that a full buffer never drops
    :param contextual: how far rollouts explore where contexts vary
    :param relabel: whether a rollout counts for the context that it achieved, where contexts vary:
        None does so where the environment tells one, True asks for an environment that does, False
        counts a rollout for its own context alone
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
        mutation: SmoothNoise | None = SmoothNoise(),  # noqa: B008 (frozen)
        mutation_rate: float = 0.5,
        pd_controller: PDController | None = PDController(),  # noqa: B008 (frozen)
        buffer_size: int | None = None,
        n_elites: int = 1,
        contextual: ContextualExploration = ContextualExploration(),  # noqa: B008 (frozen)
        relabel: bool | None = None,
        **shared: Unpack[SharedArguments],
    ) -> None:
        self.contextual, self.relabel = contextual, relabel
        self._search: ContextualSearch | None = None
        self._varies: bool | None = None
        self.n_crossover, self.mutation = n_crossover, mutation
        self.mutation_rate, self.mutation_decay = mutation_rate, mutation_decay
        self.n_explorers, self.temperature = n_explorers, temperature
        self.pd_controller = pd_controller
        self.buffer_size, self.n_elites = buffer_size, n_elites
        self._initial: NDArray[np.float64] | None = None
        self._noise: NDArray[np.float64] | None = None
        super().__init__(
            policy, env, population_size=population_size, learning_rate=learning_rate, **shared
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

    def _rules(self) -> Rules:
        n = self.population_size
        return {
            "population_size": (n >= 1, ">= 1"),
            "n_crossover": (
                0 <= self.n_crossover <= n and self.n_crossover % 2 == 0,
                f"even, >= 0 and at most the population of {n}: two parents have two children",
            ),
            "mutation_decay": (0 < self.mutation_decay <= 1, "in (0, 1]"),
            "mutation_rate": (0 < self.mutation_rate <= 1, "in (0, 1]"),
            "n_explorers": (0 <= self.n_explorers < n, "at least 0 and less than the population"),
            "temperature": (self.temperature > 0, "> 0; math.inf draws all rollouts alike"),
        }

    def _setup_model(self) -> None:
        super()._setup_model()
        if self.demonstrations is not None:
            self._initial = self.demonstrations.trajectories

    def _empty_buffer(self) -> TrajectoryBuffer:
        shape = self.policy.trajectory_shape
        return TrajectoryBuffer(self.policy.context_dim, shape, self.buffer_size, self.n_elites)

    @property
    def n_plain(self) -> int:
        """How many members are no crossover children; they come first."""
        return self.population_size - self.n_crossover

    @property
    def initial(self) -> NDArray[np.float64]:
        """The trajectories from which the search starts, shape (M, T, D)."""
        if self._initial is None:
            self._initial = self.initial_trajectory()[None]
        return self._initial

    @property
    def _n_fresh(self) -> int:
        """How many members, the first ones, mutate an initial trajectory."""
        return self.population_size if len(self.replay_buffer) == 0 else self.n_explorers

    def _begin_generation(self) -> None:
        if self._varies is None:
            self._look_at_contexts()
        if self._search is not None:
            skill, n = self._skill, self.population_size
            scales = self._search.scales(self.rng, n, skill.is_ready)
            self._noise = scales[:, None] * self.rng.standard_normal((n, skill.space.n_weights))
            return
        self._noise = self._draw_noise()
        if len(self.replay_buffer) == 0:
            self._noise[: len(self.initial)] = 0.0
        else:
            self._draw_members()

    def _draw_noise(self) -> NDArray[np.float64]:
        """Return the mutation of each member, shape (N, T, D)."""
        n, shape = self.population_size, self.policy.trajectory_shape
        noise = np.zeros((n, *shape))
        if self.mutation is not None:
            fresh, sigma = self._n_fresh, np.asarray(self.first_scale())
            scale = self.mutation_decay**self._n_updates
            noise[:fresh] = sigma * self.mutation.sample(self.rng, fresh, shape)
            later = self.mutation.sample(self.rng, n - fresh, shape, self.mutation_rate)
            noise[fresh:] = scale * (sigma * later)
            self.logger.record("train/mutation_scale", scale)
        return noise

    def _propose(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        """Make, mutate and filter one member at a time.

        Members are never batched, so that a member's bits do not depend on how many environments
        step together.
        """
        if self._search is not None:
            return self._explore(members, contexts)
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
        solved = rollouts.successes if self._search is not None else None
        self.policy.elites.update(
            rollouts.contexts, rollouts.trajectories, rollouts.rewards, solved
        )

    def _end_generation(self, generation: Generation) -> None:
        if generation.achieved is not None:
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
        self.logger.record("train/best_reward", float(self.replay_buffer.rewards.max()))
        self.logger.record("train/buffer_size", len(self.replay_buffer))

    # -- where contexts vary -------------------------------------------------------------------

    @property
    def _skill(self) -> Skill:
        return cast(Skill, self.policy.skill)  # pyright: ignore[reportAttributeAccessIssue]

    def set_env(self, env: GymEnv, force_reset: bool = True) -> None:
        """Exchange the environment; see SB3. Whether its contexts vary is found out anew.

        :param env: the new environment; its spaces must be the old one's
        :param force_reset: reset it before training goes on
        :raises ConfigurationError: the population does not fit the number of environments
        """
        super().set_env(env, force_reset)
        if self._search is None:
            self._varies = None

    def _look_at_contexts(self) -> None:
        """Find out whether contexts vary, and begin the skill where they do."""
        env = cast(VecEnv, self.env)
        drawn = [np.array(self._last_obs, np.float32)]
        if len(drawn[0]) < 2:
            drawn.append(np.array(env.reset(), np.float32))
        self._last_obs = drawn[-1]
        self._varies = bool(np.any(np.ptp(np.concatenate(drawn), axis=0) > SAME_CONTEXT))
        if self._varies:
            if self.relabel:
                environment.check_tells_achievement(env)
            self._search = ContextualSearch(self.contextual)
            self.replay_buffer.capacity = None
            self._begin_skill(env)

    def _begin_skill(self, env: VecEnv) -> None:
        """Look at the initial trajectories of a few contexts, which costs no rollout."""
        space = cast(spaces.Box, self.action_space)
        contexts: list[NDArray[np.float32]] = []
        initial: list[NDArray[np.float64]] = []
        while len(contexts) < 2 * (1 + self.policy.context_dim):
            contexts.extend(np.array(env.reset(), np.float32))
            initial.extend(environment.initial_trajectories(env, space))
        self._skill.space.begin(np.stack(contexts), np.stack(initial), self.first_scale())
        self._last_obs = np.stack(contexts[-env.num_envs :])
        if self.demonstrations is not None:
            self._learn_from_demonstrations(
                self.demonstrations, cast(ContextualSearch, self._search)
            )

    def _learn_from_demonstrations(self, shown: Demonstrations, search: ContextualSearch) -> None:
        """Let the skill learn what was shown, before the first rollout."""
        search.shown = shown.contexts, self._skill.space.weights(shown.contexts, shown.trajectories)
        self._learn_from_all(search, by_achievement=False)
        search.adapt(0.0, was_ready=False, is_ready=True, by_achievement=False)

    def _explore(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        """Return the answers to contexts with noise, shape (n, T, D)."""
        skill, noise = self._skill, cast(NDArray[np.float64], self._noise)[members]
        weights = skill.space.scale.cpu().numpy() * noise
        if skill.is_ready:
            which = np.arange(members.start, members.stop)
            weights = weights + skill.explore(contexts, which)
        return skill.space.trajectories(contexts, weights)

    def _learn_skill(self, generation: Generation, search: ContextualSearch) -> None:
        """Take in a generation, adapt the noise, and learn anew where enough has come together."""
        buffer, skill, was_ready = self.replay_buffer, self._skill, self._skill.is_ready
        n_before = len(buffer) - len(generation)
        search.take(generation.rewards, generation.successes, n_before, was_ready)
        achieved = None if self.relabel is False else buffer.achieved
        told = 0 if achieved is None else int(np.isfinite(achieved).all(axis=1).sum())
        if search.has_enough(told) and search.is_due(len(buffer)):
            self._learn_from_all(search, by_achievement=told > 0)
        rate = float(generation.successes.mean())
        search.adapt(rate, was_ready, skill.is_ready, told > 0)
        self.logger.record("train/exploration", search.scale)
        self.logger.record("train/success_rate", rate)

    def _learn_from_all(self, search: ContextualSearch, by_achievement: bool) -> None:
        """Let the skill learn from all rollouts, and from what was shown."""
        buffer, skill = self.replay_buffer, self._skill
        experience = Experience(
            buffer.contexts.astype(np.float64),
            skill.space.weights(buffer.contexts, buffer.trajectories),
            buffer.rewards,
            buffer.successes,
            buffer.achieved if by_achievement else None,
            search.example,
            search.since,
        )
        if search.shown is not None:
            experience = experience.after(*search.shown)
        seed = int(self.rng.integers(2**31))
        skill.learn(experience, th.Generator().manual_seed(seed))
        search.learned_from = len(buffer)

    def load_replay_buffer(self, path: str) -> None:
        """Read a replay buffer; its rollouts are remembered as elites too.

        :param path: of a file that `save_replay_buffer` wrote
        :raises FileFormatError: it is not such a file
        :raises InvalidDataError: its rollouts do not fit the environment
        """
        super().load_replay_buffer(path)
        buffer = self.replay_buffer
        solved = buffer.successes if self._search is not None else None
        self.policy.elites.update(buffer.contexts, buffer.trajectories, buffer.rewards, solved)


def blend(before: NDArray[Any], after: NDArray[Any], cut: int) -> NDArray[Any]:
    """Return the trajectory that follows one parent until the cut and the other from it on.

    :param before: shape (T, D)
    :param after: shape (T, D)
    :param cut: time index
    """
    return np.concatenate([before[:cut], after[cut:]])
