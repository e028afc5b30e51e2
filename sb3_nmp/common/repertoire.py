"""Rollouts by what they achieved: what is asked is repeated where it is known to be right.

Where bodies collide, trajectories that differ in the twelfth digit may achieve different things (in
`nmp/Pouring-v1` they differ by 20 g), and no model can tell; an exact repeat achieves the same. A
success at some distance between what was asked and what was achieved shows how near is near enough.
Shape letters: N contexts, M rollouts, C context, T x D trajectory.
"""

from typing import ClassVar

import numpy as np
import torch as th
from numpy.typing import NDArray

from sb3_nmp.common.growing import GrowingModule


class Repertoire(GrowingModule):
    """Trajectories that achieved something, to be repeated as they were.

    Entries of a context that every rollout achieves as they were given are circumstances, the
    others goals. A rollout is repeated for goals within `reach` of what it achieved, and the one of
    most like circumstances is.

    >>> known = Repertoire(context_dim=1, trajectory_shape=(5, 2))
    >>> asked, achieved = np.array([[0.0], [3.0]]), np.array([[0.5], [1.0]])
    >>> known.learn(asked, achieved, np.array([True, False]), np.zeros((2, 5, 2)), alike=0.2)
    >>> known.find(th.tensor([[0.7], [2.0]])).tolist()
    [0, -1]

    :param context_dim: C
    :param trajectory_shape: (T, D)
    """

    growing: ClassVar[tuple[str, ...]] = ("achieved", "trajectories")

    achieved: th.Tensor
    trajectories: th.Tensor
    goals: th.Tensor
    unit: th.Tensor
    reach: th.Tensor
    alike: th.Tensor

    def __init__(self, context_dim: int, trajectory_shape: tuple[int, int]) -> None:
        super().__init__()
        self.register_buffer("achieved", th.empty(0, context_dim, dtype=th.float64))
        self.register_buffer("trajectories", th.empty(0, *trajectory_shape))
        self.register_buffer("goals", th.ones(context_dim, dtype=th.bool))
        self.register_buffer("unit", th.ones(context_dim, dtype=th.float64))
        self.register_buffer("reach", th.zeros((), dtype=th.float64))
        self.register_buffer("alike", th.zeros((), dtype=th.float64))

    def learn(
        self,
        contexts: NDArray[np.floating],
        achieved: NDArray[np.floating],
        successes: NDArray[np.bool_],
        trajectories: NDArray[np.floating],
        alike: float | None,
    ) -> None:
        """Take over all rollouts so far, and learn how near to a goal is near enough.

        That is as near as the farthest success, but nearer than every failure.

        :param contexts: that were asked for, shape (M, C)
        :param achieved: NaN where nothing was, shape (M, C)
        :param successes: shape (M,)
        :param trajectories: as they were executed, shape (M, T, D)
        :param alike: circumstances of a repeat differ by at most this, in standard deviations; None
            repeats none
        """
        self.alike.fill_(-1.0 if alike is None else alike)
        told = np.isfinite(achieved).all(axis=1)
        asked, got, succeeded = contexts[told].astype(np.float64), achieved[told], successes[told]
        goals = (np.abs(asked - got) > 1e-6 * (1.0 + np.abs(got))).any(axis=0)
        unit = asked.std(axis=0)
        unit = np.where(unit > 0, unit, 1.0)
        miss = np.linalg.norm(((got - asked) / unit)[:, goals], axis=1)
        farthest = np.max(miss[succeeded], initial=0.0)
        nearest_failure = np.min(miss[~succeeded], initial=np.inf)
        self.reach.fill_(min(float(farthest), float(np.nextafter(nearest_failure, 0.0))))
        self.goals, self.unit = self.goals.new_tensor(goals), self.unit.new_tensor(unit)
        self.achieved = self.achieved.new_tensor(got)
        self.trajectories = self.trajectories.new_tensor(trajectories[told])

    def find(self, contexts: th.Tensor) -> th.Tensor:
        """Return which rollout to repeat for each context, -1 where none is right, shape (N,).

        :param contexts: shape (N, C)
        """
        if len(self.achieved) == 0:
            return th.full((len(contexts),), -1)
        apart = (contexts.double()[:, None] - self.achieved) / self.unit
        miss = apart[..., self.goals].norm(dim=-1)
        unlike = apart[..., ~self.goals].norm(dim=-1)
        fits = (miss <= self.reach) & (unlike <= self.alike)
        # where circumstances differ it may achieve another thing, which a small miss forgives
        risk = (unlike + 1e-6) * (1.0 + (miss / self.reach.clamp(min=1e-12)) ** 2)
        best = th.where(fits, risk, th.inf).argmin(dim=1)
        return th.where(fits.any(dim=1), best, -1)

    def approach(self, contexts: th.Tensor, stride: float) -> th.Tensor:
        """Return contexts whose goals lie a stride from what was achieved, if farther; (N, C).

        Where no success has told the reach, contexts stay as they are.

        :param contexts: shape (N, C)
        :param stride: in units of `reach`
        """
        farthest = stride * self.reach
        if len(self.achieved) == 0 or farthest == 0:
            return contexts
        wanted = contexts.double()
        nearest = ((wanted[:, None] - self.achieved) / self.unit).norm(dim=-1).argmin(dim=1)
        ahead = th.where(self.goals, wanted - self.achieved[nearest], 0.0)
        miss = (ahead / self.unit).norm(dim=-1, keepdim=True)
        beyond = 1.0 - farthest / miss.clamp(min=farthest)
        return (wanted - beyond * ahead).to(contexts.dtype)
