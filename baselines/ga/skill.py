"""The twins of RC-NMP's skill over contexts: the network taken out, all else equal.

Weights of what was right (successes, or what was achieved) are regressed on the context by the
nearest neighbour, a ridge (linear or quadratic) or Gaussian processes. Shape letters: N contexts, M
right rollouts, C context, P weights.
"""

from typing import ClassVar

import numpy as np
import torch as th
from numpy.typing import NDArray

from sb3_nmp.common.contextual import Experience
from sb3_nmp.common.growing import GrowingModule
from sb3_nmp.common.regression import Refitted, Regression
from sb3_nmp.models.skill_space import SkillSpace

FloatArray = NDArray[np.float64]


class RegressionSkill(GrowingModule):
    """Answers contexts by regression on what was right.

    :param context_dim: C
    :param trajectory_shape: (T, D)
    :param regression: which one
    :param n_bases: smooth bases of a trajectory, per dimension
    :raises ConfigurationError: there is no such regression
    """

    growing: ClassVar[tuple[str, ...]] = ("contexts", "right")

    contexts: th.Tensor
    right: th.Tensor

    def __init__(
        self,
        context_dim: int,
        trajectory_shape: tuple[int, int],
        regression: Regression = "nearest",
        n_bases: int = 8,
    ) -> None:
        super().__init__()
        self.regression = Refitted(regression)
        self.space = SkillSpace(context_dim, trajectory_shape, n_bases)
        self.register_buffer("contexts", th.empty(0, context_dim, dtype=th.float64))
        self.register_buffer("right", th.empty(0, self.space.n_weights, dtype=th.float64))

    @property
    def is_ready(self) -> bool:
        """Whether it has learned anything."""
        return len(self.right) > 0

    def learn(self, experience: Experience, generator: th.Generator) -> None:
        """Take over what was right.

        :param experience: all rollouts so far
        :param generator: not needed
        """
        del generator
        contexts, rows = experience.contexts, experience.right
        if experience.achieved is not None:
            contexts = experience.achieved
            rows = np.flatnonzero(np.isfinite(contexts).all(axis=1))
        self.contexts = self.contexts.new_tensor(contexts[rows])
        self.right = self.right.new_tensor(experience.weights[rows])

    def answer(self, contexts: NDArray[np.floating]) -> FloatArray:
        """Return the weights that answer contexts, shape (N, P).

        :param contexts: shape (N, C)
        """
        return self.regression.on(self.contexts, self.right)(np.asarray(contexts, np.float64))

    def explore(self, contexts: NDArray[np.floating], members: NDArray[np.intp]) -> FloatArray:
        """Return the weights around which members of a generation explore: the answers, (n, P).

        :param contexts: shape (n, C)
        :param members: shape (n,)
        """
        del members
        return self.answer(contexts)
