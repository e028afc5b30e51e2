"""The twins of RC-NMP's skill over contexts: the network taken out, all else equal.

Weights of what was right (successes, or what was achieved) are regressed on the context by the
nearest neighbour, a ridge or Gaussian processes. Shape letters: N contexts, M right rollouts, C
context, P weights.
"""

from typing import ClassVar, Literal, cast, get_args

import numpy as np
import torch as th
from numpy.typing import NDArray

from sb3_nmp.common.contextual import Experience
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.growing import GrowingModule
from sb3_nmp.models.skill_space import SkillSpace

FloatArray = NDArray[np.float64]
#: how contexts are answered
Regression = Literal["nearest", "ridge", "gaussian-process"]

RIDGE = 0.3  # of the slopes, contexts having a standard deviation of 1
NEWEST = 600  # right rollouts that a Gaussian process sees at most
LENGTHS = (0.3, 0.5, 0.8, 1.2, 2.0, 3.0, 5.0, 8.0)  # of its kernel, to choose from by evidence
NOISES = (1e-4, 1e-3, 1e-2, 0.1, 0.3, 1.0)  # variances, as shares of the kernel's


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
        if regression not in get_args(Regression):
            raise ConfigurationError(
                f"no regression '{regression}'; there are {', '.join(get_args(Regression))}."
            )
        self.regression: Regression = regression
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
        known, weights = self.contexts.cpu().numpy(), self.right.cpu().numpy()
        std = known.std(axis=0)
        std = np.where(std > 1e-9, std, 1.0)
        old, new = known / std, np.asarray(contexts, np.float64) / std
        if self.regression == "nearest":
            return weights[np.square(new[:, None] - old).sum(axis=2).argmin(axis=1)]
        if self.regression == "ridge":
            return ridge(old, weights, new)
        return gaussian_process(old[-NEWEST:], weights[-NEWEST:], new)

    def explore(self, contexts: NDArray[np.floating], members: NDArray[np.intp]) -> FloatArray:
        """Return the weights around which members of a generation explore: the answers, (n, P).

        :param contexts: shape (n, C)
        :param members: shape (n,)
        """
        del members
        return self.answer(contexts)


def ridge(known: FloatArray, weights: FloatArray, contexts: FloatArray) -> FloatArray:
    """Return predictions that are linear in the context, shape (N, P).

    :param known: contexts with a standard deviation of 1, shape (M, C)
    :param weights: theirs, shape (M, P)
    :param contexts: shape (N, C)
    """
    centre, middle = known.mean(axis=0), weights.mean(axis=0)
    rows = known - centre
    gram = rows.T @ rows + RIDGE * np.eye(rows.shape[1])
    return middle + (contexts - centre) @ np.linalg.solve(gram, rows.T @ (weights - middle))


def gaussian_process(known: FloatArray, weights: FloatArray, contexts: FloatArray) -> FloatArray:
    """Return the mean of Gaussian processes with one kernel for all weights, shape (N, P).

    Length scale and noise are those of largest marginal likelihood.

    :param known: contexts with a standard deviation of 1, shape (M, C)
    :param weights: theirs, shape (M, P)
    :param contexts: shape (N, C)
    """
    middle = weights.mean(axis=0)
    values = weights - middle
    squares = np.square(known[:, None] - known).sum(axis=2)
    best: tuple[float, float, FloatArray] | None = None
    for length in LENGTHS:
        eigenvalues, axes = np.linalg.eigh(np.exp(-0.5 * squares / length**2))
        seen = axes.T @ values
        for noise in NOISES:
            spread = np.maximum(eigenvalues, 0.0) + noise
            fit = float((np.square(seen).sum(axis=1) / spread).sum()) / values.size
            surprise = np.log(max(fit, 1e-12)) + np.log(spread).sum() / len(values)
            if best is None or surprise < best[0]:
                best = (float(surprise), length, axes @ (seen / spread[:, None]))
    _, length, factors = cast(tuple[float, float, FloatArray], best)
    cross = np.square(contexts[:, None] - known).sum(axis=2)
    return middle + np.exp(-0.5 * cross / length**2) @ factors
