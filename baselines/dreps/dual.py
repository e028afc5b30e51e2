"""The dual problem of DREPS (Colome and Torras, Dual REPS), as pure functions.

Maximise ``E_pi[R]`` subject to ``KL(pi || q) <= epsilon``, ``KL(pi || b_i) >= xi_i`` for Gaussians
b_i of bad samples, and optionally ``KL(pi || good) <= chi``. With multipliers eta, nu_i, omega >= 0
and ``k = eta - sum_i nu_i + omega > 0``, stationarity gives ::

    pi ~ q^(eta / k) good^(omega / k) prod_i b_i^(-nu_i / k) exp(R / k)

and, for samples drawn from q, the dual ::

    g = eta epsilon + omega chi - sum_i nu_i xi_i + k log E_q[exp(S / k)]
    S = R + omega log(good / q) - sum_i nu_i log(b_i / q)

which is convex in (eta, nu, omega) where k > 0. Good and bad Gaussians differ in a sign only: here
they are *references* r_j with sign s_j (+1 stay near, -1 keep away), bound c_j and multiplier
lambda_j, so that ``k = eta + s . lambda`` and ``S = R + sum_j s_j lambda_j log(r_j / q)``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from baselines.reps import dual as reps_dual
from baselines.reps.dual import (
    Solution,
    check_epsilon,
    kl_from_uniform,
    log_sum_exp,
    standardize,
)
from sb3_nmp.common.exceptions import InvalidDataError

FloatArray = NDArray[np.float64]

MULTIPLIER_MAX = 1e2  # of nu and omega, in units of k: larger ones mean "infeasible"
TOLERANCE = 1e-2  # nats by which a constraint may be violated and still count as satisfied


@dataclass(frozen=True)
class References:
    """The M distributions that the next policy is to stay near to or keep away from.

    :param log_ratios: log r_j - log q of each sample, shape (M, N)
    :param signs: +1 stay near, -1 keep away, shape (M,)
    :param bounds: chi or xi_j, in nats, shape (M,)
    :raises InvalidDataError: shapes that do not fit, or a value that is not finite
    """

    log_ratios: FloatArray
    signs: FloatArray
    bounds: FloatArray

    def __post_init__(self) -> None:
        """Check shapes and values."""
        m = len(self.signs)
        if self.log_ratios.ndim != 2 or len(self.log_ratios) != m or self.bounds.shape != (m,):
            raise InvalidDataError(
                f"{m} references need log_ratios (M, N) and bounds (M,) with M = {m}, not "
                f"{self.log_ratios.shape} and {self.bounds.shape}."
            )
        if not np.isfinite(self.log_ratios).all():
            raise InvalidDataError("log_ratios hold a value that is not finite.")


@dataclass(frozen=True)
class DualSolution(Solution):
    """REPS's `Solution`, with the references.

    :param multipliers: lambda_j (nu_i and omega), in the rewards' unit, shape (M,)
    :param divergences: KL(pi || r_j) in nats, as the samples estimate it, shape (M,)
    :param feasible: every constraint is satisfied within `TOLERANCE`
    """

    multipliers: FloatArray
    divergences: FloatArray
    feasible: bool


def dual(
    k: float, multipliers: FloatArray, rewards: FloatArray, epsilon: float, references: References
) -> tuple[float, FloatArray]:
    """Return DREPS's dual g and its gradient for (k, lambda), shape (1 + M,).

    In these coordinates ``eta = k - s . lambda``.

    :param k: > 0
    :param multipliers: lambda, shape (M,)
    :param rewards: R, shape (N,)
    :param epsilon: bound on KL(pi || q), in nats
    :param references: of M distributions
    """
    signed = references.signs * multipliers
    scaled = (rewards + signed @ references.log_ratios) / k
    log_sum = log_sum_exp(scaled)
    log_mean, weights = log_sum - np.log(len(rewards)), np.exp(scaled - log_sum)
    eta = k - signed.sum()
    value = eta * epsilon + signed @ references.bounds + k * log_mean
    slope_k = epsilon + log_mean - weights @ scaled
    slopes = references.signs * (references.bounds - epsilon + references.log_ratios @ weights)
    return float(value), np.concatenate([[slope_k], slopes])


def sample_weights(
    k: float, multipliers: FloatArray, rewards: FloatArray, references: References
) -> FloatArray:
    """Return pi / q at the samples, normalised to add up to 1, shape (N,).

    :param k: > 0
    :param multipliers: lambda, shape (M,)
    :param rewards: R, shape (N,)
    :param references: of M distributions
    """
    scaled = (rewards + (references.signs * multipliers) @ references.log_ratios) / k
    return np.exp(scaled - log_sum_exp(scaled))


def solve(rewards: FloatArray, epsilon: float, references: References) -> DualSolution:
    """Minimise the dual over eta >= 0, nu >= 0, omega >= 0 with k > 0.

    Scale-free as in `baselines.reps.dual.solve`. Where no policy satisfies the constraints, the
    dual has no minimum, and its multipliers run away to single samples; then the weights are those
    of REPS, which keep near q, and ``feasible`` is False. With equal rewards there is nothing to
    gain: the weights are equal.

    :param rewards: R, shape (N,)
    :param epsilon: bound on KL(pi || q), in nats, > 0
    :param references: of M distributions; M may be 0
    :raises ConfigurationError: epsilon is not > 0
    :raises InvalidDataError: no rewards, or one that is not finite
    """
    check_epsilon(epsilon)
    scaled, std = standardize(rewards)
    plain = reps_dual.solve(rewards, epsilon)
    m = len(references.signs)
    without = _solution(plain.weights, plain.eta, np.zeros(m), epsilon, references)
    if std == 0.0 or m == 0:
        return without

    # Coordinates log k and mu = lambda / k: all of one order, and eta >= 0 becomes s . mu <= 1.
    def objective(x: FloatArray) -> tuple[float, FloatArray]:
        k = float(np.exp(x[0]))
        value, gradient = dual(k, k * x[1:], scaled, epsilon, references)
        slope = k * gradient[0] + k * (x[1:] @ gradient[1:])
        return value, np.concatenate([[slope], k * gradient[1:]])

    eta_row = np.concatenate([[0.0], -references.signs])
    low, high = np.log(reps_dual.ETA_BOUNDS)
    result = minimize(
        objective,
        np.concatenate([[np.clip(np.log(plain.eta / std), low, high)], np.zeros(m)]),
        jac=True,
        method="SLSQP",
        bounds=[(low, high)] + [(0.0, MULTIPLIER_MAX)] * m,
        constraints={"type": "ineq", "fun": lambda x: 1 + eta_row @ x, "jac": lambda x: eta_row},
        options={"maxiter": 300, "ftol": 1e-12},
    )
    k = float(np.exp(np.clip(result.x[0], low, high)))
    multipliers = k * np.clip(result.x[1:], 0.0, MULTIPLIER_MAX)
    weights = sample_weights(k, multipliers, scaled, references)
    eta = max(k - float(references.signs @ multipliers), 0.0)
    found = _solution(weights, eta * std, multipliers * std, epsilon, references)
    return found if found.feasible else without


def _solution(
    weights: FloatArray,
    eta: float,
    multipliers: FloatArray,
    epsilon: float,
    references: References,
) -> DualSolution:
    kl = kl_from_uniform(weights)
    divergences = kl - references.log_ratios @ weights
    slack = references.signs * (references.bounds - divergences)
    feasible = bool(kl <= epsilon + TOLERANCE and np.all(slack >= -TOLERANCE))
    return DualSolution(weights, eta, kl, multipliers, divergences, feasible)
