"""What searches by populations do with trajectories, as pure functions: crossover and choice.

Shape letters: N trajectories, T time points, D dimensions, E judges.
"""

import numpy as np
from numpy.typing import NDArray


def take_turns(promise: NDArray[np.float64], n: int) -> NDArray[np.intp]:
    """Let judges choose in turn, each the candidate that promises most to it, shape (n,).

    Judges that have seen the same and disagree where they are in doubt choose as Thompson sampling
    does.

    >>> take_turns(np.array([[3.0, 2.0, 1.0], [3.0, 1.0, 2.0]]), 2).tolist()
    [0, 2]

    :param promise: of N candidates in the opinion of E judges, shape (E, N)
    :param n: how many are chosen, at most N
    """
    left, chosen = promise.copy(), np.empty(n, np.intp)
    for turn in range(n):
        chosen[turn] = left[turn % len(left)].argmax()
        left[:, chosen[turn]] = -np.inf
    return chosen


def blend(
    before: NDArray[np.floating], after: NDArray[np.floating], cuts: NDArray[np.int_]
) -> NDArray[np.float64]:
    """Return trajectories that follow one parent until the cut and another from it on, (N, T, D).

    :param before: shape (N, T, D)
    :param after: shape (N, T, D)
    :param cuts: time indices, shape (N,)
    """
    times = np.arange(before.shape[1])[:, None]
    return np.where(times < cuts[:, None, None], before, after).astype(np.float64)
