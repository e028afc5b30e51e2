"""The policy of REPS and DREPS: a Gaussian over the weights of a movement primitive."""

from typing import Any, Literal, cast

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule

from baselines.primitives import DMP, PDFiltered, Primitive, ProMP
from baselines.reps.gaussian import FloatArray, LinearGaussian, weighted_regression
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.common.policies import TrajectoryPolicy


def make_primitive(
    name: str, n_bases: int, n_time_points: int, pd_controller: PDController | None
) -> Primitive:
    """Build a movement primitive.

    :param name: ``"promp"`` or ``"dmp"``
    :param n_bases: K, bases per dimension
    :param n_time_points: T
    :param pd_controller: through which a ProMP is executed; None executes it as it is
    :raises ConfigurationError: no such primitive, or a controller for a DMP
    """
    if name == "promp":
        promp = ProMP(n_bases, n_time_points)
        return promp if pd_controller is None else PDFiltered(promp, pd_controller)
    if name != "dmp":
        raise ConfigurationError(f"no primitive '{name}'; there are 'promp' and 'dmp'.")
    if pd_controller is not None:
        raise ConfigurationError(
            f"pd_controller is {pd_controller}, but a DMP ends at its goal by itself: give None, "
            "or primitive='promp'."
        )
    return DMP(n_bases, n_time_points)


class GaussianPrimitivePolicy(TrajectoryPolicy):
    """Weights w ~ N(mean(context), covariance) of a movement primitive; greedy is the mean.

    The mean is linear in (1, context), with the context scaled to [-1, 1] by its space.

    >>> import gymnasium as gym
    >>> import benchmark_envs
    >>> env = gym.make("nmp/Bottles-v0")
    >>> policy = GaussianPrimitivePolicy(env.observation_space, env.action_space, n_bases=8)
    >>> policy.predict(env.reset(seed=0)[0], deterministic=True)[0].shape
    (200, 2)

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    :param lr_schedule: not used here; SB3 passes it to every policy
    :param primitive: ``"promp"`` or ``"dmp"``
    :param n_bases: K, bases per dimension
    :param pd_controller: through which a ProMP is executed; None executes it as it is
    :raises ConfigurationError: the primitive does not exist or does not fit the controller
    """

    coefficients: th.Tensor
    covariance: th.Tensor
    start: th.Tensor
    goal: th.Tensor
    context_middle: th.Tensor
    context_half_range: th.Tensor

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        lr_schedule: Schedule | None = None,
        primitive: Literal["promp", "dmp"] = "promp",
        n_bases: int = 10,
        pd_controller: PDController | None = None,
    ) -> None:
        super().__init__(observation_space, action_space)
        self.settings = {
            "primitive": primitive,
            "n_bases": n_bases,
            "pd_controller": pd_controller,
        }
        n_time_points, n_dimensions = self.trajectory_shape
        self.primitive = make_primitive(primitive, n_bases, n_time_points, pd_controller)
        n_parameters = n_bases * n_dimensions
        self.register_buffer(
            "coefficients", th.zeros(1 + self.context_dim, n_parameters, dtype=th.float64)
        )
        self.register_buffer("covariance", th.eye(n_parameters, dtype=th.float64))
        self.register_buffer("start", th.zeros(n_dimensions, dtype=th.float64))
        self.register_buffer("goal", th.zeros(n_dimensions, dtype=th.float64))
        low, high = observation_space.low.astype(np.float64), observation_space.high
        bounded = np.isfinite(low) & np.isfinite(high) & (high > low)
        middle, half = (
            np.where(bounded, (low + high) / 2, 0),
            np.where(bounded, (high - low) / 2, 1),
        )
        self.register_buffer("context_middle", th.as_tensor(middle))
        self.register_buffer("context_half_range", th.as_tensor(half))
        centre = (action_space.low.astype(np.float64) + action_space.high) / 2
        self.start_from(np.where(np.isfinite(centre), centre, 0.0), 1.0)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {
            "observation_space": self.observation_space,
            "action_space": self.action_space,
            **self.settings,
        }

    @property
    def gaussian(self) -> LinearGaussian:
        """The distribution of the flattened weights (entry (k, d) at k * D + d)."""
        return LinearGaussian(self.coefficients.cpu().numpy(), self.covariance.cpu().numpy())

    @gaussian.setter
    def gaussian(self, gaussian: LinearGaussian) -> None:
        self.coefficients = th.tensor(gaussian.coefficients, device=self.coefficients.device)
        self.covariance = th.tensor(gaussian.covariance, device=self.covariance.device)

    def start_from(
        self, trajectory: NDArray[np.floating], sigma: float | tuple[float, ...]
    ) -> None:
        """Set the Gaussian with which a search starts.

        :param trajectory: whose fit becomes the mean, shape (T, D); its first and last point
            become the primitive's start and goal
        :param sigma: standard deviation of the trajectories, in their unit (root mean square over
            time), one value or one per dimension
        """
        line = np.asarray(trajectory, np.float64)
        device = self.start.device
        self.start, self.goal = (
            th.tensor(line[0], device=device),
            th.tensor(line[-1], device=device),
        )
        coefficients = np.zeros(tuple(self.coefficients.shape))
        coefficients[0] = self.primitive.fit(line).ravel()
        self.gaussian = LinearGaussian(coefficients, self.gaussian.covariance)
        self.explore(sigma)

    def start_from_demonstrations(
        self, contexts: NDArray[np.floating], trajectories: NDArray[np.floating]
    ) -> None:
        """Make the mean the linear regression of demonstrated weights on their contexts.

        The slopes are pulled to 0 by a small ridge (`weighted_regression`).

        :param contexts: shape (N, C)
        :param trajectories: shape (N, T, D)
        """
        weights = np.stack([self.primitive.fit(trajectory).ravel() for trajectory in trajectories])
        equal = np.full(len(weights), 1 / len(weights))
        coefficients = weighted_regression(weights, self.features(contexts), equal)
        self.gaussian = LinearGaussian(coefficients, self.gaussian.covariance)

    def explore(self, sigma: float | tuple[float, ...]) -> None:
        """Set the covariance with which a search starts; the mean stays.

        :param sigma: standard deviation of the trajectories, in their unit (root mean square over
            time), one value or one per dimension
        """
        n_dimensions = self.trajectory_shape[1]
        std = np.broadcast_to(self.primitive.weight_std(sigma), (n_dimensions,))
        covariance = np.diag(np.tile(std**2, self.primitive.n_bases))
        self.gaussian = LinearGaussian(self.gaussian.coefficients, covariance)

    def features(self, contexts: NDArray[np.floating]) -> FloatArray:
        """Return (1, context scaled to [-1, 1]), shape (N, 1 + C).

        :param contexts: shape (N, C)
        """
        middle, half = self.context_middle.cpu().numpy(), self.context_half_range.cpu().numpy()
        scaled = (np.asarray(contexts, np.float64) - middle) / half
        return np.concatenate([np.ones((len(scaled), 1)), scaled], axis=1)

    def mean_weights(self, context: NDArray[np.floating]) -> FloatArray:
        """Return the mean of the flattened weights, shape (P,).

        :param context: shape (C,)
        """
        return self.features(context[None])[0] @ self.coefficients.cpu().numpy()

    def trajectory(self, weights: FloatArray) -> FloatArray:
        """Return the trajectory of flattened weights, shape (T, D).

        :param weights: shape (P,)
        """
        start, goal = self.start.cpu().numpy(), self.goal.cpu().numpy()
        shaped = weights.reshape(1, self.primitive.n_bases, -1)
        return self.primitive.trajectories(shaped, start, goal)[0]

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> th.Tensor:
        observation = cast(th.Tensor, observation)
        contexts = observation.cpu().numpy()
        weights = np.stack([self.mean_weights(context) for context in contexts])
        if not deterministic:
            noise = th.randn(weights.shape, dtype=th.float64)
            weights = weights + (noise @ th.linalg.cholesky(self.covariance.cpu()).T).numpy()
        trajectories = np.stack([self.trajectory(w) for w in weights])
        return th.as_tensor(trajectories, dtype=th.float32, device=observation.device)

    def _learned(self, contexts: th.Tensor) -> th.Tensor | None:
        return self._predict(contexts, deterministic=True)

    def trajectory_std(self) -> FloatArray:
        """Return the trajectories' standard deviation, root mean square over time, shape (D,)."""
        bases = self.primitive.response().weights
        n_dimensions = len(self.start)
        covariance = self.covariance.cpu().numpy()
        blocks = [covariance[d::n_dimensions, d::n_dimensions] for d in range(n_dimensions)]
        variances = [np.mean(np.sum((bases @ block) * bases, axis=1)) for block in blocks]
        return np.sqrt(cast(FloatArray, np.asarray(variances)))
