"""Several ways to do a task in one context, found and kept in one run.

Two solutions are one way if the trajectory midway between them succeeds too; where it fails, a
valley lies between them (the hill-valley test of Ursem, "Multinational evolutionary algorithms",
1999). Midway is meant in place and in time: dynamic time warping tells which points belong
together, so that the same path at another pace is no other way. The test costs one rollout. It is
made for a success that is nearer to the initial trajectory than to what is known, and again 1, 2,
4, ... generations after a way was found: rough paths that go the same way can have a valley between
them, which is gone once they are better. Shape letters: N rollouts, K ways, T x D trajectory.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.common.buffer import TrajectoryBuffer
from sb3_nmp.common.settings import saved_state

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """What the rollouts so far are worth to some members of a generation.

    :param rewards: shape (N,); what is none of their business is worst
    :param successes: shape (N,)
    :param n: how many members see it so
    :param age: generations since their noise began to decay
    :param fresh: share of their candidates that are made as in the first generation
    :param way: the number of the one that they are to better; None where there is none, or where
        they look for others
    """

    rewards: FloatArray
    successes: NDArray[np.bool_]
    n: int
    age: int
    fresh: float = 0.0
    way: int | None = None


@saved_state("niches")
@dataclass
class Niches:
    """How far the search for several ways has come; it is saved with the model.

    :param n_modes: how many are looked for
    :param best: row of the best rollout of each way that was found
    :param born: the generation in which each was found
    :param same: rows that turned out to be of a known way
    :param pending: row of the success whose test is under way, None if there is none
    :param doubtful: the numbers of two ways whose test is under way, None if there are none
    """

    n_modes: int
    best: list[int] = field(default_factory=list)
    born: list[int] = field(default_factory=list)
    same: list[int] = field(default_factory=list)
    pending: int | None = None
    doubtful: tuple[int, int] | None = None

    def take(
        self, buffer: TrajectoryBuffer, initial: FloatArray, first: int, generation: int
    ) -> None:
        """Draw the conclusions of a generation.

        A success may become the best of the way to whose best it is nearest so far: ways change by
        small steps, so their first rollouts soon tell little about them.

        :param buffer: all rollouts so far
        :param initial: shape (T, D)
        :param first: row of the generation's first rollout
        :param generation: its number
        """
        new = np.arange(first, len(buffer))
        if self.pending is not None:
            if buffer.successes[first]:
                self.same += [self.pending, first]
                new = np.append(new, self.pending)
            else:
                self._found(self.pending, generation)
            self.pending = None
        elif self.doubtful is not None:
            if buffer.successes[first]:
                self._merge(*self.doubtful, buffer)
                self.same.append(first)
            self.doubtful = None
        elif not self.best and buffer.successes.any():
            merit = np.where(buffer.successes, buffer.rewards, -np.inf)
            self._found(int(merit.argmax()), 0)
        if self.best:
            labels = self.labels(buffer, initial)
            for row in new[buffer.successes[new] & (labels[new] >= 0)]:
                if buffer.rewards[row] > buffer.rewards[self.best[labels[row]]]:
                    self.best[labels[row]] = int(row)

    def _found(self, row: int, generation: int) -> None:
        self.best.append(row)
        self.born.append(generation)

    def _merge(self, one: int, other: int, buffer: TrajectoryBuffer) -> None:
        """Make two ways the first of them, with the better best."""
        rows = [self.best[one], self.best[other]]
        self.best[one] = rows[int(buffer.rewards[rows].argmax())]
        self.same += rows
        del self.best[other], self.born[other]

    def labels(self, buffer: TrajectoryBuffer, initial: FloatArray) -> NDArray[np.intp]:
        """Return the way of each rollout, -1 for those of none that is known, shape (N,).

        A rollout is of the way to whose best it is nearest, unless it is nearer to the initial
        trajectory.

        :param buffer: all rollouts so far
        :param initial: shape (T, D)
        """
        distances = self._from_centres(buffer.trajectories, buffer, initial)
        nearest = distances.argmin(axis=0) - 1
        nearest[self.same] = distances[1:, self.same].argmin(axis=0)
        return nearest

    def nearest(
        self, trajectories: NDArray[np.floating], buffer: TrajectoryBuffer, initial: FloatArray
    ) -> NDArray[np.intp]:
        """Return the way of trajectories that were not executed, as `labels` does, shape (M,).

        :param trajectories: shape (M, T, D)
        :param buffer: all rollouts so far
        :param initial: shape (T, D)
        """
        return self._from_centres(trajectories, buffer, initial).argmin(axis=0) - 1

    def _from_centres(
        self, trajectories: NDArray[np.floating], buffer: TrajectoryBuffer, initial: FloatArray
    ) -> FloatArray:
        """Return how far they are from the initial one and from each way's best, (1 + K, M)."""
        centres = [initial, *buffer.trajectories[self.best]]
        return np.stack([_distances(trajectories, centre) for centre in centres])

    def views(
        self, buffer: TrajectoryBuffer, initial: FloatArray, n: int, generation: int
    ) -> list[View]:
        """Share the members of a generation out: half of them look for ways that are missing.

        A way has the more of the others, the fewer rollouts it has had: the first one found would
        else stay ahead, by all those of before the second was.

        :param buffer: all rollouts so far
        :param initial: shape (T, D)
        :param n: members
        :param generation: the number of generations so far
        """
        if not self.best:
            return [View(buffer.rewards, buffer.successes, n, generation)]
        labels = self.labels(buffer, initial)
        n_new = n // 2 if len(self.best) < self.n_modes else 0
        mine = [labels == k for k in range(len(self.best))]
        shares = _shares(n - n_new, [int(each.sum()) for each in mine])
        views = [
            _view(buffer, mine[k], share, generation - self.born[k], way=k)
            for k, share in enumerate(shares)
        ]
        if n_new:
            views.append(_view(buffer, labels == -1, n_new, 0, fresh=0.5))
        return [view for view in views if view.n]

    def to_test(
        self, buffer: TrajectoryBuffer, initial: FloatArray, generation: int
    ) -> FloatArray | None:
        """Return the trajectory midway between two that may go the same way, shape (T, D).

        They are the bests of two ways, or a new success and what is known.

        :param buffer: all rollouts so far
        :param initial: shape (T, D)
        :param generation: the number of generations so far
        :return: None where there is nothing to test
        """
        self.doubtful = self._due(buffer, generation)
        if self.doubtful is not None:
            one, other = buffer.trajectories[[self.best[way] for way in self.doubtful]]
            return midway(one, other)
        if not self.best or len(self.best) == self.n_modes:
            return None
        rows = np.flatnonzero(buffer.successes & (self.labels(buffer, initial) == -1))
        if len(rows) == 0:
            return None
        self.pending = int(rows[buffer.rewards[rows].argmax()])
        stored = buffer.trajectories.astype(np.float64)
        nearest = _distances(buffer.trajectories, stored[self.pending])[self.best].argmin()
        return midway(stored[self.pending], stored[self.best[int(nearest)]])

    def _due(self, buffer: TrajectoryBuffer, generation: int) -> tuple[int, int] | None:
        """Return the youngest way that is to be tested again, and the one nearest to it, in order.

        :param buffer: all rollouts so far
        :param generation: the number of generations so far
        """
        for way in reversed(range(1, len(self.best))):
            age = generation - self.born[way]
            if age > 0 and age & (age - 1) == 0:  # a power of two
                bests = buffer.trajectories[self.best]
                distances = _distances(bests, bests[way])
                distances[way] = np.inf
                nearest = int(distances.argmin())
                return min(nearest, way), max(nearest, way)
        return None


def _shares(n: int, n_rollouts: list[int]) -> list[int]:
    """Return how many of n members each way has, in inverse proportion to its rollouts so far."""
    weights = 1.0 / np.maximum(n_rollouts, 1)
    ends = np.floor(n * weights.cumsum() / weights.sum() + 0.5).astype(int)
    return np.diff(ends, prepend=0).tolist()


def midway(one: NDArray[np.floating], other: NDArray[np.floating]) -> FloatArray:
    """Return the trajectory midway between two, in place and in time, shape (T, D).

    Their points are paired by dynamic time warping (Sakoe and Chiba, "Dynamic programming algorithm
    optimization for spoken word recognition", 1978); of each pair both place and time are averaged.

    >>> early, late = np.array([[[0.0], [1.0], [1.0], [1.0]], [[0.0], [0.0], [0.0], [1.0]]])
    >>> midway(early, late).round(2).ravel().tolist()
    [0.0, 0.0, 1.0, 1.0]

    :param one: shape (T, D)
    :param other: shape (T, D)
    """
    one, other = one.astype(np.float64), other.astype(np.float64)
    at, there = _pairs(np.linalg.norm(one[:, None] - other, axis=-1))
    place, time = 0.5 * (one[at] + other[there]), 0.5 * (at + there)
    return np.stack([np.interp(np.arange(len(one)), time, each) for each in place.T], axis=-1)


def _pairs(costs: FloatArray) -> NDArray[np.intp]:
    """Return the pairs of time points whose sum of costs is least, in their order, shape (2, P).

    They begin and end together, and from one to the next each time goes on by a point or stays.

    :param costs: of pairing each point with each, shape (T, T)
    """
    size = len(costs)
    totals = np.full((size + 1, size + 1), np.inf)
    totals[0, 0] = 0.0
    for diagonal in range(2 * size - 1):
        i = np.arange(max(0, diagonal - size + 1), min(diagonal, size - 1) + 1)
        j = diagonal - i
        before = np.minimum(totals[i, j], np.minimum(totals[i, j + 1], totals[i + 1, j]))
        totals[i + 1, j + 1] = costs[i, j] + before
    pairs = [(size - 1, size - 1)]
    while pairs[-1] != (0, 0):
        i, j = pairs[-1]
        _, *step = min((totals[i, j], 1, 1), (totals[i, j + 1], 1, 0), (totals[i + 1, j], 0, 1))
        pairs.append((i - step[0], j - step[1]))
    return np.array(pairs[::-1]).T


def _view(
    buffer: TrajectoryBuffer,
    mine: NDArray[np.bool_],
    n: int,
    age: int,
    fresh: float = 0.0,
    way: int | None = None,
) -> View:
    worst = buffer.rewards.min() - 1.0
    rewards = np.where(mine, buffer.rewards, worst)
    return View(rewards, buffer.successes & mine, n, age, fresh, way)


def _distances(trajectories: NDArray[np.floating], centre: NDArray[np.floating]) -> FloatArray:
    """Return the root mean square distances of trajectories from one, shape (M,)."""
    return np.sqrt(((trajectories - centre) ** 2).mean(axis=(1, 2))).astype(np.float64)
