"""`REPS`: episodic relative entropy policy search."""

from typing import ClassVar, Unpack, cast

import numpy as np
from stable_baselines3.common.type_aliases import GymEnv, Schedule

from baselines.reps.dual import Solution, epsilon_rule, solve
from baselines.reps.gaussian import FitSettings, FloatArray, LinearGaussian, weighted_fit
from baselines.reps.gaussian_search import GaussianArguments, GaussianSearch
from baselines.reps.policies import GaussianPrimitivePolicy
from baselines.reps.samples import Samples
from sb3_nmp.common.environment import Scale
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import Rules
from sb3_nmp.common.tuning import Choice, Range, SearchSpace


class REPSArguments(GaussianArguments, total=False):
    """Those that `DREPS` takes over from `REPS`, which describes them."""

    learning_rate: float | Schedule
    population_size: int
    epsilon: float
    sample_generations: int
    shrinkage: float
    min_sigma: Scale


class REPS(GaussianSearch):
    """Relative entropy policy search over the weights of a movement primitive.

    Peters, Muelling and Altun, "Relative entropy policy search", 2010; the episodic form is that of
    Deisenroth, Neumann and Peters, "A survey on policy search for robotics", 2013.

    Each generation draws weights from a Gaussian whose mean starts as the fit of the environment's
    initial trajectory. The samples of the last generations are weighted by ``exp(R / eta)``, with
    eta from the dual (`baselines.reps.dual.solve`) such that the KL divergence stays below
    epsilon, and the Gaussian is fitted to them. The mean is linear in the context; the primitive's
    start and goal are those of the first context's initial trajectory.

    REPS is known to converge prematurely: the fit of few samples underestimates the variance.
    Dropping correlations (``shrinkage``) and the floor ``min_sigma`` work against it; how the
    defaults were chosen stands in ``results/experiments/baselines_tuning.md``.

    >>> import benchmark_envs
    >>> REPS("MlpPolicy", "nmp/Bottles-v0", primitive="dmp", seed=0).learn(20).num_timesteps
    20

    :param learning_rate: step from the old mean to the fitted one, in (0, 1], or a schedule of it
    :param epsilon: bound on KL(weights of the samples || uniform), in nats
    :param sample_generations: generations whose samples an update uses
    :param shrinkage: of the weights' correlations: 0 fits a full covariance, 1 a diagonal one
    :param min_sigma: floor of the trajectories' standard deviation (root mean square over time), in
        their unit, one value or one per dimension
    """

    tunable: ClassVar[SearchSpace] = {
        "population_size": Choice((10, 16, 20, 30)),
        "epsilon": Range(0.5, 3.0),
        "n_bases": Range(6, 15, integer=True),
        "sample_generations": Range(1, 4, integer=True),
    }

    def __init__(
        self,
        policy: str | type[GaussianPrimitivePolicy],
        env: GymEnv | str,
        *,
        learning_rate: float | Schedule = 1.0,
        population_size: int = 20,
        epsilon: float = 1.5,
        sample_generations: int = 3,
        shrinkage: float = 1.0,
        min_sigma: Scale = 0.005,
        **shared: Unpack[GaussianArguments],
    ) -> None:
        self.epsilon, self.sample_generations = epsilon, sample_generations
        self.shrinkage, self.min_sigma = shrinkage, min_sigma
        self._samples = list[Samples]()
        super().__init__(
            policy, env, population_size=population_size, learning_rate=learning_rate, **shared
        )

    def _rules(self) -> Rules:
        return {
            "epsilon": epsilon_rule(self.epsilon),
            "population_size": (self.population_size >= 2, ">= 2: a Gaussian is fitted to it"),
            **fit_rules(self.sample_generations, self.shrinkage),
            **super()._rules(),
        }

    def _setup_model(self) -> None:
        super()._setup_model()
        self._check_scale("min_sigma")

    def _end_generation(self, generation: Generation) -> None:
        features = self.policy.features(generation.contexts)
        new = Samples(cast(FloatArray, self._weights), features, generation.rewards)
        self._samples = [*self._samples, new][-self.sample_generations :]
        samples, old = Samples.concatenate(self._samples), self.policy.gaussian
        solution = self._weigh(samples, old)
        n_bases = self.policy.primitive.n_bases
        floor = self.policy.primitive.weight_std(self.min_sigma)
        n_dimensions = self.policy.trajectory_shape[1]
        settings = FitSettings(
            step=self.lr_schedule(self._current_progress_remaining),
            shrinkage=self.shrinkage,
            floor=np.tile(np.broadcast_to(floor, (n_dimensions,)), n_bases),
        )
        gaussian = weighted_fit(samples.weights, samples.features, solution.weights, old, settings)
        self.policy.gaussian = gaussian
        self._log(solution, gaussian.kl(old, features), gaussian.entropy())

    def _weigh(self, samples: Samples, old: LinearGaussian) -> Solution:
        """Return how much each sample counts in the next Gaussian.

        :param samples: of the last generations
        :param old: the Gaussian that drew the newest of them
        """
        return solve(samples.advantages(), self.epsilon)

    def _log(self, solution: Solution, kl: float, entropy: float) -> None:
        self.logger.record("train/eta", solution.eta)
        self.logger.record("train/kl", kl)
        self.logger.record("train/sample_kl", solution.kl)
        self.logger.record("train/entropy", entropy)
        self.logger.record("train/effective_samples", solution.effective_samples)
        self.logger.record("train/sigma", float(self.policy.trajectory_std().mean()))


def fit_rules(sample_generations: int, shrinkage: float) -> Rules:
    """Return the rules of what the fit of a Gaussian is given.

    :param sample_generations: generations whose samples an update uses
    :param shrinkage: of the weights' correlations
    """
    return {
        "sample_generations": (sample_generations >= 1, ">= 1: the current one is needed"),
        "shrinkage": (
            0 <= shrinkage <= 1,
            "in [0, 1]: 0 fits a full covariance, 1 a diagonal one",
        ),
    }
