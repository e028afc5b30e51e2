"""`ContextualCMAES`: covariance matrix adaptation whose one distribution spans all contexts."""

from typing import ClassVar, Unpack, cast

import numpy as np
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv

from baselines.contextual.adaptation import Constants, Strategy, Tried, adapt
from baselines.contextual.features import (
    Features,
    FloatArray,
    choose_features,
    features_rules,
    make_features,
)
from baselines.contextual.policies import ContextualGaussianPolicy
from baselines.reps.gaussian import LinearGaussian
from baselines.reps.gaussian_search import GaussianArguments, GaussianSearch
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import Rules
from sb3_nmp.common.tuning import Choice, Range, SearchSpace


class ContextualCMAES(GaussianSearch):
    """CMA-ES over contexts: the mean of the weights is linear in features of the context.

    The samples of a generation are ranked by their advantage over what a regression on the context
    lets expect; mean, covariance and step size are adapted as by CMA-ES (`adaptation.adapt`).

    Abdolmaleki, Price, Lau, Reis and Neumann, "Contextual covariance matrix adaptation evolutionary
    strategies", 2017. The ridge pulls the mean's change to 0, not the mean itself.

    >>> import benchmark_envs
    >>> ContextualCMAES("MlpPolicy", "nmp/Bottles-v0", seed=0).learn(50).num_timesteps
    50

    :param population_size: rollouts per generation, at least 4
    :param context_features: of the mean: ``"linear"`` or ``"quadratic"``
    :param value_features: of the value: the same
    :param ridge: of the mean's regression, whose features are of the order of 1
    """

    policy: ContextualGaussianPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": ContextualGaussianPolicy}

    tunable: ClassVar[SearchSpace] = {
        "population_size": Choice((10, 20, 50, 100)),
        "n_bases": Range(6, 15, integer=True),
        "ridge": Range(1e-4, 0.1, log=True),
    }

    def __init__(
        self,
        policy: str | type[ContextualGaussianPolicy],
        env: GymEnv | str,
        *,
        population_size: int = 50,
        context_features: Features = "quadratic",
        value_features: Features = "quadratic",
        ridge: float = 1e-2,
        **shared: Unpack[GaussianArguments],
    ) -> None:
        shared["policy_kwargs"] = chosen = choose_features(context_features, shared)
        self.context_features: Features = chosen["context_features"]
        self.value_features: Features = value_features
        self.ridge = ridge
        self._strategy: Strategy | None = None
        self._scale: FloatArray | None = None
        super().__init__(policy, env, population_size=population_size, **shared)

    def _rules(self) -> Rules:
        return {
            "population_size": (self.population_size >= 4, ">= 4: half of it is selected"),
            "ridge": (0 < self.ridge < np.inf, "finite and > 0; usual values are 1e-4 to 0.1"),
            **features_rules(self.context_features, self.value_features),
            **super()._rules(),
        }

    def _begin_generation(self) -> None:
        super()._begin_generation()
        if self._strategy is None:
            begun = self.policy.gaussian
            self._scale = np.sqrt(np.diag(begun.covariance))
            self._strategy = Strategy(begun.coefficients / self._scale, np.eye(len(self._scale)))

    def _end_generation(self, generation: Generation) -> None:
        scale, old = cast(FloatArray, self._scale), cast(Strategy, self._strategy)
        scaled = self.policy.scaled(generation.contexts)
        tried = Tried(
            cast(FloatArray, self._weights) / scale,
            make_features(scaled, self.context_features),
            make_features(scaled, self.value_features),
            generation.rewards,
        )
        constants = Constants(len(generation), len(scale), self.policy.context_dim)
        new = self._strategy = adapt(old, tried, constants, self.ridge)
        covariance = new.step**2 * new.covariance * np.outer(scale, scale)
        self.policy.gaussian = LinearGaussian(new.coefficients * scale, covariance)
        self.logger.record("train/step", new.step)
        self.logger.record("train/entropy", self.policy.gaussian.entropy())
        self.logger.record("train/sigma", float(self.policy.trajectory_std().mean()))
