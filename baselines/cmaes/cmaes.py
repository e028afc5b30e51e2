"""`CMAES`: covariance matrix adaptation over a residual of what demonstrations teach (pycma)."""

from typing import Any, ClassVar, cast

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv

from baselines.cmaes.policies import ResidualPolicy
from baselines.cmaes.search import ResidualSearch, ResidualSpace
from sb3_nmp.common.adaptive import AdaptiveAlgorithm, Case
from sb3_nmp.common.cnmp import PretrainingSettings
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.noise import SmoothNoise


class CMAES(AdaptiveAlgorithm):
    """CMA-ES over smooth deviations from a base trajectory.

    The base is what a CNMP trained on the demonstrations predicts for the context; without
    demonstrations it is the environment's initial trajectory in the first context. With
    ``context_std`` the search also moves the context for which the CNMP is asked, along which its
    trajectories change as a whole: the strongest simple rival of a method that goes on training
    the network. Each context is searched for itself: solutions are remembered, but not learned.

    Hansen and Ostermeier, "Completely derandomized self-adaptation in evolution strategies", 2001;
    the implementation is pycma's.

    :param policy: the policy's class or ``"MlpPolicy"``
    :param env: the environment or its id
    :param demonstrations: of the expert; None: the search starts from the initial trajectory
    :param population_size: rollouts a generation and context that is searched, at least 3
    :param n_bases: smooth bases of the residual, a dimension (`SmoothNoise`)
    :param sigma: standard deviation of the residual at the start, in the trajectory's unit, one
        value or one a dimension; None takes the environment's ``exploration_scale``
    :param context_std: standard deviation of the context's shift at the start, in standard
        deviations of the demonstrations' contexts; 0 leaves it out
    :param pretraining: how the CNMP learns the demonstrations
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

    policy: ResidualPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": ResidualPolicy}
    needs_demonstrations: ClassVar[bool] = False

    def __init__(
        self,
        policy: str | type[ResidualPolicy],
        env: GymEnv | str,
        demonstrations: Demonstrations | None = None,
        population_size: int = 5,
        n_bases: int = 5,
        sigma: float | tuple[float, ...] | None = None,
        context_std: float = 0.0,
        pretraining: PretrainingSettings = PretrainingSettings(),  # noqa: B008 (frozen)
        n_contexts: int | None = None,
        reward_threshold: float | tuple[float, float] | None = None,
        max_generations: int = 200,
        policy_kwargs: dict[str, Any] | None = None,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: th.device | str = "cpu",
        _init_setup_model: bool = True,
    ) -> None:
        if population_size < 3:
            raise ConfigurationError(
                f"population_size is {population_size}; CMA-ES ranks its rollouts and needs at "
                "least 3."
            )
        if not (np.isfinite(context_std) and context_std >= 0):
            raise ConfigurationError(
                f"context_std is {context_std}; it must be finite and >= 0. Usual values: 0 to 0.5."
            )
        self.residual = SmoothNoise(sigma, n_bases)
        self.context_std, self.pretraining = context_std, pretraining
        self._context_step: NDArray[np.float64] | None = None
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
        shown, n_dimensions = self.demonstrations, self.policy.trajectory_shape[1]
        sigma = 1.0 if self.residual.sigma is None else self.residual.sigma
        if np.shape(sigma) not in ((), (n_dimensions,)):
            raise ConfigurationError(
                f"sigma is {self.residual.sigma}; it must be one value, or a tuple "
                f"of {n_dimensions}: one a dimension of the trajectory."
            )
        if self._has_learned:
            return
        if shown is not None:
            self.policy.learn_demonstrations(shown, self.pretraining, self.rng)
            self._has_learned = True
        if self.context_std > 0:
            if shown is None:
                raise ConfigurationError(
                    f"context_std is {self.context_std}, but there are no demonstrations: without "
                    "them no trajectory depends on the context. Give demonstrations=, or 0."
                )
            self._context_step = self.context_std * shown.contexts.std(axis=0)

    def _begin_generation(self) -> None:
        if self._n_updates == 0 and not self._has_learned:
            self.policy.set_initial(self.initial_trajectory())
        for case in self.cases:
            cast(ResidualSearch, case.search).base = self.policy.base
        super()._begin_generation()

    def _new_search(self, context: NDArray[np.float32]) -> ResidualSearch:
        sigma = self.residual.sigma
        noise = SmoothNoise(
            self.exploration_scale() if sigma is None else sigma,
            self.residual.n_bases,
            self.residual.width,
        )
        space = ResidualSpace(noise, context.astype(np.float64), self._context_step)
        return ResidualSearch(
            space, self.policy.base, self.policy.trajectory_shape, self.population_size
        )

    def _adapt(self, searched: list[Case], solved: list[Case]) -> None:
        """Learn nothing: the solutions are remembered by the policy."""

    def check_can_go_on(self) -> None:
        """Accept a model without its demonstrations: it holds what it has learned from them."""
