"""ACNMP's policy: the CNMP, and the best trajectories seen."""

import warnings
from typing import Any, cast

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.type_aliases import Schedule

from sb3_nmp.acnmp.distribution import TrajectoryDistribution
from sb3_nmp.common.exceptions import ViaPointWarning
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.policies import ElitePolicy
from sb3_nmp.models.architecture import CNMPArchitecture
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.via_points import TOLERANCE, Conditioning, check_inside

SAMPLE_NOISE = SmoothNoise()


class ACNMPPolicy(ElitePolicy):
    """Answers a context with the best trajectory seen in it, else with the CNMP's mean.

    A sample (``deterministic=False``) is drawn from the CNMP's Gaussian, smooth over time.

    >>> import gymnasium as gym
    >>> import benchmark_envs
    >>> env = gym.make("nmp/Bottles-v0")
    >>> policy = ACNMPPolicy(env.observation_space, env.action_space, lambda progress: 1e-3)
    >>> policy.predict(env.reset(seed=0)[0], deterministic=True)[0].shape
    (200, 2)

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    :param lr_schedule: learning rate of Adam after the pre-training
    :param cnmp: architecture of the network
    """

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        lr_schedule: Schedule,
        cnmp: CNMPArchitecture | None = None,
    ) -> None:
        super().__init__(observation_space, action_space)
        self.architecture = cnmp
        self.cnmp = CNMP(self.context_dim, self.trajectory_shape, cnmp)
        self.optimizer = th.optim.Adam(self.cnmp.parameters(), lr_schedule(1), fused=True)
        bases = SAMPLE_NOISE.bases(self.trajectory_shape[0])
        self.sample_bases = th.as_tensor(bases, dtype=th.float32)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return super()._get_constructor_parameters() | {"cnmp": self.architecture}

    @property
    def answers_by_network(self) -> bool:
        """Whether its greedy answers are PyTorch from contexts to trajectories: they are."""
        return True

    def generalise(self, contexts: th.Tensor, deterministic: bool = True) -> th.Tensor:
        """Return the CNMP's mean, or a sample, for each context, shape (N, T, D).

        :param contexts: shape (N, C)
        :param deterministic: the mean
        """
        condition = self.cnmp.condition(contexts)
        return self._decode(condition, self.cnmp.representation(condition), deterministic)

    def modes(
        self, contexts: NDArray[np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the network's answer in each mode (N, K, T, D), and log p(k | c), shape (N, K).

        K is the number of modes that the demonstrations have, at most ``n_modes`` of
        `CNMPArchitecture`. `predict` answers with the likeliest.

        :param contexts: shape (N, C), or (C,) for one
        :raises ConfigurationError: no modes were looked for
        :raises InvalidDataError: contexts of another shape, or not finite
        """
        cnmp, gate = self.cnmp, self.cnmp.gate
        if gate is None:
            return super().modes(contexts)
        asked = cnmp.times.new_tensor(self._checked_contexts(contexts))
        answers = self._allowed(cnmp.each_mode(asked)[:, gate.is_taken])
        likely = gate.log_shares(cnmp.normalise_contexts(asked))[:, gate.is_taken]
        return answers.cpu().numpy().astype(np.float64), likely.cpu().numpy().astype(np.float64)

    def through(
        self, contexts: th.Tensor, points: tuple[ArrayLike, ArrayLike], deterministic: bool
    ) -> th.Tensor:
        """Return trajectories in the action space that pass via-points, shape (N, T, D).

        The network's answer to points and contexts is moved to the points in the demonstrations'
        ways (`sb3_nmp.models.via_points`). A `ViaPointWarning` tells what the action space forbids.

        :param contexts: shape (N, C)
        :param points: times in [0, 1], shape (O,), and values, shape (O, D)
        :param deterministic: the mean
        :raises InvalidDataError: points of a wrong shape, at times outside [0, 1], outside the
            action space, or that contradict each other
        """
        passing = self._checked(points)
        condition = self.cnmp.condition_near(contexts, passing.points)
        representation = self.cnmp.representation(condition, passing.points)
        allowed = self._allowed(
            passing.moved(self._decode(condition, representation, deterministic))
        )
        self._warn_of_misses(passing.misses(allowed))
        return allowed

    def distribution(
        self, contexts: th.Tensor, points: tuple[ArrayLike, ArrayLike] | None
    ) -> TrajectoryDistribution:
        """Return what the network expects, N rows; see `ACNMP.predict_distribution`.

        :param contexts: shape (N, C)
        :param points: via-points, as in `through`
        :raises InvalidDataError: as `through` does
        """
        cnmp = self.cnmp
        passing = None if points is None else self._checked(points)
        shown = None if passing is None else passing.points
        condition = cnmp.condition_near(contexts, shown)
        representation = cnmp.representation(condition, shown)
        split = cnmp.network.split(representation)
        members = cnmp.network.decode_members(cnmp.times, split, condition)
        means = (members.mean * cnmp.value_std + cnmp.value_mean).view(-1, *members.mean.shape[-3:])
        std = cnmp.network.decode(cnmp.times, representation, condition).stddev * cnmp.value_std
        if passing is not None:
            means, std = passing.moved(means), std * passing.remaining
        mean = self._allowed(means.mean(dim=0))
        if passing is not None:
            self._warn_of_misses(passing.misses(mean))
        found = (part.cpu().numpy().astype(np.float64) for part in (mean, std, means))
        return TrajectoryDistribution(*found)

    def _checked(self, points: tuple[ArrayLike, ArrayLike]) -> Conditioning:
        space, passing = cast(spaces.Box, self.action_space), self.cnmp.through(points)
        check_inside(passing.points, space.low, space.high)
        return passing

    def _allowed(self, trajectories: th.Tensor) -> th.Tensor:
        space = cast(spaces.Box, self.action_space)
        low, high = (trajectories.new_tensor(bound) for bound in (space.low, space.high))
        return trajectories.clamp(low, high)

    def _warn_of_misses(self, misses: th.Tensor) -> None:
        """Warn of points that are missed by more than the tolerance; shape (N, O, D)."""
        lacking = misses.abs().amax(dim=0)
        shares = lacking / self.cnmp.value_range
        point, dimension = divmod(int(shares.argmax()), shares.shape[1])
        if shares[point, dimension] > TOLERANCE:
            n_missed = int((shares > TOLERANCE).any(dim=1).sum())
            warnings.warn(
                f"via-point {point} is missed by {lacking[point, dimension]:.3g} in dimension "
                f"{dimension}, {shares[point, dimension]:.0%} of the demonstrated range: the "
                f"action space allows no more ({n_missed} of {len(shares)} points are missed by "
                f"more than {TOLERANCE:.0%}).",
                ViaPointWarning,
                stacklevel=4,
            )

    def _decode(
        self, condition: th.Tensor, representation: th.Tensor, deterministic: bool
    ) -> th.Tensor:
        network, n_dimensions = self.cnmp.network, self.trajectory_shape[1]
        predicted = network.decode(self.cnmp.times, representation, condition)
        values = predicted.mean
        if not deterministic:
            bases = self.sample_bases.to(values.device)
            weights = th.randn(len(values), bases.shape[1], n_dimensions, device=values.device)
            values = values + predicted.stddev * (bases @ weights)
        return values * self.cnmp.value_std + self.cnmp.value_mean
