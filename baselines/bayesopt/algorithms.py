"""`TuRBO` and `LogEI`: what BoTorch makes of the weights of a movement primitive."""

from abc import abstractmethod
from typing import ClassVar, Unpack

from stable_baselines3.common.type_aliases import GymEnv

from baselines.bayesopt.boxed import BoxedSearch
from baselines.bayesopt.log_ei import LogEISearch, LogEISettings
from baselines.bayesopt.surrogate import Kernel, check_botorch
from baselines.bayesopt.turbo import TuRBOSearch, TuRBOSettings
from baselines.primitive_search import PrimitiveSearch, PrimitiveSearchArguments, StartPolicy
from sb3_nmp.bayesian.search import Subspace
from sb3_nmp.common.settings import Rules
from sb3_nmp.common.tuning import Choice, Range, SearchSpace


class BayesianArguments(PrimitiveSearchArguments, total=False):
    """Those that `TuRBO` and `LogEI` share; `BayesianPrimitiveSearch` describes them."""

    n_initial: int
    reach: float
    copula: bool
    n_remembered: int
    max_iterations: int


class BayesianPrimitiveSearch(PrimitiveSearch):
    """Bayesian optimisation of a movement primitive's weights, through BoTorch.

    Needs the extra ``botorch``. The process is conditioned on a bounded number of rollouts, so the
    cost of a generation is bounded, and an interrupted search resumes exactly.

    :param n_initial: rollouts of the first, space-filling design; the first of them is the
        trajectory from which the search starts
    :param reach: weights lie within so many standard deviations of the exploration
    :param copula: the process sees normal quantiles of the rewards' ranks instead of rewards
    :param n_remembered: rollouts to which the process is fitted at most: half of them the best, the
        others the newest
    :param max_iterations: of a fit
    """

    tunable: ClassVar[SearchSpace] = {
        "population_size": Choice((2, 5, 10)),
        "n_bases": Range(4, 15, integer=True),
        "reach": Range(1.0, 3.0),
        "copula": Choice((True, False)),
    }

    def __init__(
        self,
        policy: str | type[StartPolicy],
        env: GymEnv | str,
        *,
        n_initial: int = 20,
        reach: float = 2.0,
        copula: bool = True,
        n_remembered: int = 200,
        max_iterations: int = 30,
        **shared: Unpack[PrimitiveSearchArguments],
    ) -> None:
        self.n_initial, self.reach, self.copula = n_initial, reach, copula
        self.n_remembered, self.max_iterations = n_remembered, max_iterations
        super().__init__(policy, env, **shared)

    @abstractmethod
    def _search_in(self, space: Subspace) -> BoxedSearch:
        """Return a search in a space of trajectories.

        :param space: whose origin is where the search starts
        """

    def _rules(self) -> Rules:
        return {
            "n_initial": (self.n_initial >= 2, ">= 2: a process is fitted to them"),
            "reach": (0 < self.reach < float("inf"), "finite and > 0; usual values are 1 to 3"),
            "n_remembered": (self.n_remembered >= 2, ">= 2"),
            "max_iterations": (self.max_iterations >= 1, ">= 1"),
            **super()._rules(),
        }

    def _setup_model(self) -> None:
        check_botorch(type(self).__name__)
        super()._setup_model()


class TuRBO(BayesianPrimitiveSearch):
    """TuRBO-1: Bayesian optimisation in a trust region around the best rollout.

    Thompson samples of a Gaussian process choose among points of the region, which doubles after
    successes in a row, halves after failures in a row, and begins anew where it has become tiny.

    Eriksson, Pearce, Gardner, Turner and Poloczek, "Scalable global optimization via local Bayesian
    optimization", 2019; process and sampling are BoTorch's.

    >>> import benchmark_envs
    >>> TuRBO("MlpPolicy", "nmp/Bottles-v0", seed=0).learn(10).num_timesteps
    10

    :param success_tolerance: generations in a row with a new best rollout until the region doubles
    :param failure_tolerance: generations in a row without one until it halves; None: as many as
        there are weights for each member of the population
    :param n_candidates: among which Thompson samples choose
    """

    def __init__(
        self,
        policy: str | type[StartPolicy],
        env: GymEnv | str,
        *,
        success_tolerance: int = 3,
        failure_tolerance: int | None = None,
        n_candidates: int = 1000,
        **shared: Unpack[BayesianArguments],
    ) -> None:
        self.success_tolerance, self.failure_tolerance = success_tolerance, failure_tolerance
        self.n_candidates = n_candidates
        super().__init__(policy, env, **shared)

    def _rules(self) -> Rules:
        failures = self.failure_tolerance
        return {
            "success_tolerance": (self.success_tolerance >= 1, ">= 1"),
            "failure_tolerance": (failures is None or failures >= 1, ">= 1, or None"),
            "n_candidates": (
                self.n_candidates >= self.population_size,
                f"at least the population of {self.population_size}, which is chosen among them",
            ),
            **super()._rules(),
        }

    def _search_in(self, space: Subspace) -> TuRBOSearch:
        settings = TuRBOSettings(
            self.n_initial,
            self.reach,
            self.success_tolerance,
            self.failure_tolerance,
            self.copula,
            self.n_candidates,
            self.n_remembered,
            self.max_iterations,
        )
        return TuRBOSearch(space, self.population_size, settings)


class LogEI(BayesianPrimitiveSearch):
    """Bayesian optimisation by qLogExpectedImprovement.

    Ament, Daulton, Eriksson, Balandat and Bakshy, "Unexpected improvements to expected improvement
    for Bayesian optimization", 2023; all of it is BoTorch's.

    >>> import benchmark_envs
    >>> LogEI("MlpPolicy", "nmp/Bottles-v0", seed=0).learn(10).num_timesteps
    10

    :param kernel: of the process: ``"rbf"`` is BoTorch's default, whose prior on length scales
        grows with the number of weights; ``"matern"`` is TuRBO's
    :param n_samples: of the process at the points of a generation
    :param n_restarts: of the acquisition function's ascent
    :param n_raw: points from which these begin
    :param n_ascent: iterations of an ascent, which bound its cost
    """

    def __init__(
        self,
        policy: str | type[StartPolicy],
        env: GymEnv | str,
        *,
        kernel: Kernel = "rbf",
        n_samples: int = 32,
        n_restarts: int = 1,
        n_raw: int = 32,
        n_ascent: int = 15,
        **shared: Unpack[BayesianArguments],
    ) -> None:
        self.kernel: Kernel = kernel
        self.n_samples, self.n_restarts = n_samples, n_restarts
        self.n_raw, self.n_ascent = n_raw, n_ascent
        super().__init__(policy, env, **shared)

    def _rules(self) -> Rules:
        return {
            "kernel": (self.kernel in ("rbf", "matern"), "'rbf' or 'matern'"),
            "n_samples": (self.n_samples >= 1, ">= 1"),
            "n_ascent": (self.n_ascent >= 1, ">= 1"),
            "n_restarts": (self.n_raw >= self.n_restarts >= 1, ">= 1 and at most n_raw"),
            **super()._rules(),
        }

    def _search_in(self, space: Subspace) -> LogEISearch:
        settings = LogEISettings(
            self.n_initial,
            self.reach,
            self.kernel,
            self.copula,
            self.n_samples,
            self.n_restarts,
            self.n_raw,
            self.n_ascent,
            self.n_remembered,
            self.max_iterations,
        )
        return LogEISearch(space, settings)
