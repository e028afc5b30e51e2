"""What a judge of candidates learns from rollouts in one context, whoever judges: network or twin.

A judge tells how likely a trajectory w earns the wanted reward r*, the best one so far::

    p(r* | w) ~ p(success | w) exp((r(w) - r*) / s)

with s the spread of the better successes. Shape letters: N and M rollouts, T x D trajectory.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.common.buffer import scale_rewards

FloatArray = NDArray[np.float64]

N_MOMENTS = 20  # at which judges look at a trajectory
LEAST_SUCCESSES = 5  # before success and reward are learned apart
WORST_SCORE = -5.0  # of a success


@dataclass(frozen=True)
class Wanted:
    """What is to be learned of each rollout.

    >>> rewards, solved = np.array([-4.0, -1.0, -2.0, -1.5, -1.0, -3.0]), np.ones(6, bool)
    >>> Wanted.of(rewards, solved).score.round(1).tolist()
    [-2.9, 0.0, -1.0, -0.5, 0.0, -2.0]
    >>> Wanted.of(rewards[:3], solved[:3]).score.tolist()  # too few: by place
    [-1.0, 1.0, 0.0]

    :param success: whether it solved the task, 0 or 1, shape (N,)
    :param score: of successes (r - r*) / s, where there are enough of them (`is_split`); else the
        place of all rewards in [-1, 1]; shape (N,)
    :param is_split: whether success and score are learned apart
    """

    success: FloatArray
    score: FloatArray
    is_split: bool

    @classmethod
    def of(cls, rewards: FloatArray, successes: NDArray[np.bool_]) -> Self:
        """Return what is wanted of rollouts.

        :param rewards: shape (N,)
        :param successes: shape (N,)
        """
        success = successes.astype(np.float64)
        if successes.sum() < LEAST_SUCCESSES:
            return cls(success, scale_rewards(rewards, "rank"), is_split=False)
        solved = np.sort(rewards[successes])
        best, better = solved[-1], solved[-max(LEAST_SUCCESSES, len(solved) // 2) :]
        spread = float(np.sqrt(np.mean((better - best) ** 2))) or 1.0
        score = np.maximum((rewards - best) / spread, WORST_SCORE)
        return cls(success, score, is_split=True)


def features(
    known: NDArray[np.floating], asked: NDArray[np.floating]
) -> tuple[FloatArray, FloatArray]:
    """Return trajectories as judges see them: at some moments, shapes (M, F) and (N, F).

    :param known: gives the origin and, by dimension, the unit, shape (M, T, D)
    :param asked: shape (N, T, D)
    """
    at = np.linspace(0, known.shape[1] - 1, N_MOMENTS).round().astype(int)
    seen = known[:, at].astype(np.float64)
    origin = seen.mean(axis=0)
    unit = np.maximum(np.sqrt(((seen - origin) ** 2).mean(axis=(0, 1))), 1e-9)
    first, second = (
        ((rows - origin) / unit).reshape(len(rows), -1) for rows in (seen, asked[:, at])
    )
    return first, second
