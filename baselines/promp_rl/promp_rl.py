"""`ProMPRL`: movement primitives learned from demonstrations, adapted by reinforcement learning.

The two methods that the thesis compares ACNMP with (5.2.2, references [1] and [2]). Neither has
published code; they follow the thesis's descriptions, and what is ours is said where it stands.
"""

from typing import Any, ClassVar, cast

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv

from baselines.promp_rl.policies import GaussianProcessPolicy, ProMPPolicy, TransferPolicy
from baselines.promp_rl.relevance_search import RelevanceSearch, RelevanceSettings
from baselines.promp_rl.reps_search import RepsSearch, RepsSettings
from baselines.reps.dual import check_epsilon
from baselines.reps.gaussian import FitSettings, FloatArray
from sb3_nmp.common.adaptive import AdaptiveAlgorithm, Case
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError

Sigma = float | tuple[float, ...]

#: Of the environment's ``exploration_scale``. What is known from demonstrations tells by itself
#: where to explore: along the differences between targets.
DEFAULT_SIGMA = 0.1


class ProMPRL(AdaptiveAlgorithm):
    """What both variants share: targets as ProMP weights, and a Gaussian over them for a new one.

    A solved context becomes a known target, with the solution that its search has found.

    :param policy: the policy's class or ``"MlpPolicy"``
    :param env: the environment or its id
    :param demonstrations: of the expert
    :param population_size: rollouts a generation and context that is searched
    :param epsilon: bound on KL(weights of the samples || uniform) in an update, in nats
    :param initial_sigma: standard deviation of each primitive's trajectories, in their unit (root
        mean square over time), one value or one a dimension; None takes a tenth of the
        environment's ``exploration_scale``
    :param min_sigma: floor of the standard deviation during a search, as ``initial_sigma``
    :param n_contexts: see `AdaptiveAlgorithm`, as for all that follow
    :param reward_threshold: of a satisfactory rollout; None asks for success alone
    :param max_generations: after so many a search among drawn contexts is given up
    :param policy_kwargs: further arguments of the policy
    :param stats_window_size: rollouts over which the log averages
    :param tensorboard_log: folder for TensorBoard
    :param verbose: amount of printing
    :param seed: of everything random
    :param device: of the policy
    :param _init_setup_model: whether to build the policy at once
    :raises ConfigurationError: a value outside its range, or a population that does not fit
    :raises InvalidDataError: demonstrations that do not fit the environment
    """

    policy: ProMPPolicy

    def __init__(
        self,
        policy: str | type[ProMPPolicy],
        env: GymEnv | str,
        demonstrations: Demonstrations | None,
        population_size: int,
        epsilon: float,
        initial_sigma: Sigma | None,
        min_sigma: Sigma,
        n_contexts: int | None,
        reward_threshold: float | tuple[float, float] | None,
        max_generations: int,
        policy_kwargs: dict[str, Any] | None,
        stats_window_size: int,
        tensorboard_log: str | None,
        verbose: int,
        seed: int | None,
        device: th.device | str,
        _init_setup_model: bool,
    ) -> None:
        check_epsilon(epsilon)
        if population_size < 2:
            raise ConfigurationError(
                f"population_size is {population_size}; a Gaussian is fitted to it: at least 2."
            )
        self.epsilon, self.initial_sigma, self.min_sigma = epsilon, initial_sigma, min_sigma
        self._has_learned = False
        super().__init__(
            policy=policy,
            env=env,
            demonstrations=demonstrations,
            population_size=population_size,
            n_contexts=n_contexts,
            reward_threshold=reward_threshold,
            max_generations=max_generations,
            learning_rate=0.0,
            policy_kwargs=policy_kwargs,
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            seed=seed,
            device=device,
            _init_setup_model=_init_setup_model,
        )

    def _setup_model(self) -> None:
        super()._setup_model()
        for name in ("initial_sigma", "min_sigma"):
            if getattr(self, name) is not None:
                check_sigma(name, getattr(self, name), self.policy.trajectory_shape[1])
        if not self._has_learned and self.demonstrations is not None:
            self.policy.add_targets(self.demonstrations.contexts, self.demonstrations.trajectories)
            self._has_learned = True

    def _begin_generation(self) -> None:
        if self._n_updates == 0:
            tenth = tuple(DEFAULT_SIGMA * sigma for sigma in self.exploration_scale())
            self.policy.set_spread(tenth if self.initial_sigma is None else self.initial_sigma)
        super()._begin_generation()

    def _floor(self) -> FloatArray:
        """Return ``min_sigma`` as standard deviation of the weights, shape (P,)."""
        n_dimensions = self.policy.trajectory_shape[1]
        std = self.policy.primitive.weight_std(self.min_sigma)
        return np.tile(np.broadcast_to(std, (n_dimensions,)), self.policy.primitive.n_bases)

    def _adapt(self, searched: list[Case], solved: list[Case]) -> None:
        if solved:
            self.policy.add_targets(
                np.stack([case.context for case in solved]),
                np.stack([cast(NDArray[np.float32], case.solution) for case in solved]),
            )

    def check_can_go_on(self) -> None:
        """Accept a model without its demonstrations: it holds what it has learned from them."""


class StarkProMPRL(ProMPRL):
    """Experience reuse with ProMPs: one primitive a target, and REPS for a new one (thesis [1]).

    After Stark, Peters and Rueckert, "Experience reuse with probabilistic movement primitives",
    2019. The search for a new target starts from the Gaussian with the moments of the old targets'
    primitives, mixed by their relevance; relative entropy policy search then bounds the KL
    divergence of every update, so that the movement keeps its shape. Ours are the measure of
    relevance (a Gaussian of the distance between contexts, `TransferPolicy`), the spread of a
    primitive that has only one demonstration (``initial_sigma``), and the settings of REPS, which
    are those of `REPS` here: reused generations, a shrunk covariance with a floor.

    :param policy: the policy's class or ``"MlpPolicy"``
    :param env: the environment or its id
    :param demonstrations: of the expert
    :param population_size: see `ProMPRL`, as for all without a description
    :param epsilon: bound on KL(weights of the samples || uniform) in an update, in nats
    :param initial_sigma: of a primitive's trajectories; None: a tenth of the environment's scale
    :param min_sigma: floor during a search
    :param sample_generations: generations whose samples an update uses
    :param shrinkage: of the weights' correlations: 0 fits a full covariance, 1 a diagonal one
    :param n_contexts: new contexts that are tried at once
    :param reward_threshold: of a satisfactory rollout
    :param max_generations: of a search among drawn contexts
    :param policy_kwargs: further arguments of the policy
    :param stats_window_size: rollouts over which the log averages
    :param tensorboard_log: folder for TensorBoard
    :param verbose: amount of printing
    :param seed: of everything random
    :param device: of the policy
    :param _init_setup_model: whether to build the policy at once
    :raises ConfigurationError: a value outside its range, or a population that does not fit
    :raises InvalidDataError: demonstrations that do not fit the environment
    """

    policy: TransferPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": TransferPolicy}

    def __init__(
        self,
        policy: str | type[TransferPolicy],
        env: GymEnv | str,
        demonstrations: Demonstrations | None = None,
        population_size: int = 20,
        epsilon: float = 1.5,
        initial_sigma: Sigma | None = None,
        min_sigma: Sigma = 0.005,
        sample_generations: int = 3,
        shrinkage: float = 0.3,
        n_contexts: int | None = None,
        reward_threshold: float | tuple[float, float] | None = None,
        max_generations: int = 50,
        policy_kwargs: dict[str, Any] | None = None,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: th.device | str = "cpu",
        _init_setup_model: bool = True,
    ) -> None:
        if sample_generations < 1 or not 0 <= shrinkage <= 1:
            raise ConfigurationError(
                f"sample_generations is {sample_generations} and shrinkage {shrinkage}; they must "
                "be at least 1 and in [0, 1]."
            )
        self.sample_generations, self.shrinkage = sample_generations, shrinkage
        super().__init__(
            policy=policy,
            env=env,
            demonstrations=demonstrations,
            population_size=population_size,
            epsilon=epsilon,
            initial_sigma=initial_sigma,
            min_sigma=min_sigma,
            n_contexts=n_contexts,
            reward_threshold=reward_threshold,
            max_generations=max_generations,
            policy_kwargs=policy_kwargs,
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            seed=seed,
            device=device,
            _init_setup_model=_init_setup_model,
        )

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
    processes' uncertainty and ``initial_sigma``), and how relevances are learned from rollouts.

    :param policy: the policy's class or ``"MlpPolicy"``
    :param env: the environment or its id
    :param demonstrations: of the expert
    :param population_size: see `ProMPRL`, as for all without a description
    :param epsilon: bound on KL(weights of the samples || uniform) in an update, in nats
    :param initial_sigma: added in quadrature to the processes' uncertainty; None: a tenth of the
        environment's scale
    :param min_sigma: floor during a search
    :param n_contexts: new contexts that are tried at once
    :param reward_threshold: of a satisfactory rollout
    :param max_generations: of a search among drawn contexts
    :param policy_kwargs: further arguments of the policy
    :param stats_window_size: rollouts over which the log averages
    :param tensorboard_log: folder for TensorBoard
    :param verbose: amount of printing
    :param seed: of everything random
    :param device: of the policy
    :param _init_setup_model: whether to build the policy at once
    :raises ConfigurationError: a value outside its range, or a population that does not fit
    :raises InvalidDataError: demonstrations that do not fit the environment
    """

    policy: GaussianProcessPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": GaussianProcessPolicy}

    def __init__(
        self,
        policy: str | type[GaussianProcessPolicy],
        env: GymEnv | str,
        demonstrations: Demonstrations | None = None,
        population_size: int = 10,
        epsilon: float = 1.5,
        initial_sigma: Sigma | None = None,
        min_sigma: Sigma = 0.005,
        n_contexts: int | None = None,
        reward_threshold: float | tuple[float, float] | None = None,
        max_generations: int = 50,
        policy_kwargs: dict[str, Any] | None = None,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: th.device | str = "cpu",
        _init_setup_model: bool = True,
    ) -> None:
        super().__init__(
            policy=policy,
            env=env,
            demonstrations=demonstrations,
            population_size=population_size,
            epsilon=epsilon,
            initial_sigma=initial_sigma,
            min_sigma=min_sigma,
            n_contexts=n_contexts,
            reward_threshold=reward_threshold,
            max_generations=max_generations,
            policy_kwargs=policy_kwargs,
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            seed=seed,
            device=device,
            _init_setup_model=_init_setup_model,
        )

    def _new_search(self, context: NDArray[np.float32]) -> RelevanceSearch:
        row = context.astype(np.float64)
        return RelevanceSearch(
            self.policy.primitive,
            self.policy.mean_weights(row[None])[0],
            np.sqrt(np.diag(self.policy.covariance(row))),
            RelevanceSettings(self.epsilon, self._floor()),
        )


def check_sigma(name: str, sigma: Sigma, n_dimensions: int) -> None:
    """Raise unless a standard deviation fits a trajectory.

    :param name: of the argument
    :param sigma: one value or one a dimension
    :param n_dimensions: D
    :raises ConfigurationError: it does not
    """
    values = np.atleast_1d(sigma)
    if values.shape not in ((1,), (n_dimensions,)) or not np.all((values > 0) & (values < np.inf)):
        raise ConfigurationError(
            f"{name} is {sigma}; it must be one finite number > 0, or a tuple of {n_dimensions}: "
            "one a dimension of the trajectory."
        )
