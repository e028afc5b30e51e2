"""`REPS`: episodic relative entropy policy search (Peters, Muelling and Altun 2010)."""

from typing import Any, ClassVar, Literal, cast

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, Schedule

from baselines.reps.dual import Solution, check_epsilon, solve
from baselines.reps.gaussian import FitSettings, FloatArray, LinearGaussian, weighted_fit
from baselines.reps.policies import GaussianPrimitivePolicy
from baselines.reps.samples import Samples
from sb3_nmp.common.algorithm import Generation, TrajectoryAlgorithm
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.pd_controller import PDController


class REPS(TrajectoryAlgorithm):
    """Relative entropy policy search over the weights of a movement primitive.

    Each generation draws weights from a Gaussian whose mean starts as the fit of the environment's
    initial trajectory. The samples of the last generations are weighted by ``exp(R / eta)``, with
    eta from the dual (`baselines.reps.dual.solve`) such that the KL divergence stays below
    epsilon, and the Gaussian is fitted to them. Contexts: see `GaussianPrimitivePolicy`; the
    primitive's start and goal are those of the first context's initial trajectory.

    REPS is known to converge prematurely: the fit of few samples underestimates the variance.
    Dropping correlations (``shrinkage``) and the floor ``min_sigma`` work against it; how the
    defaults were chosen stands in ``results/experiments/baselines_tuning.md``.

    With ``demonstrations`` the mean starts as the linear regression of the demonstrated weights on
    the context instead; start and goal are then part of the weights, and nothing forces them.

    :param policy: the policy's class or ``"MlpPolicy"``
    :param env: the environment or its id; T x D trajectories as actions, contexts as observations
    :param learning_rate: step from the old mean to the fitted one, in (0, 1], or a schedule of it
    :param population_size: rollouts a generation; a multiple of the number of environments
    :param epsilon: bound on KL(weights of the samples || uniform), in nats
    :param initial_sigma: standard deviation of the first trajectories, in their unit (root mean
        square over time), one value or one a dimension; None takes the environment's
        ``exploration_scale``, as RC-NMP does
    :param primitive: ``"promp"`` or ``"dmp"``
    :param n_bases: of the primitive, a dimension
    :param pd_controller: through which trajectories are executed (Eq. 6.3), so that they start and
        end as the initial trajectory; ``"auto"`` is a `PDController` for a ProMP and none for a
        DMP, which ends at its goal by itself, and with demonstrations
    :param sample_generations: generations whose samples an update uses
    :param shrinkage: of the weights' correlations: 0 fits a full covariance, 1 a diagonal one
    :param min_sigma: floor of the trajectories' standard deviation, as ``initial_sigma``
    :param demonstrations: an expert's trajectories, which a ProMP without controller learns; they
        are not saved with the model
    :param policy_kwargs: further arguments of the policy
    :param stats_window_size: rollouts over which the logged success rate and reward are averaged
    :param tensorboard_log: folder for TensorBoard; None switches it off
    :param verbose: 0 nothing, 1 the log table, 2 debug messages
    :param seed: of Python, NumPy, PyTorch, the environment and this algorithm's generator
    :param device: of the policy
    :param _init_setup_model: whether to build the policy at once
    :raises ConfigurationError: a setting outside its range, or one that does not fit the others
    """

    policy: GaussianPrimitivePolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": GaussianPrimitivePolicy}

    def __init__(
        self,
        policy: str | type[GaussianPrimitivePolicy],
        env: GymEnv | str,
        learning_rate: float | Schedule = 1.0,
        population_size: int = 20,
        epsilon: float = 1.5,
        initial_sigma: float | tuple[float, ...] | None = None,
        primitive: Literal["promp", "dmp"] = "promp",
        n_bases: int = 10,
        pd_controller: PDController | Literal["auto"] | None = "auto",
        sample_generations: int = 3,
        shrinkage: float = 1.0,
        min_sigma: float | tuple[float, ...] = 0.005,
        demonstrations: Demonstrations | None = None,
        policy_kwargs: dict[str, Any] | None = None,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: th.device | str = "cpu",
        _init_setup_model: bool = True,
    ) -> None:
        if pd_controller == "auto":
            free = primitive == "dmp" or demonstrations is not None
            pd_controller = None if free else PDController()
        self.epsilon, self.sample_generations, self.shrinkage = (
            epsilon,
            sample_generations,
            shrinkage,
        )
        self.initial_sigma, self.min_sigma = initial_sigma, min_sigma
        self.demonstrations = demonstrations
        self._demonstrated = demonstrations is not None
        if self._demonstrated and (primitive != "promp" or pd_controller is not None):
            raise ConfigurationError(
                f"demonstrations were given to primitive '{primitive}' with pd_controller "
                f"{pd_controller}: a DMP and a controller force start and goal, which differ "
                "between demonstrations. Give primitive='promp' and pd_controller=None."
            )
        self._check_settings(population_size)
        self._started = False
        self._samples: list[Samples] = []
        self._deviations: FloatArray | None = None
        self._weights: FloatArray | None = None
        super().__init__(
            policy=policy,
            env=env,
            population_size=population_size,
            learning_rate=learning_rate,
            policy_kwargs={
                "primitive": primitive,
                "n_bases": n_bases,
                "pd_controller": pd_controller,
            }
            | (policy_kwargs or {}),
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            seed=seed,
            device=device,
            _init_setup_model=_init_setup_model,
        )

    def _check_settings(self, population_size: int) -> None:
        check_epsilon(self.epsilon)
        if population_size < 2:
            raise ConfigurationError(
                f"population_size is {population_size}; a Gaussian is fitted to it: at least 2."
            )
        if self.sample_generations < 1:
            raise ConfigurationError(
                f"sample_generations is {self.sample_generations}; at least 1, the current one, is "
                "needed."
            )
        if not 0 <= self.shrinkage <= 1:
            raise ConfigurationError(
                f"shrinkage is {self.shrinkage}; it must lie in [0, 1]: 0 fits a full covariance, "
                "1 a diagonal one."
            )

    def _setup_model(self) -> None:
        super()._setup_model()
        n_dimensions = cast(spaces.Box, self.action_space).shape[1]
        for name in ("initial_sigma", "min_sigma"):
            if getattr(self, name) is None:
                continue
            sigma = np.atleast_1d(getattr(self, name))
            if sigma.shape not in ((1,), (n_dimensions,)) or not np.all(
                (sigma > 0) & (sigma < np.inf)
            ):
                raise ConfigurationError(
                    f"{name} is {getattr(self, name)}; it must be one finite number > 0, or a "
                    f"tuple of {n_dimensions}: one a dimension of the trajectory."
                )
        if self.demonstrations is not None:
            shown = self.demonstrations
            shown.check_fits(self.policy.context_dim, self.policy.trajectory_shape)
            self.policy.start_from_demonstrations(shown.contexts, shown.trajectories)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "demonstrations"]

    # -- the search ----------------------------------------------------------------------------

    def _begin_generation(self) -> None:
        if not self._started:
            given = self.initial_sigma
            sigma = self.exploration_scale() if given is None else given
            if self._demonstrated:
                self.policy.explore(sigma)
            else:
                self.policy.start_from(self.initial_trajectory(), sigma)
            self._started = True
        factor = np.linalg.cholesky(self.policy.gaussian.covariance)
        noise = self.rng.standard_normal((self.population_size, len(factor)))
        self._deviations = noise @ factor.T
        self._weights = np.zeros_like(noise)

    def _propose(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        deviations, weights = cast(FloatArray, self._deviations), cast(FloatArray, self._weights)
        proposed: list[FloatArray] = []
        # one by one: a matrix product's last bits depend on how many members it is asked for
        for i, context in zip(range(members.start, members.stop), contexts, strict=True):
            weights[i] = self.policy.mean_weights(context) + deviations[i]
            proposed.append(self.policy.trajectory(weights[i]))
        return np.stack(proposed)

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
