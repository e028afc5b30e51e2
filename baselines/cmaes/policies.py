"""The policy of CMA-ES: the best trajectory seen in a context, else the base trajectory."""

from typing import Any

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import Schedule

from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.policies import ElitePolicy
from sb3_nmp.models.architecture import CNMPArchitecture
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.cnmp_training import CNMPPretraining, pretrain

FloatArray = NDArray[np.float64]


class ResidualPolicy(ElitePolicy):
    """A CNMP that was trained on demonstrations; without them, one trajectory for all contexts.

    >>> import gymnasium as gym
    >>> import benchmark_envs
    >>> env = gym.make("nmp/Bottles-v0")
    >>> policy = ResidualPolicy(env.observation_space, env.action_space)
    >>> policy.set_initial(env.unwrapped.task.initial_trajectory(env.reset(seed=0)[0]))
    >>> policy.predict(env.reset(seed=0)[0], deterministic=True)[0].shape
    (200, 2)

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    :param lr_schedule: not used; SB3 passes it to every policy
    :param cnmp: architecture of the network; by default that of its committed measurements
    """

    initial: th.Tensor
    is_trained: th.Tensor

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        lr_schedule: Schedule | None = None,
        cnmp: CNMPArchitecture = CNMPArchitecture.preset("latent"),  # noqa: B008 (frozen)
    ) -> None:
        super().__init__(observation_space, action_space)
        self.settings: dict[str, Any] = {"cnmp": cnmp}
        self.cnmp = CNMP(self.context_dim, self.trajectory_shape, cnmp)
        middle = (action_space.low.astype(np.float64) + action_space.high) / 2
        self.register_buffer("initial", th.as_tensor(middle))
        self.register_buffer("is_trained", th.zeros((), dtype=th.bool))

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return super()._get_constructor_parameters() | self.settings

    def learn_demonstrations(
        self,
        demonstrations: Demonstrations,
        settings: CNMPPretraining,
        rng: np.random.Generator,
    ) -> None:
        """Train the CNMP, which gives the base trajectories from now on.

        :param demonstrations: of the expert
        :param settings: of the training
        :param rng: draws the batches
        """
        pretrain(demonstrations, settings, rng, self.cnmp)
        self.is_trained = th.ones_like(self.is_trained)

    def set_initial(self, trajectory: NDArray[np.floating]) -> None:
        """Set the base trajectory that stands for all contexts where there is no CNMP.

        :param trajectory: shape (T, D)
        """
        self.initial = self.initial.new_tensor(trajectory)

    def base(self, contexts: FloatArray) -> FloatArray:
        """Return the base trajectories, shape (N, T, D).

        :param contexts: shape (N, C)
        """
        if self.is_trained:
            return self.cnmp.trajectories(contexts)
        return np.repeat(self.initial.cpu().numpy()[None], len(contexts), axis=0)

    def _learned(self, contexts: th.Tensor) -> th.Tensor | None:
        """Return the CNMP's answers, which no search changes; without a CNMP there are none."""
        return self.generalise(contexts) if self.is_trained else None

    def generalise(self, contexts: th.Tensor, deterministic: bool = True) -> th.Tensor:
        """Return the base trajectory for each context, shape (N, T, D).

        :param contexts: shape (N, C)
        :param deterministic: ignored: the policy is no distribution
        """
        del deterministic
        return th.as_tensor(
            self.base(contexts.cpu().numpy()), dtype=th.float32, device=contexts.device
        )
