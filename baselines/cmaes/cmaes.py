"""`CMAES`: covariance matrix adaptation over a residual of what demonstrations teach (pycma)."""

from dataclasses import replace
from typing import Any, ClassVar, Unpack, cast

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv

from baselines.cmaes.policies import ResidualPolicy
from baselines.cmaes.search import ResidualSearch, ResidualSpace
from sb3_nmp.bayesian.shaped_noise import spread_over_time
from sb3_nmp.common.adaptive import AdaptiveAlgorithm, AdaptiveArguments
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.common.settings import Rules
from sb3_nmp.common.tuning import Choice, Range, SearchSpace
from sb3_nmp.models.cnmp_training import CNMPPretraining


class CMAES(AdaptiveAlgorithm):
    """CMA-ES over smooth deviations from a base trajectory.

    The base is what a CNMP trained on the demonstrations predicts for the context; without
    demonstrations it is the environment's initial trajectory in the first context. With
    ``context_std`` the search also moves the context for which the CNMP is asked, along which its
    trajectories change as a whole: the strongest simple rival of a method that goes on training
    the network. Each context is searched for itself: solutions are remembered, but not learned.

    Hansen and Ostermeier, "Completely derandomized self-adaptation in evolution strategies", 2001;
    the implementation is pycma's.

    >>> import benchmark_envs
    >>> CMAES("MlpPolicy", "nmp/Bottles-v0", seed=0).learn(10).num_timesteps
    10

    :param population_size: rollouts per generation in each context that is searched, at least 3
    :param n_bases: smooth bases of the residual, per dimension (`SmoothNoise`)
    :param context_std: standard deviation of the context's shift at the start, in standard
        deviations of the demonstrations' contexts; 0 leaves it out
    :param shaped: share of the residual's variance that is shaped like the demonstrations, as in
        `sb3_nmp.ShapedExploration`
    :param pd_controller: through which the residual is executed (Eq. 6.3), so that trajectories
        start and end as the base does; None executes it as it is
    :param pretraining: how the CNMP learns the demonstrations
    """

    policy: ResidualPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": ResidualPolicy}
    needs_demonstrations: ClassVar[bool] = False

    tunable: ClassVar[SearchSpace] = {
        "population_size": Choice((5, 8, 12, 20)),
        "n_bases": Range(4, 15, integer=True),
    }
    tunable_with_demonstrations: ClassVar[SearchSpace] = {
        "context_std": Range(0.0, 0.6),
        "shaped": Choice((0.0, 0.5, 0.8, 0.99)),
    }

    def __init__(
        self,
        policy: str | type[ResidualPolicy],
        env: GymEnv | str,
        *,
        population_size: int = 5,
        max_generations: int = 200,
        n_bases: int = 5,
        context_std: float = 0.0,
        shaped: float = 0.0,
        pd_controller: PDController | None = None,
        pretraining: CNMPPretraining = CNMPPretraining(),  # noqa: B008 (frozen)
        **shared: Unpack[AdaptiveArguments],
    ) -> None:
        self.residual = SmoothNoise(n_bases=n_bases)
        self.context_std, self.shaped, self.pretraining = context_std, shaped, pretraining
        self.pd_controller = pd_controller
        self._widths = {"context_std": context_std, "shaped": shaped}
        self._context_step: NDArray[np.float64] | None = None
        self._mixing: NDArray[np.float64] | None = None
        self._has_learned = False
        super().__init__(
            policy, env, population_size=population_size, max_generations=max_generations, **shared
        )

    def _rules(self) -> Rules:
        finite = bool(np.isfinite(self.context_std)) and self.context_std >= 0
        return {
            "population_size": (self.population_size >= 3, ">= 3: CMA-ES ranks its rollouts"),
            "context_std": (finite, "finite and >= 0; usual values are 0 to 0.5"),
            "shaped": (0 <= self.shaped <= 1, "in [0, 1]"),
            **super()._rules(),
        }

    def _setup_model(self) -> None:
        super()._setup_model()
        shown = self.demonstrations
        if self._has_learned:
            return
        if shown is not None:
            self.policy.learn_demonstrations(shown, self.pretraining, self.rng)
            self._has_learned = True
        for name in self._widths:
            if getattr(self, name) > 0 and shown is None:
                raise ConfigurationError(
                    f"{name} is {getattr(self, name)}, but there are no demonstrations, which tell "
                    "how trajectories vary. Give demonstrations=, or 0."
                )
        if self.context_std > 0:
            self._context_step = self.context_std * cast(Demonstrations, shown).contexts.std(axis=0)
        if self.shaped > 0:
            self._mixing = spread_over_time(cast(Demonstrations, shown), self.shaped)

    def _made_with(self) -> dict[str, Any]:
        return super()._made_with() | {"n_bases": self.residual.n_bases} | self._widths

    def _begin_generation(self) -> None:
        if self._n_updates == 0 and not self._has_learned:
            self.policy.set_initial(self.initial_trajectory())
        for each in self.searches:
            cast(ResidualSearch, each.search).base = self.policy.base
        super()._begin_generation()

    def _new_search(self, context: NDArray[np.float32]) -> ResidualSearch:
        noise = replace(self.residual, sigma=self.first_scale())
        where = context.astype(np.float64)
        space = ResidualSpace(noise, where, self._context_step, self._mixing, self.pd_controller)
        return ResidualSearch(
            space, self.policy.base, self.policy.trajectory_shape, self.population_size
        )
