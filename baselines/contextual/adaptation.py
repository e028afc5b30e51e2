"""The update of contextual CMA-ES, as pure functions.

Abdolmaleki, Price, Lau, Reis and Neumann, "Contextual covariance matrix adaptation evolutionary
strategies", 2017. Shape letters: N samples, P parameters, F features of the mean, V of the value.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from baselines.contextual.features import FloatArray
from sb3_nmp.common.settings import saved_state

MAX_LOG_STEP = 0.6  # of the step size in one generation
#: of the value's regression: were it larger, the context would shine through the advantages
VALUE_RIDGE = 1e-8


@dataclass(frozen=True)
class Constants:
    """Learning rates and weights of an update.

    :param n_samples: N
    :param n_parameters: P
    :param context_dim: C
    """

    n_samples: int
    n_parameters: int
    context_dim: int

    @cached_property
    def weights(self) -> FloatArray:
        """Of the samples from the best to the worst, half of them 0, shape (N,)."""
        best = self.n_samples // 2
        weights = np.zeros(self.n_samples)
        weights[:best] = np.log(best + 0.5) - np.log(np.arange(1, best + 1))
        return weights / weights.sum()

    @property
    def mu(self) -> float:
        """Effective number of samples."""
        return float(1.0 / np.sum(self.weights**2))

    @property
    def _size(self) -> int:
        return self.n_parameters + self.context_dim

    @property
    def rank_one(self) -> float:
        """Share of the evolution path in the covariance, c_1."""
        return 2.0 / ((self._size + 1.3) ** 2 + self.mu)

    @property
    def rank_mu(self) -> float:
        """Share of the samples in the covariance, c_mu."""
        gain = 2.0 * (self.mu - 2.0 + 1.0 / self.mu) / ((self._size + 2.0) ** 2 + self.mu)
        return min(1.0 - self.rank_one, gain)

    @property
    def path(self) -> float:
        """Decay of the covariance's path, c_c."""
        ratio = self.mu / self._size
        return (4.0 + ratio) / (4.0 + self._size + 2.0 * ratio)

    @property
    def step_path(self) -> float:
        """Decay of the step size's path, c_sigma."""
        return (self.mu + 2.0) / (self._size + self.mu + 5.0)

    @property
    def damping(self) -> float:
        """Of the step size, d_sigma; more with more contexts."""
        ratio = np.sqrt(max((self.mu - 1.0) / (self._size + 1.0), 0.0)) - 1.0
        return 1.0 + 2.0 * max(0.0, ratio) + self.step_path + np.log(self.context_dim + 1.0)

    @property
    def expected_norm(self) -> float:
        """Expected length of a vector of P standard normal numbers."""
        p = self.n_parameters
        return float(np.sqrt(p) * (1.0 - 1.0 / (4.0 * p) + 1.0 / (21.0 * p**2)))


@saved_state("contextual-cmaes")
@dataclass(frozen=True)
class Strategy:
    """The search distribution N(features @ coefficients, step^2 covariance), and its paths.

    :param coefficients: shape (F, P)
    :param covariance: shape (P, P)
    :param step: sigma
    :param path: of the covariance, shape (P,)
    :param step_path: of the step size, shape (P,)
    :param generation: how many updates there were
    """

    coefficients: FloatArray
    covariance: FloatArray
    step: float = 1.0
    path: FloatArray = field(default_factory=lambda: np.empty(0))
    step_path: FloatArray = field(default_factory=lambda: np.empty(0))
    generation: int = 0

    def __post_init__(self) -> None:
        """Begin paths at 0."""
        for name in ("path", "step_path"):
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.zeros(len(self.covariance)))


@dataclass(frozen=True)
class Tried:
    """A generation.

    :param parameters: shape (N, P)
    :param features: of the contexts, for the mean, shape (N, F)
    :param value_features: of the contexts, for the value, shape (N, V)
    :param rewards: shape (N,)
    """

    parameters: FloatArray
    features: FloatArray
    value_features: FloatArray
    rewards: FloatArray


def ridge_regression(
    targets: FloatArray, features: FloatArray, weights: FloatArray, ridge: float
) -> FloatArray:
    """Return coefficients of a weighted regression, shape (F, P).

    :param targets: shape (N, P)
    :param features: shape (N, F)
    :param weights: >= 0, they add up to 1, shape (N,)
    :param ridge: penalty on the squared coefficients
    """
    weighted = features * weights[:, None]
    gram = features.T @ weighted + ridge * np.eye(features.shape[1])
    return np.asarray(np.linalg.solve(gram, weighted.T @ targets), np.float64)


def advantages(tried: Tried) -> FloatArray:
    """Return the rewards less what the contexts let expect, shape (N,).

    :param tried: a generation
    """
    n = len(tried.rewards)
    spread = max(float(tried.rewards.std()), 1e-12)
    standard = (tried.rewards - tried.rewards.mean()) / spread
    equal = np.full(n, 1.0 / n)
    value = ridge_regression(standard[:, None], tried.value_features, equal, VALUE_RIDGE)
    return standard - (tried.value_features @ value)[:, 0]


def adapt(strategy: Strategy, tried: Tried, constants: Constants, ridge: float) -> Strategy:
    """Return the strategy after a generation.

    :param strategy: that drew the generation
    :param tried: the generation
    :param constants: learning rates
    :param ridge: of the mean's regression; it pulls the mean's change to 0
    """
    k, old = constants, strategy
    order = np.argsort(-advantages(tried), kind="stable")
    weights = np.empty(len(order))
    weights[order] = k.weights
    deviations = tried.parameters - tried.features @ old.coefficients
    change = ridge_regression(deviations, tried.features, weights, ridge)
    moved = tried.features.mean(axis=0) @ change / old.step
    step_path = (1.0 - k.step_path) * old.step_path + np.sqrt(
        k.step_path * (2.0 - k.step_path) * k.mu
    ) * (inverse_root(old.covariance) @ moved)
    length, generation = float(np.linalg.norm(step_path)), old.generation + 1
    stationary = 1.0 - (1.0 - k.step_path) ** (2 * generation)
    p = k.n_parameters
    # with the root, as BOLeRo has it; Hansen's rule for a squared length has none
    is_short = float(length**2 / p / np.sqrt(stationary) < 2.0 + 4.0 / (p + 1.0))
    path = (1.0 - k.path) * old.path
    path = path + is_short * np.sqrt(k.path * (2.0 - k.path) * k.mu) * moved
    noise = deviations / old.step
    of_samples = (noise * weights[:, None]).T @ noise
    kept = 1.0 - k.rank_mu - k.rank_one * (1.0 - (1.0 - is_short) * k.path * (2.0 - k.path))
    covariance = kept * old.covariance + k.rank_mu * of_samples
    covariance = covariance + k.rank_one * np.outer(path, path)
    grown = k.step_path / k.damping * (length / k.expected_norm - 1.0)
    return replace(
        old,
        coefficients=old.coefficients + change,
        covariance=(covariance + covariance.T) / 2.0,
        step=old.step * float(np.exp(min(MAX_LOG_STEP, grown))),
        path=path,
        step_path=step_path,
        generation=generation,
    )


def inverse_root(matrix: FloatArray) -> FloatArray:
    """Return the symmetric inverse square root of a covariance, shape (P, P).

    :param matrix: symmetric, positive definite
    """
    values, axes = np.linalg.eigh(matrix)
    return (axes / np.sqrt(np.maximum(values, 1e-20))) @ axes.T
