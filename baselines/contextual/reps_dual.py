"""The dual problem of contextual REPS, as pure functions.

Kupcsik, Deisenroth, Peters, Loh, Vadakkepat and Neumann, "Model-based contextual policy search for
data-efficient generalization of robot skills", 2017. Shape letters: N samples, F features.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from baselines.contextual.features import FloatArray
from baselines.reps.dual import ETA_BOUNDS, Solution, kl_from_uniform, log_sum_exp, standardize
from baselines.reps.dual import solve as solve_without_contexts
from sb3_nmp.common.exceptions import InvalidDataError

MAX_ITERATIONS = 500


@dataclass(frozen=True)
class ContextualSolution(Solution):
    """How much each sample counts, and what the context alone is worth.

    :param value: coefficients theta of the value theta . features, in the rewards' unit, shape (F,)
    """

    value: FloatArray


def dual(
    eta: float, theta: FloatArray, rewards: FloatArray, features: FloatArray, epsilon: float
) -> tuple[float, float, FloatArray]:
    """Return the dual g, and its derivatives for eta and theta.

    ``g = eta epsilon + theta . mean(phi) + eta log mean exp((R - theta . phi) / eta)``, convex.
    Where the derivative for theta is 0, the weighted samples have the contexts' mean features: an
    update cannot prefer easy contexts.

    :param eta: the temperature, > 0
    :param theta: of the value, shape (F,)
    :param rewards: R, shape (N,)
    :param features: phi, shape (N, F)
    :param epsilon: bound on the KL divergence, in nats
    """
    scaled = (rewards - features @ theta) / eta
    log_sum = log_sum_exp(scaled)
    weights, mean = np.exp(scaled - log_sum), features.mean(axis=0)
    log_mean = log_sum - float(np.log(len(rewards)))
    value = eta * (epsilon + log_mean) + theta @ mean
    return float(value), float(epsilon + log_mean - weights @ scaled), mean - weights @ features


def solve(rewards: FloatArray, features: FloatArray, epsilon: float) -> ContextualSolution:
    """Minimise the dual and return the weights p ~ exp((R - V) / eta) of the samples.

    Scale-free, as `baselines.reps.dual.solve`, whose solution for what regression leaves of the
    rewards is where the minimiser (L-BFGS-B) begins.

    :param rewards: R, shape (N,)
    :param features: first column 1, shape (N, F)
    :param epsilon: bound on KL(p || uniform), in nats, > 0
    :raises ConfigurationError: epsilon is not > 0
    :raises InvalidDataError: rewards that are not finite, or features that do not fit them
    """
    if len(features) != len(rewards):
        raise InvalidDataError(
            f"{len(features)} rows of features for {len(rewards)} rewards; there must be as many."
        )
    standard, std = standardize(rewards)
    theta = np.asarray(np.linalg.lstsq(features, standard, rcond=None)[0], np.float64)
    first = solve_without_contexts(standard - features @ theta, epsilon)
    if std == 0.0 or not np.isfinite(first.eta):  # the context explains all
        n, value = len(rewards), theta * std
        value[0] += float(rewards.max())
        return ContextualSolution(np.full(n, 1 / n), float("inf"), 0.0, value)
    low, high = ETA_BOUNDS

    def objective(x: FloatArray) -> tuple[float, FloatArray]:
        eta = float(np.exp(x[0]))
        value, by_eta, by_theta = dual(eta, x[1:], standard, features, epsilon)
        return value, np.concatenate([[eta * by_eta], by_theta])

    begin = np.concatenate([[np.log(np.clip(first.eta, low, high))], theta])
    bounds = [(np.log(low), np.log(high)), *([(None, None)] * len(theta))]
    options = {"maxiter": MAX_ITERATIONS, "ftol": 1e-13, "gtol": 1e-9}
    found = minimize(objective, begin, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    eta, theta = float(np.exp(found.x[0])), np.asarray(found.x[1:], np.float64)
    scaled = (standard - features @ theta) / eta
    weights = np.exp(scaled - log_sum_exp(scaled))
    value = theta * std
    value[0] += float(rewards.max())
    return ContextualSolution(weights, eta * std, kl_from_uniform(weights), value)
