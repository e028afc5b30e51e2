"""The policies of ProMP+RL: movement primitives of old targets, and what they say about new ones.

Shape letters: M old targets, N contexts, C context, K bases, D dimensions, P = K D weights.
"""

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import Schedule

from baselines.primitives import ProMP
from baselines.promp_rl.gaussian_process import WeightProcess, fit_parameters, initial_parameters
from baselines.promp_rl.reps_search import decode, encode
from baselines.promp_rl.transfer import collapse, target_relevance
from baselines.reps.gaussian import FloatArray
from sb3_nmp.common.elites import SAME_CONTEXT
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.growing import GrowingModule
from sb3_nmp.common.policies import ElitePolicy

REFIT_GROWTH = 1.2


class ProMPPolicy(GrowingModule, ElitePolicy):  # pyright: ignore[reportIncompatibleMethodOverride]
    """A Gaussian over the weights of a ProMP for any context, from the targets known so far.

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    :param lr_schedule: not used; SB3 passes it to every policy
    :param n_bases: K, bases per dimension
    """

    growing: ClassVar[tuple[str, ...]] = ("contexts", "weights")

    contexts: th.Tensor
    weights: th.Tensor
    spread: th.Tensor

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        lr_schedule: Schedule | None = None,
        n_bases: int = 20,
    ) -> None:
        super().__init__(observation_space, action_space)
        self.settings: dict[str, Any] = {"n_bases": n_bases}
        n_time_points, n_dimensions = self.trajectory_shape
        self.primitive = ProMP(n_bases, n_time_points)
        self.n_weights = n_bases * n_dimensions
        double = th.float64
        self.register_buffer("contexts", th.empty(0, self.context_dim, dtype=double))
        self.register_buffer("weights", th.empty(0, self.n_weights, dtype=double))
        self.register_buffer("spread", th.zeros(self.n_weights, dtype=double))

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return super()._get_constructor_parameters() | self.settings

    @abstractmethod
    def mean_weights(self, contexts: FloatArray) -> FloatArray:
        """Return the mean of the flattened weights for each context, shape (N, P).

        :param contexts: shape (N, C)
        """

    @abstractmethod
    def covariance(self, context: FloatArray) -> FloatArray:
        """Return the covariance of the flattened weights in a context, shape (P, P).

        :param context: shape (C,)
        """

    def add_targets(
        self, contexts: NDArray[np.floating], trajectories: NDArray[np.floating]
    ) -> None:
        """Learn further targets; one in a context that was learned before replaces it.

        :param contexts: shape (N, C), all different
        :param trajectories: that solve them, shape (N, T, D)
        """
        known, weights, _ = self._known()
        distances = np.abs(known[:, None] - contexts).max(axis=2, initial=0.0)
        keep = np.all(distances > SAME_CONTEXT, axis=1)
        encoded, device = encode(self.primitive, trajectories), self.contexts.device
        self.contexts = th.tensor(
            np.concatenate([known[keep], contexts], dtype=np.float64), device=device
        )
        self.weights = th.tensor(np.concatenate([weights[keep], encoded]), device=device)

    def set_spread(self, sigma: float | tuple[float, ...]) -> None:
        """Set each primitive's standard deviation, of which its one trajectory says nothing.

        :param sigma: of the trajectories, in their unit (root mean square over time), one value or
            one per dimension
        """
        n_dimensions = self.trajectory_shape[1]
        std = np.broadcast_to(self.primitive.weight_std(sigma), (n_dimensions,))
        self.spread = self.spread.new_tensor(np.tile(std, self.primitive.n_bases))

    def _known(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return contexts (M, C), weights (M, P) and spread (P,)."""
        tensors = self.contexts, self.weights, self.spread
        contexts, weights, spread = (tensor.cpu().numpy() for tensor in tensors)
        return contexts, weights, spread

    def generalise(self, contexts: th.Tensor, deterministic: bool = True) -> th.Tensor:
        """Return the mean trajectory, or a sample, for each context, shape (N, T, D).

        :param contexts: shape (N, C)
        :param deterministic: the mean instead of a sample
        """
        rows = contexts.cpu().numpy().astype(np.float64)
        weights = self.mean_weights(rows)
        if not deterministic:
            for row, context in enumerate(rows):
                values, vectors = np.linalg.eigh(self.covariance(context))
                noise = th.randn(self.n_weights, dtype=th.float64).numpy()
                weights[row] += vectors @ (np.sqrt(np.maximum(values, 0.0)) * noise)
        trajectories = decode(self.primitive, weights)
        return th.as_tensor(trajectories, dtype=th.float32, device=contexts.device)


class TransferPolicy(ProMPPolicy):
    """One ProMP per target; for another target, their mixture by relevance, as one Gaussian.

    >>> from gymnasium.spaces import Box
    >>> policy = TransferPolicy(Box(-1.0, 1.0, (1,)), Box(-9.0, 9.0, (50, 1)), n_bases=5)
    >>> policy.add_targets(np.array([[-1.0], [1.0]]), np.array([[[0.0]] * 50, [[2.0]] * 50]))
    >>> policy.predict(np.zeros(1, np.float32), deterministic=True)[0][0].round(2).tolist()
    [1.0]

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    :param lr_schedule: not used; SB3 passes it to every policy
    :param n_bases: K, bases per dimension
    :param width: of the relevance, in units of the targets' distance (`target_relevance`)
    :raises ConfigurationError: the width is not > 0
    """

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        lr_schedule: Schedule | None = None,
        n_bases: int = 20,
        width: float = 2.0,
    ) -> None:
        super().__init__(observation_space, action_space, lr_schedule, n_bases)
        if not (np.isfinite(width) and width > 0):
            raise ConfigurationError(
                f"width is {width}; it must be finite and > 0, in units of the distance between "
                "neighbouring targets. Usual values: 1 to 3."
            )
        self.settings["width"] = width
        self.width = width

    def mean_weights(self, contexts: FloatArray) -> FloatArray:
        """Return the mean weights of the relevant targets' primitives, shape (N, P).

        :param contexts: shape (N, C)
        """
        known, weights, _ = self._known()
        return target_relevance(known, contexts, self.width) @ weights

    def covariance(self, context: FloatArray) -> FloatArray:
        """Return how the relevant primitives differ, and each one's own spread, shape (P, P).

        :param context: shape (C,)
        """
        known, weights, spread = self._known()
        shares = target_relevance(known, context[None], self.width)[0]
        return collapse(weights, np.diag(spread**2), shares)[1]


class GaussianProcessPolicy(ProMPPolicy):
    """One ProMP for all targets, whose weights are Gaussian processes of the context.

    >>> from gymnasium.spaces import Box
    >>> policy = GaussianProcessPolicy(Box(-1.0, 1.0, (1,)), Box(-9.0, 9.0, (50, 1)), n_bases=5)
    >>> contexts = np.linspace(-1.0, 1.0, 5)[:, None]
    >>> policy.add_targets(contexts, np.repeat(2.0 * contexts[:, None], 50, axis=1))
    >>> policy.predict(np.full(1, 0.25, np.float32), deterministic=True)[0][0].round(1).tolist()
    [0.5]

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    :param lr_schedule: not used; SB3 passes it to every policy
    :param n_bases: K, bases per dimension
    """

    kernel_parameters: th.Tensor
    n_fitted: th.Tensor

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        lr_schedule: Schedule | None = None,
        n_bases: int = 20,
    ) -> None:
        super().__init__(observation_space, action_space, lr_schedule, n_bases)
        self.register_buffer(
            "kernel_parameters", th.as_tensor(initial_parameters(self.context_dim))
        )
        self.register_buffer("n_fitted", th.zeros((), dtype=th.int64))
        self._process: WeightProcess | None = None

    def add_targets(
        self, contexts: NDArray[np.floating], trajectories: NDArray[np.floating]
    ) -> None:
        """Learn further targets; fit the kernel again where they have grown by a fifth.

        :param contexts: shape (N, C), all different
        :param trajectories: that solve them, shape (N, T, D)
        """
        super().add_targets(contexts, trajectories)
        self._process = None
        if len(self.contexts) >= REFIT_GROWTH * int(self.n_fitted):
            known, weights, _ = self._known()
            start, n_dimensions = self.kernel_parameters.cpu().numpy(), self.trajectory_shape[1]
            parameters = fit_parameters(known, weights, n_dimensions, start)
            self.kernel_parameters = self.kernel_parameters.new_tensor(parameters)
            self.n_fitted = self.n_fitted.new_tensor(len(self.contexts))

    @property
    def process(self) -> WeightProcess:
        """The Gaussian processes of the known targets."""
        if self._process is None:
            contexts, weights, _ = self._known()
            self._process = WeightProcess(contexts, weights, self.kernel_parameters.cpu().numpy())
        return self._process

    def mean_weights(self, contexts: FloatArray) -> FloatArray:
        """Return the processes' mean, shape (N, P).

        :param contexts: shape (N, C)
        """
        return self.process.mean(contexts)

    def covariance(self, context: FloatArray) -> FloatArray:
        """Return the processes' uncertainty and the primitive's own spread, diagonal (P, P).

        :param context: shape (C,)
        """
        return np.diag(self.process.std(context) ** 2 + self._known()[2] ** 2)

    def _load_from_state_dict(  # pyright: ignore[reportIncompatibleMethodOverride]
        self,
        state_dict: dict[str, Any],
        prefix: str,
        *args: Any,  # noqa: ANN401
    ) -> None:
        self._process = None
        super()._load_from_state_dict(state_dict, prefix, *args)
