"""`ShownDemonstrations`: what a policy was shown, kept in it for algorithms that learn it again."""

from typing import ClassVar

import torch as th

from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.growing import GrowingModule


class ShownDemonstrations(GrowingModule):
    """Demonstrations that are saved with a policy, bit for bit.

    >>> shown = ShownDemonstrations(context_dim=1, trajectory_shape=(2, 1))
    >>> shown.demonstrations() is None
    True
    >>> shown.take(Demonstrations([[0.0]], [[[0.0], [0.5]]]))
    >>> len(shown.demonstrations())
    1

    :param context_dim: C
    :param trajectory_shape: (T, D)
    """

    growing: ClassVar[tuple[str, ...]] = ("contexts", "trajectories")

    contexts: th.Tensor
    trajectories: th.Tensor

    def __init__(self, context_dim: int, trajectory_shape: tuple[int, int]) -> None:
        super().__init__()
        self.register_buffer("contexts", th.empty(0, context_dim, dtype=th.float64))
        self.register_buffer("trajectories", th.empty(0, *trajectory_shape, dtype=th.float64))

    def take(self, demonstrations: Demonstrations) -> None:
        """Keep demonstrations in the place of those before.

        :param demonstrations: of this shape
        """
        self.contexts = self.contexts.new_tensor(demonstrations.contexts)
        self.trajectories = self.trajectories.new_tensor(demonstrations.trajectories)

    def demonstrations(self) -> Demonstrations | None:
        """Return what is kept; None where nothing was shown."""
        if len(self.contexts) == 0:
            return None
        return Demonstrations(self.contexts.cpu().numpy(), self.trajectories.cpu().numpy())
