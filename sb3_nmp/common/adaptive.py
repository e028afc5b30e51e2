"""`AdaptiveAlgorithm`: demonstrations first, then a search wherever they do not suffice.

The loop that ACNMP (thesis Fig. 5.1) and the methods it is compared with share: a policy learned
from demonstrations is tried in its contexts; where a rollout is not satisfactory, a search in that
context starts (`ContextSearch`); once a rollout is satisfactory, it is assimilated.
"""

import warnings
from abc import abstractmethod
from typing import Any, ClassVar, Unpack, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import GymEnv, Schedule
from stable_baselines3.common.vec_env import VecEnv

from sb3_nmp.common.arguments import SharedArguments
from sb3_nmp.common.buffered import BufferedAlgorithm
from sb3_nmp.common.context_search import ContextSearch, Proposals, Search, ask_all, thresholds
from sb3_nmp.common.demonstrations import Demonstrations, check_type
from sb3_nmp.common.elites import SAME_CONTEXT
from sb3_nmp.common.environment import check_achieved, check_multiple
from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError, ResumeWarning
from sb3_nmp.common.policies import ElitePolicy
from sb3_nmp.common.rollouts import Generation, Information
from sb3_nmp.common.settings import Rules

#: arguments that a search under way follows; it keeps the others as it began with them
FOLLOWED = {
    *("population_size", "max_generations", "n_contexts", "reward_threshold", "learning_rate"),
    *("adaptation", "pretraining", "demonstrations", "seed", "device"),
    *("verbose", "tensorboard_log", "stats_window_size", "policy_kwargs"),
}
#: demonstrations that a search in a pinned context begins anew from
N_ELSEWHERE = 3


class AdaptiveArguments(SharedArguments, total=False):
    """Those that all adaptive algorithms share; `AdaptiveAlgorithm` describes them."""

    n_contexts: int | None
    reward_threshold: float | tuple[float, float] | None


class AdaptiveAlgorithm(BufferedAlgorithm):
    """Learns from demonstrations, and searches where the learned policy fails.

    On an environment whose context is fixed, every generation searches in that context. On one
    that draws contexts, a generation tries the greedy trajectory in ``n_contexts`` new ones. Those
    in which it is not satisfactory are then searched side by side, with ``population_size``
    rollouts per generation in each, until a rollout is satisfactory or the search has lasted
    ``max_generations``; the best successful rollout is assimilated. What is satisfactory is a
    success, and a reward where ``reward_threshold`` asks for one.

    Solutions that barely succeed teach a policy that often fails. Two settings leave it a margin:
    ``n_successes`` and ``reward_threshold``.

    An algorithm that learns from the demonstrations again and again (``rehearses``) keeps them in
    its policy, so that a loaded model can go on. What was assimilated is the ``replay_buffer``,
    which `save_replay_buffer` writes apart.

    :param population_size: rollouts per generation in each context that is searched; a multiple of
        the number of environments, to which the default is rounded up
    :param max_generations: a search among drawn contexts ends after so many
    :param demonstrations: of the expert
    :param n_contexts: new contexts that are tried at once; None: ``population_size``
    :param reward_threshold: a rollout is satisfactory if it succeeds with at least this reward;
        None asks for success alone. Two values: a greedy rollout below the first one begins a
        search, a rollout of at least the second one ends it
    :param n_successes: a search among drawn contexts goes on until so many rollouts are
        satisfactory, and the mean of the best so many is assimilated; 1 assimilates the best one,
        as in a pinned context
    """

    needs_demonstrations: ClassVar[bool] = True
    #: whether it needs the demonstrations whenever it learns, and not only at first
    rehearses: ClassVar[bool] = False

    def __init__(
        self,
        policy: str | type[ElitePolicy],
        env: GymEnv | str,
        *,
        population_size: int,
        max_generations: int,
        learning_rate: float | Schedule = 0.0,
        n_contexts: int | None = None,
        n_successes: int = 1,
        reward_threshold: float | tuple[float, float] | None = None,
        **shared: Unpack[SharedArguments],
    ) -> None:
        shown = check_type(shared.get("demonstrations"))
        self.demonstrations_digest = None if shown is None else shown.digest
        self.n_contexts = population_size if n_contexts is None else n_contexts
        self._n_contexts_given = n_contexts is not None
        self.reward_threshold, self.max_generations = reward_threshold, max_generations
        self.n_successes = n_successes
        self.searches: list[ContextSearch] = []
        self.n_given_up, self._pinned = 0, False
        self._proposals: Proposals | None = None
        super().__init__(
            policy, env, population_size=population_size, learning_rate=learning_rate, **shared
        )

    # -- what an algorithm supplies ------------------------------------------------------------

    @abstractmethod
    def _new_search(self, context: NDArray[np.float32]) -> Search:
        """Return a search that starts from what has been learned.

        :param context: shape (C,)
        """

    def _adapt(self, searched: list[ContextSearch], solved: list[ContextSearch]) -> None:
        """Learn after a generation; by default, nothing.

        :param searched: those that the generation's rollouts were made in
        :param solved: those of them that are closed now with a solution, to be assimilated; they
            are in the replay buffer already. A pinned context's search is among them whenever its
            solution has become better
        """

    # -- set-up --------------------------------------------------------------------------------

    @property
    def information(self) -> frozenset[Information]:
        """Success besides: it tells what is assimilated and remembered."""
        return super().information | {Information.SUCCESS}

    def _rules(self) -> Rules:
        begin, end = thresholds(self.reward_threshold)
        return {
            "max_generations": (self.max_generations >= 1, ">= 1"),
            "n_successes": (self.n_successes >= 1, ">= 1"),
            "reward_threshold": (
                begin <= end,
                "one value, or (begin, end) with begin <= end: a search that begins below "
                f"{begin} must not end with less",
            ),
        }

    def _setup_model(self) -> None:
        super()._setup_model()
        given, known = self.demonstrations, self.demonstrations_digest
        if self.needs_demonstrations and known is None:
            raise ConfigurationError(
                f"{type(self).__name__} learns from demonstrations first: give demonstrations=, "
                "such as Demonstrations.from_task(env_id, contexts) or Demonstrations.load(path)."
            )
        if given is not None and given.digest != known:
            raise InvalidDataError(
                f"these demonstrations (digest {given.digest[:12]}) are not those that the model "
                f"was made with ({known[:12] if known else 'none'})."
            )
        if self.rehearses and given is not None:
            self.policy.shown.take(given)

    def _fit_environments(self, env: VecEnv) -> None:
        super()._fit_environments(env)
        if not self._n_contexts_given:
            self.n_contexts = self.population_size
        check_multiple("n_contexts", self.n_contexts, env.num_envs)

    def _leave_environment(self) -> None:
        """Drop the searches that are under way."""
        super()._leave_environment()
        self.searches, self._proposals = [], None

    def _recall_demonstrations(self) -> None:
        """Take the demonstrations of a loaded model from its policy, where it learns them again."""
        if self.rehearses and self.demonstrations is None:
            self.demonstrations = self.policy.shown.demonstrations()

    def training_set(self) -> Demonstrations:
        """Return the demonstrations together with what was assimilated."""
        shown, found = cast(Demonstrations, self.demonstrations), self.replay_buffer
        return shown.joined_with(found.contexts, found.trajectories) if len(found) else shown

    def _tell_late(self, given: dict[str, Any]) -> None:
        kept = sorted(set(given) - FOLLOWED - set(self._made_with()))  # those are as they were
        if kept and self.searches:
            warnings.warn(
                f"the search under way keeps {' and '.join(kept)} as it began with them; the next "
                "one takes what is given. Train a new model to have it from the first rollout.",
                ResumeWarning,
                stacklevel=3,
            )

    def _context_unit(self) -> NDArray[np.float64]:
        """Return the standard deviation of each entry of the demonstrated contexts, shape (C,).

        1 where all of them agree.
        """
        spread = cast(Demonstrations, self.demonstrations).contexts.std(axis=0, dtype=np.float64)
        return np.where(spread > SAME_CONTEXT, spread, 1.0)

    @property
    def _may_search_nearer(self) -> bool:
        """Whether searches may explore less far than the environment's scale says.

        They may among drawn contexts, where nobody has given another scale.
        """
        return not self._pinned and self.exploration_scale is None

    def _shown_nearest(
        self, context: NDArray[np.floating], answer: NDArray[np.float64]
    ) -> list[NDArray[np.float64]]:
        """Return the trajectories shown in the contexts nearest to a pinned one, (T, D) each.

        Where an answer leads nowhere, a search can begin anew from these.

        :param context: shape (C,)
        :param answer: from which the search starts, which is left out, shape (T, D)
        :return: at most `N_ELSEWHERE`, the nearest first; none where contexts are drawn
        """
        if not self._pinned:
            return []
        shown = cast(Demonstrations, self.demonstrations)
        apart = (shown.contexts - context) / self._context_unit()
        ordered = shown.trajectories[np.argsort((apart**2).sum(axis=1), kind="stable")]
        others = [each for each in ordered.astype(np.float64) if not np.allclose(each, answer)]
        return others[:N_ELSEWHERE]

    # -- the loop ------------------------------------------------------------------------------

    @property
    def generation_size(self) -> int:
        """How many rollouts the generation at hand has."""
        return self.population_size if self._proposals is None else len(self._proposals.searches)

    def _setup_learn(self, *args: Any, **kwargs: Any) -> tuple[int, Any]:  # noqa: ANN401
        self._recall_demonstrations()
        return super()._setup_learn(*args, **kwargs)

    def _begin_generation(self) -> None:
        if self._pinned and self.searches and self._is_elsewhere(self.searches[0].context):
            self.searches = []
        if not self.searches:
            drawn = self._draw_contexts()
            contexts = drawn[: self.n_contexts]
            self._pinned = bool(np.all(np.ptp(drawn, axis=0) <= SAME_CONTEXT))
            if not self._pinned:
                greedy = self.policy.greedy(contexts)
                self._proposals = Proposals(contexts, greedy, np.full(len(contexts), -1))
                return
            self.searches = [ContextSearch(contexts[0], self._new_search(contexts[0]))]
        self._proposals = ask_all(self.searches, self.population_size, self.rng)

    def _is_elsewhere(self, context: NDArray[np.float32]) -> bool:
        """Return whether the environments are in another context than the one that was pinned.

        They are where the model was loaded with another environment, or where one that draws
        contexts drew the same ones when it was first looked at.

        :param context: shape (C,)
        """
        return bool(np.abs(np.asarray(self._last_obs) - context).max() > SAME_CONTEXT)

    def _draw_contexts(self) -> NDArray[np.float32]:
        """Let the environments draw at least two contexts and ``n_contexts``, shape (n, C)."""
        env = cast(VecEnv, self.env)
        drawn = [np.array(self._last_obs, np.float32)]
        while sum(map(len, drawn)) < max(2, self.n_contexts):
            drawn.append(self._reset(env))
        self._last_obs = drawn[-1]
        return np.concatenate(drawn)

    def _wanted_contexts(self, members: slice) -> NDArray[np.float32]:
        return cast(Proposals, self._proposals).contexts[members]

    def _propose(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        return cast(Proposals, self._proposals).trajectories[members]

    def _observe(self, rollouts: Generation) -> None:
        self.policy.elites.update(
            rollouts.contexts, rollouts.trajectories, rollouts.rewards, rollouts.successes
        )

    def _end_generation(self, generation: Generation) -> None:
        check_achieved(generation.achieved, cast(spaces.Box, self.observation_space))
        proposals, self._proposals = cast(Proposals, self._proposals), None
        if proposals.searches[0] < 0:
            self._open_searches(generation)
            return
        searched, improved = self.searches, []
        for index, each in enumerate(searched):
            if each.take(generation[proposals.searches == index]):
                improved.append(each)
            each.n_generations += 1
        solved = improved if self._pinned else self._close_searches()
        self._assimilate(solved)
        self._adapt(searched, solved)
        self.logger.record("train/open_contexts", len(self.searches))
        self.logger.record("train/assimilated", len(self.replay_buffer))
        self.logger.record("train/given_up", self.n_given_up)

    def _open_searches(self, tried: Generation) -> None:
        """Start a search wherever the greedy trajectory is not satisfactory (V)."""
        for row in np.flatnonzero(~self._satisfactory(tried)):
            context = tried.contexts[row]
            each = ContextSearch(context, self._new_search(context), self.n_successes)
            each.take(tried[row : row + 1])
            self.searches.append(each)
        self.logger.record("train/failure_rate", float(np.mean(~tried.successes)))

    def _satisfactory(self, tried: Generation) -> NDArray[np.bool_]:
        """Return which rollouts begin no search, shape (N,)."""
        return tried.successes & (tried.rewards >= thresholds(self.reward_threshold)[0])

    def _close_searches(self) -> list[ContextSearch]:
        """End the searches that are over, and return those of them that have a solution."""
        least_reward = thresholds(self.reward_threshold)[1]
        over = [each.is_over(least_reward, self.max_generations) for each in self.searches]
        ended = [each for each, ends in zip(self.searches, over, strict=True) if ends]
        self.searches = [each for each, ends in zip(self.searches, over, strict=True) if not ends]
        solved = [each for each in ended if each.solution is not None]
        self.n_given_up += len(ended) - len(solved)
        return solved

    def _assimilate(self, solved: list[ContextSearch]) -> None:
        """Add the solutions to the replay buffer (VIII); a pinned context has one at most."""
        if self._pinned and solved:
            self.replay_buffer.drop(solved[0].context, SAME_CONTEXT)
        for each in solved:
            solution = cast(NDArray[np.float32], each.solution)
            self.replay_buffer.add(each.context[None], solution[None], np.array([each.reward]))
