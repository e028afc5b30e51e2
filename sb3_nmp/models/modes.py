"""Telling modes apart: which of the ways to do a task each solved context was solved by.

A mixture of linear regressions from contexts to weights, fitted by expectation-maximisation. All
modes share one standard deviation, so that none can shrink onto a few rows. How many modes there
are is chosen by the Bayesian information criterion: a mode must explain more than chance would, so
a second one is not found where there is none. Shape letters: M rows, K modes, C context, P weights.
"""

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

RIDGE = 0.3  # of the slopes, contexts having a standard deviation of 1
FLOOR = 0.1  # least standard deviation of a mode, in units of the weights
N_STARTS, N_STEPS = 10, 30  # of expectation-maximisation


@dataclass(frozen=True)
class Mixture:
    """A fitted mixture.

    :param shares: responsibility of each mode for each row, sums to 1 over modes, shape (M, K)
    :param likelihood: log p(weights | contexts)
    :param parameters: how many were fitted, those that the ridge holds back counted in part
    """

    shares: FloatArray
    likelihood: float
    parameters: float

    @property
    def evidence(self) -> float:
        """The likelihood less the price of the parameters (BIC)."""
        return self.likelihood - 0.5 * self.parameters * np.log(len(self.shares))


def sort_into_modes(contexts: FloatArray, weights: FloatArray, n_modes: int) -> NDArray[np.intp]:
    """Return the mode of each row from 0 on, the commonest first, shape (M,).

    >>> contexts, ways = np.linspace(-1.0, 1.0, 12)[:, None], np.tile([1.0, -1.0, -1.0], 4)
    >>> sort_into_modes(contexts, (ways * (3.0 + contexts[:, 0]))[:, None] * np.ones(4), 2)[:3]
    array([1, 0, 0])

    :param contexts: with a standard deviation of about 1, shape (M, C)
    :param weights: in units of the exploration, shape (M, P)
    :param n_modes: the most modes; fewer are found where fewer explain the rows as well
    """
    rng, best = np.random.default_rng(0), _fit(contexts, weights, np.ones((len(weights), 1)))
    for k in range(2, min(n_modes, len(weights)) + 1):
        tried = [
            _fit(contexts, weights, _start(contexts, weights, k, rng)) for _ in range(N_STARTS)
        ]
        best = max([best, *tried], key=lambda mixture: mixture.evidence)
    labels = best.shares.argmax(axis=1)
    counts = np.bincount(labels)
    order = np.argsort(-counts, kind="stable")
    return cast(NDArray[np.intp], np.argsort(order)[labels])


def _start(
    contexts: FloatArray, weights: FloatArray, k: int, rng: np.random.Generator
) -> FloatArray:
    """Return the shares of k-means on what one regression leaves over, shape (M, K)."""
    fitted, _ = _regress(contexts, weights, np.ones(len(weights)))
    left = weights - fitted
    centres = left[rng.choice(len(left), 1)]
    while len(centres) < k:
        far = np.square(left[:, None] - centres).sum(axis=2).min(axis=1) + 1e-12
        centres = np.concatenate([centres, left[rng.choice(len(left), 1, p=far / far.sum())]])
    shares = np.empty((len(left), k))
    for _ in range(N_STEPS):
        shares = np.eye(k)[np.square(left[:, None] - centres).sum(axis=2).argmin(axis=1)]
        filled = shares.any(axis=0)
        centres[filled] = (shares.T @ left)[filled] / shares.sum(axis=0)[filled, None]
    return shares


def _fit(contexts: FloatArray, weights: FloatArray, shares: FloatArray) -> Mixture:
    """Fit a mixture by expectation-maximisation.

    :param contexts: shape (M, C)
    :param weights: shape (M, P)
    :param shares: to begin with, shape (M, K)
    """
    likelihood, freedom = -np.inf, 0.0
    for _ in range(N_STEPS):
        models = [_regress(contexts, weights, share) for share in shares.T]
        squares = np.stack([np.square(weights - f).sum(axis=1) for f, _ in models], axis=1)
        freedom = sum(degrees for _, degrees in models)
        variance = max((shares * squares).sum() / weights.size, FLOOR**2)
        prior = np.maximum(shares.mean(axis=0), 1e-12)
        scores = np.log(prior) - 0.5 * squares / variance
        top = scores.max(axis=1, keepdims=True)
        total = top + np.log(np.exp(scores - top).sum(axis=1, keepdims=True))
        shares = np.exp(scores - total)
        likelihood = float(total.sum()) - 0.5 * weights.size * np.log(2 * np.pi * variance)
    return Mixture(shares, likelihood, freedom * weights.shape[1] + shares.shape[1] - 1)


def _regress(
    contexts: FloatArray, weights: FloatArray, shares: FloatArray
) -> tuple[FloatArray, float]:
    """Return a weighted ridge's predictions (M, P), and its degrees of freedom for each weight.

    :param contexts: shape (M, C)
    :param weights: shape (M, P)
    :param shares: of each row, shape (M,)
    """
    rows = np.column_stack([np.ones(len(contexts)), contexts])
    weighted = rows.T * shares
    gram = weighted @ rows
    held = gram + np.diag([1e-6, *[RIDGE] * contexts.shape[1]])
    slopes = np.linalg.solve(held, weighted @ weights)
    return rows @ slopes, float(np.trace(np.linalg.solve(held, gram)))
