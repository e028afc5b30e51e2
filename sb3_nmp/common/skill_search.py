"""`SkillSearch`: a search by populations in ever new contexts, of which a skill learns.

What `sb3_nmp.common.contextual` says is done here: the policy holds the skill, the algorithm the
search.
"""

from typing import Unpack, cast

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import GymEnv, Schedule
from stable_baselines3.common.vec_env import VecEnv

from sb3_nmp.common import hints
from sb3_nmp.common.arguments import SharedArguments
from sb3_nmp.common.buffered import BufferedAlgorithm
from sb3_nmp.common.contextual import ContextualExploration, ContextualSearch, Experience, Skill
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.elites import SAME_CONTEXT
from sb3_nmp.common.files import AnyPath
from sb3_nmp.common.policies import ElitePolicy
from sb3_nmp.common.rollouts import Generation, Information


class SkillSearchArguments(SharedArguments, total=False):
    """Those of searches over contexts; `SkillSearch` describes them."""

    contextual: ContextualExploration
    relabel: bool | None


class SkillSearch(BufferedAlgorithm):
    """Where an environment draws contexts, explore around the answer and learn it from all.

    :param contextual: how far rollouts explore where contexts vary
    :param relabel: whether a rollout counts for the context that it achieved, where contexts vary:
        None does so where the environment tells one and nothing was demonstrated, True asks for an
        environment that does, False counts a rollout for its own context alone
    """

    def __init__(
        self,
        policy: str | type[ElitePolicy],
        env: GymEnv | str,
        *,
        population_size: int,
        learning_rate: float | Schedule = 0.0,
        contextual: ContextualExploration = ContextualExploration(),  # noqa: B008 (frozen)
        relabel: bool | None = None,
        **shared: Unpack[SharedArguments],
    ) -> None:
        self.contextual, self.relabel = contextual, relabel
        self._search: ContextualSearch | None = None
        self._varies: bool | None = None
        #: the one that is searched, as long as contexts do not vary
        self._pinned_context: NDArray[np.float32] | None = None
        self._tells_achievement = False
        self._noise: NDArray[np.float64] | None = None
        super().__init__(
            policy, env, population_size=population_size, learning_rate=learning_rate, **shared
        )

    @property
    def _skill(self) -> Skill:
        return cast(Skill, self.policy.skill)  # pyright: ignore[reportAttributeAccessIssue]

    @property
    def information(self) -> frozenset[Information]:
        """Success besides; where rollouts told what they achieved, that instead of the reward."""
        known = super().information | {Information.SUCCESS}
        told = np.isfinite(self.replay_buffer.achieved).any()
        if not (self._varies and told and self._relabels):
            return known
        return known - {Information.REWARD} | {Information.ACHIEVED_CONTEXTS}

    @property
    def _relabels(self) -> bool:
        """Whether a rollout counts for the context that it achieved, where one is told.

        By default not beside demonstrations: early rollouts achieve little, and what they achieve
        is worse to learn from than what was shown.
        """
        if self.relabel is not None:
            return self.relabel
        return self._search is None or self._search.shown is None

    def set_env(self, env: GymEnv | str, force_reset: bool = True) -> None:
        """Exchange the environment; see SB3. Whether its contexts vary is found out anew.

        :param env: the new environment; its spaces must be the old one's
        :param force_reset: reset it before training goes on
        :raises ConfigurationError: the population does not fit the number of environments
        """
        super().set_env(env, force_reset)
        if self._search is None:
            self._varies = None

    def _misfit(self, n_envs: int) -> str | None:
        why, pinned = super()._misfit(n_envs), self._pinned_context
        if why is not None or pinned is None or not self._collected:
            return why
        contexts = np.concatenate([part.contexts for part in self._collected])
        all_there = np.abs(contexts - pinned).max() <= SAME_CONTEXT
        return "another context is pinned" if all_there and self._is_elsewhere() else None

    def _is_elsewhere(self) -> bool:
        """Return whether the environments are in another context than the one that is searched.

        They are where the model was loaded with another environment, or where one that draws
        contexts drew the same ones when it was first looked at.
        """
        known = self._pinned_context
        if self._search is not None or known is None:
            return False
        seen = np.concatenate([known[None], self._latest_contexts(), np.asarray(self._last_obs)])
        return bool(np.ptp(seen, axis=0).max() > SAME_CONTEXT)

    def _latest_contexts(self) -> NDArray[np.float32]:
        """Return the contexts of the last generation, shape (N, C)."""
        return self.replay_buffer.contexts[-self.population_size :]

    def _look_at_contexts(self) -> None:
        """Find out whether contexts vary, and begin the skill where they do."""
        env = cast(VecEnv, self.env)
        drawn = [np.array(self._last_obs, np.float32)]
        if len(drawn[0]) < 2:
            drawn.append(self._reset(env))
        self._last_obs = drawn[-1]
        looked_at = [np.concatenate(drawn)]
        if self._pinned_context is not None and len(self.replay_buffer):
            looked_at.append(self._latest_contexts())
        self._varies = any(bool(np.ptp(rows, axis=0).max() > SAME_CONTEXT) for rows in looked_at)
        self._pinned_context = None if self._varies else drawn[-1][0]
        if self._varies:
            if self.relabel:
                hints.check_tells_achievement(env)
            self._search = ContextualSearch(self.contextual)
            self.replay_buffer.capacity = None
            self._begin_skill(env)
            self._tells_achievement = self._relabels and hints.tells_achievement(env)

    def _begin_skill(self, env: VecEnv) -> None:
        """Look at the initial trajectories of a few contexts, which costs no rollout."""
        space = cast(spaces.Box, self.action_space)
        contexts: list[NDArray[np.float32]] = []
        initial: list[NDArray[np.float64]] = []
        while len(contexts) < 2 * (1 + self.policy.context_dim):
            contexts.extend(self._reset(env))
            initial.extend(hints.initial_trajectories(env, space))
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

    def _begin_exploration(self, search: ContextualSearch) -> None:
        """Draw the noise of a generation in new contexts."""
        search.exploration = self.contextual  # which loading may have changed
        skill, n = self._skill, self.population_size
        scales = search.scales(self.rng, n, skill.is_ready)
        self._noise = scales[:, None] * self.rng.standard_normal((n, skill.space.n_weights))

    def _explore(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        """Return the answers to contexts with noise, shape (n, T, D)."""
        skill, noise = self._skill, cast(NDArray[np.float64], self._noise)[members]
        weights = skill.space.scale.cpu().numpy() * noise
        if skill.is_ready:
            asked = th.as_tensor(contexts, device=self.device)
            nearer = self.policy.repertoire.approach(asked, self.contextual.stride)
            contexts = nearer.cpu().numpy()
            which = np.arange(members.start, members.stop)
            weights = weights + skill.explore(contexts, which)
        return skill.space.trajectories(contexts, weights)

    def _learn_skill(self, generation: Generation, search: ContextualSearch) -> None:
        """Take in a generation, adapt the noise, and learn anew where enough has come together."""
        buffer, skill, was_ready = self.replay_buffer, self._skill, self._skill.is_ready
        n_before = len(buffer) - len(generation)
        search.take(generation.rewards, generation.successes, n_before, was_ready)
        achieved = buffer.achieved if self._relabels else None
        tells: NDArray[np.bool_] = np.zeros(0, bool)
        if achieved is not None:
            tells = np.asarray(np.isfinite(achieved).all(axis=1))
        told = int(tells.sum())
        if achieved is not None and told:
            self.policy.repertoire.learn(
                buffer.contexts, achieved, buffer.successes, buffer.trajectories,
                search.exploration.alike,
            )  # fmt: skip
        if search.has_enough(told) and search.is_due(len(buffer)):
            self._learn_from_all(search, by_achievement=told > 0)
        if not skill.is_ready and self._tells_achievement:
            search.widen(float(tells[n_before:].mean()))
        rate = float(generation.successes.mean())
        search.adapt(rate, was_ready, skill.is_ready, told > 0)
        self.logger.record("train/exploration", search.scale)
        self.logger.record("train/success_rate", rate)

    def _learn_from_all(self, search: ContextualSearch, by_achievement: bool) -> None:
        """Let the skill learn from all rollouts, and from what was shown.

        Weights are deviations from where a context lets begin: of a rollout that counts for what it
        achieved, from where that context would have.
        """
        buffer, skill = self.replay_buffer, self._skill
        right_in = buffer.contexts
        if by_achievement:
            told = np.isfinite(buffer.achieved).all(axis=1, keepdims=True)
            right_in = np.where(told, buffer.achieved, buffer.contexts)
        experience = Experience(
            buffer.contexts.astype(np.float64),
            skill.space.weights(right_in, buffer.trajectories),
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

    def _forget_rollouts(self) -> None:
        super()._forget_rollouts()
        if self._search is not None:
            self._search.example, self._search.since, self._search.learned_from = None, 0, 0

    def load_replay_buffer(self, path: AnyPath, truncate_last_traj: bool = True) -> None:
        """Read a replay buffer; its rollouts are remembered as elites too.

        :param path: of a file that `save_replay_buffer` wrote
        :param truncate_last_traj: without effect, see `BufferedAlgorithm`
        :raises FileFormatError: it is not such a file
        :raises InvalidDataError: its rollouts do not fit the environment
        """
        super().load_replay_buffer(path, truncate_last_traj)
        buffer = self.replay_buffer
        self.policy.elites.update(
            buffer.contexts, buffer.trajectories, buffer.rewards, buffer.successes
        )
