"""`ContextualREPS`: relative entropy policy search whose one distribution spans all contexts."""

from typing import ClassVar, Unpack

from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, Schedule

from baselines.contextual.features import (
    Features,
    choose_features,
    features_rules,
    make_features,
)
from baselines.contextual.policies import ContextualGaussianPolicy
from baselines.contextual.reps_dual import solve
from baselines.reps.dual import Solution
from baselines.reps.gaussian import LinearGaussian
from baselines.reps.gaussian_search import GaussianArguments
from baselines.reps.reps import REPS
from baselines.reps.samples import Samples
from sb3_nmp.common.environment import Scale
from sb3_nmp.common.settings import Rules


class ContextualREPSArguments(GaussianArguments, total=False):
    """Those that are as in `REPS`, which describes them."""

    learning_rate: float | Schedule
    epsilon: float
    sample_generations: int
    shrinkage: float
    min_sigma: Scale


class ContextualREPS(REPS):
    """REPS over contexts: the weights' mean and the value are linear in features of the context.

    The dual is minimised in the temperature and in the value of a context together
    (`baselines.contextual.reps_dual`), so that a sample counts by how much better it is than what
    its context lets expect. All else is as in `REPS`.

    Kupcsik, Deisenroth, Peters, Loh, Vadakkepat and Neumann, "Model-based contextual policy search
    for data-efficient generalization of robot skills", 2017 (without its model).

    >>> import benchmark_envs
    >>> model = ContextualREPS("MlpPolicy", "nmp/Bottles-v0", population_size=20, seed=0)
    >>> model.learn(20).num_timesteps
    20

    :param context_features: of the mean: ``"linear"`` or ``"quadratic"``
    :param value_features: of the value: the same
    """

    policy: ContextualGaussianPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": ContextualGaussianPolicy}

    def __init__(
        self,
        policy: str | type[ContextualGaussianPolicy],
        env: GymEnv | str,
        *,
        population_size: int = 50,
        context_features: Features = "quadratic",
        value_features: Features = "quadratic",
        **shared: Unpack[ContextualREPSArguments],
    ) -> None:
        shared["policy_kwargs"] = chosen = choose_features(context_features, shared)
        self.context_features: Features = chosen["context_features"]
        self.value_features: Features = value_features
        super().__init__(policy, env, population_size=population_size, **shared)

    def _rules(self) -> Rules:
        chosen = features_rules(self.context_features, self.value_features)
        return {**chosen, **super()._rules()}

    def _weigh(self, samples: Samples, old: LinearGaussian) -> Solution:
        scaled = samples.features[:, 1 : 1 + self.policy.context_dim]
        return solve(samples.rewards, make_features(scaled, self.value_features), self.epsilon)
