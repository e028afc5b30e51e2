"""`ProMPRL`: movement primitives learned from demonstrations, adapted by reinforcement learning.

The two methods that the thesis compares ACNMP with (5.2.2, references [1] and [2]). Neither has
published code; they follow the thesis's descriptions, and what is ours is said where it stands.
"""

from typing import ClassVar, Unpack, cast

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv

from baselines.promp_rl.policies import GaussianProcessPolicy, ProMPPolicy, TransferPolicy
from baselines.promp_rl.relevance_search import RelevanceSearch, RelevanceSettings
from baselines.promp_rl.reps_search import RepsSearch, RepsSettings
from baselines.reps.dual import epsilon_rule
from baselines.reps.gaussian import FitSettings, FloatArray
from baselines.reps.reps import fit_rules
from sb3_nmp.common.adaptive import AdaptiveAlgorithm, AdaptiveArguments
from sb3_nmp.common.context_search import ContextSearch
from sb3_nmp.common.environment import Scale
from sb3_nmp.common.rollouts import Information
from sb3_nmp.common.settings import Rules
from sb3_nmp.common.tuning import Choice, Range, SearchSpace


class ProMPRLArguments(AdaptiveArguments, total=False):
    """Those that both variants share; `ProMPRL` describes them."""

    max_generations: int
    epsilon: float
    min_sigma: Scale


class ProMPRL(AdaptiveAlgorithm):
    """What both variants share: targets as ProMP weights, and a Gaussian over them for a new one.

    A solved context becomes a known target, with the solution that its search has found.

    :param epsilon: bound on KL(weights of the samples || uniform) in an update, in nats
    :param min_sigma: floor of the trajectories' standard deviation (root mean square over time)
        during a search, in their unit, one value or one per dimension
    :param exploration_scale: standard deviation of each primitive's trajectories (root mean square
        over time), in their unit, one value or one per dimension; None takes a tenth of the
        environment's ``exploration_scale``. What is known from demonstrations tells by itself where
        to explore: along the differences between targets
    """

    policy: ProMPPolicy
    default_exploration: ClassVar[float] = 0.1
    tunable: ClassVar[SearchSpace] = {
        "population_size": Choice((4, 6, 9, 14, 20)),
        "epsilon": Range(0.5, 3.0),
        "policy_kwargs.n_bases": Range(8, 30, integer=True),
    }

    def __init__(
        self,
        policy: str | type[ProMPPolicy],
        env: GymEnv | str,
        *,
        population_size: int = 10,
        max_generations: int = 50,
        epsilon: float = 1.5,
        min_sigma: Scale = 0.005,
        **shared: Unpack[AdaptiveArguments],
    ) -> None:
        self.epsilon, self.min_sigma = epsilon, min_sigma
        self._has_learned = False
        super().__init__(
            policy, env, population_size=population_size, max_generations=max_generations, **shared
        )

    def _rules(self) -> Rules:
        return {
            "epsilon": epsilon_rule(self.epsilon),
            "population_size": (self.population_size >= 2, ">= 2: a Gaussian is fitted to it"),
            **super()._rules(),
        }

    def _setup_model(self) -> None:
        super()._setup_model()
        self._check_scale("min_sigma")
        if not self._has_learned and self.demonstrations is not None:
            self.policy.add_targets(self.demonstrations.contexts, self.demonstrations.trajectories)
            self._has_learned = True

    def _begin_generation(self) -> None:
        if self._n_updates == 0:
            self.policy.set_spread(self.first_scale())
        super()._begin_generation()

    def _floor(self) -> FloatArray:
        """Return ``min_sigma`` as standard deviation of the weights, shape (P,)."""
        n_dimensions = self.policy.trajectory_shape[1]
        std = self.policy.primitive.weight_std(self.min_sigma)
        return np.tile(np.broadcast_to(std, (n_dimensions,)), self.policy.primitive.n_bases)

    def _adapt(self, searched: list[ContextSearch], solved: list[ContextSearch]) -> None:
        if solved:
            self.policy.add_targets(
                np.stack([each.context for each in solved]),
                np.stack([cast(NDArray[np.float32], each.solution) for each in solved]),
            )


class StarkProMPRL(ProMPRL):
    """Experience reuse with ProMPs: one primitive per target, and REPS for a new one (thesis [1]).

    After Stark, Peters and Rueckert, "Experience reuse with probabilistic movement primitives",
    2019. The search for a new target starts from the Gaussian with the moments of the old targets'
    primitives, mixed by their relevance; relative entropy policy search then bounds the KL
    divergence of every update, so that the movement keeps its shape. Ours are the measure of
    relevance (a Gaussian of the distance between contexts, `TransferPolicy`), the spread of a
    primitive that has only one demonstration (``exploration_scale``), and the settings of REPS,
    which are those of `REPS` here: reused generations, a shrunk covariance with a floor.

    >>> import benchmark_envs, sb3_nmp
    >>> shown = sb3_nmp.Demonstrations.from_task("nmp/Bottles-v0", 3, seed=0)
    >>> model = StarkProMPRL("MlpPolicy", "nmp/Bottles-v0", demonstrations=shown, seed=0)
    >>> model.learn(20).num_timesteps
    20

    :param sample_generations: generations whose samples an update uses
    :param shrinkage: of the weights' correlations: 0 fits a full covariance, 1 a diagonal one
    """

    policy: TransferPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": TransferPolicy}

    def __init__(
        self,
        policy: str | type[TransferPolicy],
        env: GymEnv | str,
        *,
        population_size: int = 20,
        sample_generations: int = 3,
        shrinkage: float = 0.3,
        **shared: Unpack[ProMPRLArguments],
    ) -> None:
        self.sample_generations, self.shrinkage = sample_generations, shrinkage
        super().__init__(policy, env, population_size=population_size, **shared)

    def _rules(self) -> Rules:
        fit = fit_rules(self.sample_generations, self.shrinkage)
        return {**fit, **super()._rules()}

    def _new_search(self, context: NDArray[np.float32]) -> RepsSearch:
        row = context.astype(np.float64)
        fit = FitSettings(step=1.0, shrinkage=self.shrinkage, floor=self._floor())
        return RepsSearch(
            self.policy.primitive,
            self.policy.mean_weights(row[None])[0],
            self.policy.covariance(row),
            RepsSettings(self.epsilon, self.sample_generations, fit),
        )


class EwertonProMPRL(ProMPRL):
    """One ProMP, Gaussian processes, and relevance-weighted policy optimisation (thesis [2]).

    After Ewerton et al., "Learning trajectory distributions for assisted teleoperation and path
    planning", 2019. Gaussian processes predict the weights from the context; where the prediction
    fails, `RelevanceSearch` improves one term of the reward after the other (the reward itself
    where the environment tells no terms), and solved contexts are added to the processes' data.
    Ours are the temperature of an update, which follows from ``epsilon``, the first variances (the
    processes' uncertainty and ``exploration_scale``, added in quadrature), and how relevances are
    learned from rollouts.

    >>> import benchmark_envs, sb3_nmp
    >>> shown = sb3_nmp.Demonstrations.from_task("nmp/Bottles-v0", 3, seed=0)
    >>> model = EwertonProMPRL("MlpPolicy", "nmp/Bottles-v0", demonstrations=shown, seed=0)
    >>> model.learn(10).num_timesteps
    10
    """

    policy: GaussianProcessPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": GaussianProcessPolicy}

    @property
    def information(self) -> frozenset[Information]:
        """The reward's terms besides: each is an objective."""
        return super().information | {Information.TERMS}

    def _new_search(self, context: NDArray[np.float32]) -> RelevanceSearch:
        row = context.astype(np.float64)
        return RelevanceSearch(
            self.policy.primitive,
            self.policy.mean_weights(row[None])[0],
            np.sqrt(np.diag(self.policy.covariance(row))),
            RelevanceSettings(self.epsilon, self._floor()),
        )
