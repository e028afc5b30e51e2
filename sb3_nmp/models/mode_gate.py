"""`ModeGate`: which of several ways to do a task is taken in a context, p(k | c).

Shape letters: N contexts, C context, K modes.
"""

import numpy as np
import torch as th
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression
from torch import nn

from sb3_nmp.models.mode_success import ModeSuccess

#: weight of which mode was shown where, once there are rollouts that failed
SHOWN = 0.3


class ModeGate(nn.Module):
    """Softmax regression from contexts to modes, until an answer is known to have failed.

    From then on the mode whose answer most likely succeeds is chosen (`ModeSuccess`): which way
    was shown somewhere tells less (`SHOWN`) of which way succeeds there.

    >>> gate = ModeGate(context_dim=1, n_modes=2)
    >>> left = th.tensor([[-1.0], [-0.8], [-0.9], [-0.7], [0.9]])
    >>> gate.learn(left, np.array([0, 0, 0, 0, 1]))
    >>> gate(th.tensor([[-1.0], [3.0]])).tolist()
    [0, 1]

    :param context_dim: C
    :param n_modes: K
    """

    slopes: th.Tensor
    offsets: th.Tensor

    def __init__(self, context_dim: int, n_modes: int) -> None:
        super().__init__()
        self.n_modes = n_modes
        self.outcomes = ModeSuccess(context_dim, n_modes)
        self.register_buffer("slopes", th.zeros(n_modes, context_dim))
        self.register_buffer("offsets", th.zeros(n_modes))

    @property
    def is_taken(self) -> th.Tensor:
        """Which modes were ever taken, shape (K,)."""
        return self.offsets > -th.inf

    def learn(self, contexts: th.Tensor, modes: NDArray[np.intp]) -> None:
        """Fit it; a mode that was never taken is never chosen.

        :param contexts: standardised, shape (N, C)
        :param modes: of each, from 0 on, shape (N,)
        """
        if self.outcomes.is_to_learn:
            self.outcomes.learn(contexts, th.as_tensor(modes, device=contexts.device))
        taken = np.unique(modes)
        self.slopes.zero_()
        self.offsets.fill_(-th.inf)
        self.offsets[th.as_tensor(taken)] = 0.0
        if len(taken) < 2:
            return
        found = LogisticRegression().fit(contexts.cpu().numpy().astype(np.float64), modes)
        for slopes, offset, mode in zip(*_of_each(found), taken, strict=True):
            self.slopes[mode] = th.as_tensor(slopes)
            self.offsets[mode] = float(offset)

    def log_shares(self, contexts: th.Tensor) -> th.Tensor:
        """Return log p(k | c), shape (N, K).

        :param contexts: standardised, shape (N, C)
        """
        shown = contexts @ self.slopes.T + self.offsets
        if not self.outcomes.knows_failures:
            return shown.log_softmax(dim=1)
        succeeds = nn.functional.logsigmoid(self.outcomes(contexts))
        return (succeeds + SHOWN * shown.log_softmax(dim=1)).log_softmax(dim=1)

    def forward(self, contexts: th.Tensor) -> th.Tensor:
        """Return the likeliest mode, shape (N,).

        :param contexts: standardised, shape (N, C)
        """
        return self.log_shares(contexts).argmax(dim=1)


def _of_each(found: LogisticRegression) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return slopes and offsets of each class; of two, scikit-learn tells the second's alone."""
    slopes, offsets = np.asarray(found.coef_), np.asarray(found.intercept_)
    if len(slopes) > 1:
        return slopes, offsets
    return np.concatenate([0 * slopes, slopes]), np.concatenate([0 * offsets, offsets])
