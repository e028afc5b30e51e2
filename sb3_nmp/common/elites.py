"""The best trajectory seen in each context, kept in the policy so that it is saved with it."""

from typing import ClassVar

import numpy as np
import torch as th
from numpy.typing import NDArray

from sb3_nmp.common.growing import GrowingModule

SAME_CONTEXT = 1e-5


class EliteMemory(GrowingModule):
    """Best trajectory and its reward for every distinct context, the most recently improved last.

    A trajectory that solved the task is better than one that did not, whatever their rewards.

    >>> memory = EliteMemory(context_dim=1, trajectory_shape=(5, 2))
    >>> memory.update(np.zeros((2, 1)), np.ones((2, 5, 2)), np.array([-3.0, -1.0]))
    >>> memory.rewards.tolist(), memory.find(th.tensor([0.0])), memory.find(th.tensor([1.0]))
    ([-1.0], 0, None)

    :param context_dim: C
    :param trajectory_shape: (T, D)
    :param capacity: at most so many contexts; the longest unimproved is forgotten
    """

    growing: ClassVar[tuple[str, ...]] = ("contexts", "trajectories", "rewards", "solved")

    contexts: th.Tensor
    trajectories: th.Tensor
    rewards: th.Tensor
    solved: th.Tensor

    def __init__(
        self, context_dim: int, trajectory_shape: tuple[int, int], capacity: int = 1000
    ) -> None:
        super().__init__()
        self.capacity = capacity
        self.register_buffer("contexts", th.empty(0, context_dim))
        self.register_buffer("trajectories", th.empty(0, *trajectory_shape))
        self.register_buffer("rewards", th.empty(0, dtype=th.float64))
        self.register_buffer("solved", th.empty(0, dtype=th.bool))

    def find(self, context: th.Tensor) -> int | None:
        """Return the index of a context's elite, None where there is none.

        :param context: shape (C,)
        """
        if len(self.rewards) == 0:
            return None
        distance = (self.contexts - context).abs().amax(dim=1)
        index = int(distance.argmin())
        return index if float(distance[index]) <= SAME_CONTEXT else None

    def update(
        self,
        contexts: NDArray[np.floating],
        trajectories: NDArray[np.floating],
        rewards: NDArray[np.floating],
        successes: NDArray[np.bool_] | None = None,
    ) -> None:
        """Take in rollouts; each replaces its context's elite only if it is better.

        :param contexts: shape (N, C)
        :param trajectories: shape (N, T, D)
        :param rewards: shape (N,)
        :param successes: which of them solved the task, shape (N,); None compares rewards alone
        """
        solved = np.zeros(len(rewards), bool) if successes is None else successes
        for row in range(len(rewards)):
            context = th.as_tensor(contexts[row], dtype=th.float32, device=self.contexts.device)
            index, merit = self.find(context), (bool(solved[row]), float(rewards[row]))
            if index is None:
                self._append(context, trajectories[row], *merit)
            elif merit > (bool(self.solved[index]), float(self.rewards[index])):
                keep = th.arange(len(self.rewards), device=context.device) != index
                self._keep(keep)
                self._append(context, trajectories[row], *merit)

    def forget(self) -> None:
        """Forget all."""
        self._keep(slice(0, 0))

    def _append(
        self, context: th.Tensor, trajectory: NDArray[np.floating], solved: bool, reward: float
    ) -> None:
        new = th.as_tensor(trajectory, dtype=th.float32, device=context.device)
        self.contexts = th.cat([self.contexts, context[None]])
        self.trajectories = th.cat([self.trajectories, new[None]])
        self.rewards = th.cat([self.rewards, self.rewards.new_tensor([reward])])
        self.solved = th.cat([self.solved, self.solved.new_tensor([solved])])
        if len(self.rewards) > self.capacity:
            self._keep(slice(1, None))

    def _keep(self, rows: th.Tensor | slice) -> None:
        self.contexts, self.trajectories, self.rewards, self.solved = (
            self.contexts[rows],
            self.trajectories[rows],
            self.rewards[rows],
            self.solved[rows],
        )
