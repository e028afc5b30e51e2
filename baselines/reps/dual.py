"""The dual problem of episodic REPS, as pure functions.

Peters, Muelling and Altun, "Relative entropy policy search", 2010.
"""

from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError

FloatArray = NDArray[np.float64]

#: eta is searched between these bounds, in units of the rewards' standard deviation. At the lower
#: one only the best sample counts, at the upper one all count the same.
ETA_BOUNDS = (1e-4, 1e6)


@dataclass(frozen=True)
class Solution:
    """How much each sample counts in the next policy.

    :param weights: >= 0, they add up to 1, shape (N,)
    :param eta: the temperature, in the rewards' unit
    :param kl: KL(weights || uniform), in nats
    """

    weights: FloatArray
    eta: float
    kl: float

    @property
    def effective_samples(self) -> float:
        """Kish's number of samples that count, 1 / sum of squared weights."""
        return float(1.0 / np.sum(self.weights**2))


def log_sum_exp(values: FloatArray) -> float:
    """Return log sum exp(values) without overflow.

    scipy.special.logsumexp rounds the last bit otherwise in one of 40 cases, and runs would differ.

    :param values: shape (N,)
    """
    highest = float(values.max())
    return highest + float(np.log(np.sum(np.exp(values - highest))))


def dual(eta: float, rewards: FloatArray, epsilon: float) -> tuple[float, float]:
    """Return REPS's dual g and its derivative for eta.

    ``g(eta) = eta epsilon + eta log mean exp(R / eta)``, convex in eta > 0; its derivative is
    ``epsilon - KL(p || uniform)`` for the weights p ~ exp(R / eta).

    :param eta: the temperature, > 0
    :param rewards: R, shape (N,)
    :param epsilon: bound on the KL divergence, in nats
    """
    scaled = rewards / eta
    log_sum = log_sum_exp(scaled)
    log_mean, weights = log_sum - float(np.log(len(rewards))), np.exp(scaled - log_sum)
    return eta * (epsilon + log_mean), float(epsilon + log_mean - weights @ scaled)


def standardize(rewards: FloatArray) -> tuple[FloatArray, float]:
    """Return rewards with maximum 0 and standard deviation 1, and the deviation they had.

    Rewards that are all equal up to rounding become zeros, with deviation 0.

    :param rewards: shape (N,)
    :raises InvalidDataError: none, or one that is not finite
    """
    if len(rewards) == 0 or not np.isfinite(rewards).all():
        raise InvalidDataError(
            f"{len(rewards)} rewards, {np.sum(~np.isfinite(rewards))} of them not finite; at least "
            "one is needed, and all must be finite numbers."
        )
    std = float(rewards.std())
    if std <= 1e-12 * max(1.0, float(np.abs(rewards).max())):
        return np.zeros(len(rewards)), 0.0
    return (rewards - rewards.max()) / std, std


def solve(rewards: FloatArray, epsilon: float) -> Solution:
    """Minimise the dual and return the samples' weights p ~ exp(R / eta).

    Scale-free: rewards are standardised and log eta is bounded (`ETA_BOUNDS`), so that eta can
    neither vanish nor blow up. The minimum is where the derivative is 0, and where that lies
    beyond the lower bound (more than ``exp(-epsilon) N`` samples share the best reward, or one lies
    very far below all others), at the bound, where the divergence stays below epsilon. Equal
    rewards give equal weights.

    :param rewards: R, shape (N,)
    :param epsilon: bound on KL(p || uniform), in nats, > 0
    :raises ConfigurationError: epsilon is not > 0
    :raises InvalidDataError: no rewards, or one that is not finite
    """
    check_epsilon(epsilon)
    scaled, std = standardize(rewards)
    if std == 0.0:
        return Solution(np.full(len(rewards), 1 / len(rewards)), float("inf"), 0.0)
    low, high = np.log(ETA_BOUNDS)

    def slope(log_eta: float) -> float:
        return dual(float(np.exp(log_eta)), scaled, epsilon)[1]

    log_eta = low if slope(low) >= 0 else brentq(slope, low, high, xtol=1e-10)
    eta = float(np.exp(cast(float, log_eta)))
    weights = np.exp(scaled / eta - log_sum_exp(scaled / eta))
    return Solution(weights, eta * std, kl_from_uniform(weights))


def epsilon_rule(epsilon: float) -> tuple[bool, str]:
    """Return whether epsilon fits, and its rule.

    :param epsilon: bound on a KL divergence, in nats
    """
    fits = bool(np.isfinite(epsilon)) and epsilon > 0
    return fits, "finite and > 0: it bounds a KL divergence in nats. Usual values: 0.5 to 2"


def check_epsilon(epsilon: float) -> None:
    """Raise unless epsilon is a positive finite number.

    :param epsilon: bound on a KL divergence, in nats
    :raises ConfigurationError: it is not
    """
    fits, rule = epsilon_rule(epsilon)
    if not fits:
        raise ConfigurationError(f"epsilon is {epsilon}; it must be {rule}.")


def kl_from_uniform(weights: FloatArray) -> float:
    """Return KL(weights || uniform) in nats.

    :param weights: >= 0, they add up to 1, shape (N,)
    """
    positive = weights[weights > 0]
    return float(positive @ np.log(positive * len(weights)))
