"""`BO`: ACNMP's search around a regression's answer, no network.

The row that ACNMP's network must beat to earn its keep.
"""

from typing import ClassVar, Unpack, cast

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv

from baselines.bayesian.policies import BOPolicy
from sb3_nmp.bayesian.search import CriticSearch, Subspace, any_has_aimed
from sb3_nmp.bayesian.settings import SEARCH_SPACE, ACNMPCritic, ShapedExploration
from sb3_nmp.bayesian.shaped_noise import nearer_scale, shaped_directions
from sb3_nmp.common.adaptive import AdaptiveAlgorithm, AdaptiveArguments
from sb3_nmp.common.context_search import ContextSearch
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.rollouts import Information
from sb3_nmp.common.settings import Rules
from sb3_nmp.common.tuning import SearchSpace


class BO(AdaptiveAlgorithm):
    """Bayesian optimisation around what a regression on the demonstrations answers.

    It is `sb3_nmp.ACNMP` without its network: a context is answered by regression on contexts that
    are solved (``policy_kwargs={"regression": ...}``, see `BOPolicy`), and where that is not
    satisfactory, the same critic searches in the same noise. A solved context joins those that are
    regressed on.

    >>> import benchmark_envs
    >>> shown = Demonstrations.from_task("nmp/Bottles-v0", 3, seed=0)
    >>> model = BO("MlpPolicy", "nmp/Bottles-v0", demonstrations=shown, seed=0).learn(6)
    >>> model.predict(shown.contexts[0], deterministic=True)[0].shape
    (200, 2)

    :param exploration: the noise of the search
    :param critic: settings of the critic, which chooses its rollouts
    """

    policy: BOPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": BOPolicy}
    rehearses: ClassVar[bool] = True
    tunable: ClassVar[SearchSpace] = SEARCH_SPACE

    def __init__(
        self,
        policy: str | type[BOPolicy],
        env: GymEnv | str,
        *,
        population_size: int = 1,
        max_generations: int = 60,
        n_successes: int = 5,
        exploration: ShapedExploration = ShapedExploration(),  # noqa: B008 (frozen)
        critic: ACNMPCritic = ACNMPCritic(),  # noqa: B008 (frozen)
        **shared: Unpack[AdaptiveArguments],
    ) -> None:
        self.exploration, self.critic, self.has_aimed = exploration, critic, False
        super().__init__(
            policy,
            env,
            population_size=population_size,
            max_generations=max_generations,
            n_successes=n_successes,
            **shared,
        )

    @property
    def information(self) -> frozenset[Information]:
        """What the critic sees besides."""
        told = set(super().information)
        if self.critic.terms:
            told.add(Information.TERMS)
        if self.has_aimed:
            told.add(Information.ACHIEVED_CONTEXTS)
        return frozenset(told)

    def _rules(self) -> Rules:
        shaped = type(self.exploration) is ShapedExploration and self.exploration.noise > 0
        rule = "a ShapedExploration with noise > 0: without a network there is nothing else"
        return {"exploration": (shaped, rule), **super()._rules()}

    def _setup_model(self) -> None:
        super()._setup_model()
        if self.demonstrations is not None:
            self._learn(self.demonstrations)

    def _learn(self, known: Demonstrations) -> None:
        self.policy.known.learn(known.contexts, known.trajectories)

    def _new_search(self, context: NDArray[np.float32]) -> CriticSearch:
        shown = cast(Demonstrations, self.demonstrations)
        scale = self.first_scale()
        if self._may_search_nearer:
            scale = nearer_scale(self.exploration, scale, shown)
        along = shaped_directions(self.exploration, scale, shown)
        answer = self.policy.known.answer(context[None])[0]
        space, unit = Subspace(answer, along), self._context_unit()
        elsewhere = self._shown_nearest(context, answer)
        return CriticSearch(space, self.exploration.radius, self.critic, unit, elsewhere)

    def _adapt(self, searched: list[ContextSearch], solved: list[ContextSearch]) -> None:
        self.has_aimed = self.has_aimed or any_has_aimed(searched)
        if solved:
            self._learn(self.training_set())
