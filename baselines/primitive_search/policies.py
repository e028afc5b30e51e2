"""The policy of searches over primitives: the best trajectory seen, else where they start."""

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import Schedule

from baselines.bayesian.policies import BOPolicy
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.regression import Regression

FloatArray = NDArray[np.float64]


class StartPolicy(BOPolicy):
    """Answers a context with the best trajectory seen in it, else with where a search starts.

    That is what a regression on demonstrations answers; without them, one trajectory.

    >>> from gymnasium.spaces import Box
    >>> policy = StartPolicy(Box(-1.0, 1.0, (1,)), Box(0.0, 4.0, (3, 1)))
    >>> policy.predict(np.zeros(1, np.float32))[0].tolist()  # the middle of the space
    [[2.0], [2.0], [2.0]]

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    :param lr_schedule: not used; SB3 passes it to every policy
    :param regression: of demonstrated trajectories on contexts: ``"nearest"``, ``"ridge"``,
        ``"quadratic"`` or ``"gaussian-process"``
    :raises ConfigurationError: there is no such regression
    """

    initial: th.Tensor

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        lr_schedule: Schedule | None = None,
        regression: Regression = "gaussian-process",
    ) -> None:
        super().__init__(observation_space, action_space, lr_schedule, regression)
        middle = (action_space.low.astype(np.float64) + action_space.high) / 2
        self.register_buffer("initial", th.as_tensor(middle))

    @property
    def was_shown(self) -> bool:
        """Whether it knows demonstrations."""
        return len(self.known.trajectories) > 0

    def learn_demonstrations(self, shown: Demonstrations) -> None:
        """Start from a regression on demonstrations from now on.

        :param shown: by an expert
        """
        self.known.learn(shown.contexts, shown.trajectories)

    def set_initial(self, trajectory: NDArray[np.floating]) -> None:
        """Set where searches start in all contexts, as long as nothing was demonstrated.

        :param trajectory: shape (T, D)
        """
        self.initial = self.initial.new_tensor(trajectory)

    def start(self, contexts: NDArray[np.floating]) -> FloatArray:
        """Return the trajectories from which searches start, shape (N, T, D).

        :param contexts: shape (N, C)
        """
        if self.was_shown:
            return self.known.answer(contexts)
        return np.repeat(self.initial.cpu().numpy()[None], len(contexts), axis=0)

    def _learned(self, contexts: th.Tensor) -> th.Tensor | None:
        """Return the regression's answers; without demonstrations there are none."""
        return self.generalise(contexts) if self.was_shown else None

    def generalise(self, contexts: th.Tensor, deterministic: bool = True) -> th.Tensor:
        """Return where a search starts in each context, shape (N, T, D).

        :param contexts: shape (N, C)
        :param deterministic: ignored: the policy is no distribution
        """
        del deterministic
        started = self.start(contexts.cpu().numpy())
        return th.as_tensor(started, dtype=th.float32, device=contexts.device)
