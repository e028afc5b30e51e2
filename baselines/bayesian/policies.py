"""The twin's policy: the best trajectory seen in a context, else what a regression answers."""

from typing import Any, ClassVar

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import Schedule

from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.growing import GrowingModule
from sb3_nmp.common.policies import ElitePolicy
from sb3_nmp.common.regression import Refitted, Regression

FloatArray = NDArray[np.float64]


class KnownTrajectories(GrowingModule):
    """Contexts and the trajectories that solve them, and the regression on them.

    :param context_dim: C
    :param trajectory_shape: (T, D)
    :param regression: which one
    """

    growing: ClassVar[tuple[str, ...]] = ("contexts", "trajectories")

    contexts: th.Tensor
    trajectories: th.Tensor

    def __init__(
        self,
        context_dim: int,
        trajectory_shape: tuple[int, int],
        regression: Regression,
    ) -> None:
        super().__init__()
        self.regression = Refitted(regression)
        self.register_buffer("contexts", th.empty(0, context_dim, dtype=th.float64))
        self.register_buffer("trajectories", th.empty(0, *trajectory_shape, dtype=th.float64))

    def learn(self, contexts: NDArray[np.floating], trajectories: NDArray[np.floating]) -> None:
        """Take over what is known from now on.

        :param contexts: shape (M, C)
        :param trajectories: shape (M, T, D)
        """
        self.contexts = self.contexts.new_tensor(contexts)
        self.trajectories = self.trajectories.new_tensor(trajectories)

    def answer(self, contexts: NDArray[np.floating]) -> FloatArray:
        """Return the trajectories that answer contexts, shape (N, T, D).

        :param contexts: shape (N, C)
        :raises ConfigurationError: nothing is known yet
        """
        known = self.trajectories
        if len(known) == 0:
            raise ConfigurationError(
                "this policy knows no trajectory; call policy.known.learn(contexts, trajectories), "
                "as BO does with its demonstrations."
            )
        answer = self.regression.on(self.contexts, known)
        return answer(np.asarray(contexts, np.float64)).reshape(-1, *known.shape[1:])


class BOPolicy(ElitePolicy):
    """Answers a context with the best trajectory seen in it, else by regression on known ones.

    >>> from gymnasium.spaces import Box
    >>> policy = BOPolicy(Box(-1.0, 1.0, (1,)), Box(-9.0, 9.0, (3, 1)), regression="nearest")
    >>> policy.known.learn(np.array([[0.0], [1.0]]), np.array([[[1.0]] * 3, [[2.0]] * 3]))
    >>> policy.predict(np.array([0.9], np.float32), deterministic=True)[0].tolist()
    [[2.0], [2.0], [2.0]]

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    :param lr_schedule: not used; SB3 passes it to every policy
    :param regression: of trajectories on contexts: ``"nearest"``, ``"ridge"``, ``"quadratic"`` or
        ``"gaussian-process"``
    :raises ConfigurationError: there is no such regression
    """

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        lr_schedule: Schedule | None = None,
        regression: Regression = "gaussian-process",
    ) -> None:
        super().__init__(observation_space, action_space)
        self.settings: dict[str, Any] = {"regression": regression}
        self.known = KnownTrajectories(self.context_dim, self.trajectory_shape, regression)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return super()._get_constructor_parameters() | self.settings

    def generalise(self, contexts: th.Tensor, deterministic: bool = True) -> th.Tensor:
        """Return the regression's answer for each context, shape (N, T, D).

        :param contexts: shape (N, C)
        :param deterministic: ignored: the policy is no distribution
        :raises ConfigurationError: nothing is known yet
        """
        del deterministic
        answered = self.known.answer(contexts.cpu().numpy())
        return th.as_tensor(answered, dtype=th.float32, device=contexts.device)
