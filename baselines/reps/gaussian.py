"""Gaussians whose mean is linear in features of the context: densities and weighted fits.

Shape letters: N samples, P parameters, F features (a constant 1 first, then the context).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.common.settings import saved_state, settings_name

FloatArray = NDArray[np.float64]

SLOPE_RIDGE = 0.1  # prior strength of "the mean does not depend on the context"


@saved_state("linear-gaussian")
@dataclass(frozen=True)
class LinearGaussian:
    """N(features @ coefficients, covariance).

    :param coefficients: shape (F, P)
    :param covariance: shape (P, P)
    """

    coefficients: FloatArray
    covariance: FloatArray

    def log_density(self, samples: FloatArray, features: FloatArray) -> FloatArray:
        """Return the log-density of each sample, shape (N,).

        :param samples: shape (N, P)
        :param features: shape (N, F)
        """
        factor = np.linalg.cholesky(self.covariance)
        scaled = np.linalg.solve(factor, (samples - features @ self.coefficients).T)
        log_determinant = 2 * np.log(np.diag(factor)).sum()
        constant = samples.shape[1] * np.log(2 * np.pi)
        return -0.5 * (np.sum(scaled**2, axis=0) + log_determinant + constant)

    def entropy(self) -> float:
        """Return the differential entropy in nats."""
        p = len(self.covariance)
        return float(0.5 * (p * np.log(2 * np.pi * np.e) + np.linalg.slogdet(self.covariance)[1]))

    def kl(self, other: "LinearGaussian", features: FloatArray) -> float:
        """Return KL(self || other) in nats, as a mean over contexts.

        :param other: of the same parameters
        :param features: of the contexts, shape (N, F)
        """
        p = len(self.covariance)
        difference = features @ (self.coefficients - other.coefficients)
        distance = np.sum(difference * np.linalg.solve(other.covariance, difference.T).T, axis=1)
        trace = np.trace(np.linalg.solve(other.covariance, self.covariance))
        log_determinants = (
            np.linalg.slogdet(other.covariance)[1] - np.linalg.slogdet(self.covariance)[1]
        )
        return float(0.5 * (trace - p + log_determinants + distance.mean()))


def weighted_regression(
    targets: FloatArray, features: FloatArray, weights: FloatArray
) -> FloatArray:
    """Return coefficients that predict targets from features, shape (F, P).

    The constant is free, the slopes are pulled to 0 by a ridge; where the context does not vary,
    they are 0 and the constant is the weighted mean.

    :param targets: shape (N, P)
    :param features: first column 1, the others of the order of 1, shape (N, F)
    :param weights: >= 0, they add up to 1, shape (N,)
    """
    centre, middle = weights @ features[:, 1:], weights @ targets
    deviations = features[:, 1:] - centre
    weighted = deviations * weights[:, None]
    gram = weighted.T @ deviations
    ridge = SLOPE_RIDGE * np.sum(weights**2) * np.eye(len(gram))
    slopes = np.linalg.solve(gram + ridge, weighted.T @ (targets - middle))
    return np.concatenate([(middle - centre @ slopes)[None], slopes]).astype(np.float64)


@settings_name("reps-fit")
@dataclass(frozen=True)
class FitSettings:
    """How a Gaussian is fitted to few weighted samples without collapsing.

    :param step: from the old mean to the fitted one; 1 takes the fit
    :param shrinkage: of the correlations: 0 keeps the fitted ones, 1 drops them (a diagonal)
    :param floor: standard deviation that is added (in quadrature) to each parameter's, shape (P,)
    """

    step: float
    shrinkage: float
    floor: FloatArray


def weighted_fit(
    samples: FloatArray,
    features: FloatArray,
    weights: FloatArray,
    old: LinearGaussian,
    settings: FitSettings,
) -> LinearGaussian:
    """Return the Gaussian of largest weighted likelihood, regularised.

    :param samples: shape (N, P)
    :param features: shape (N, F)
    :param weights: >= 0, they add up to 1, shape (N,)
    :param old: the Gaussian that is replaced; its slopes are kept where the context is constant
    :param settings: of the regularisation
    """
    residuals = samples - features @ old.coefficients
    change = weighted_regression(residuals, features, weights)
    residuals = residuals - features @ change
    covariance = (residuals * weights[:, None]).T @ residuals
    variances = np.diag(covariance)
    covariance = (1 - settings.shrinkage) * covariance + settings.shrinkage * np.diag(variances)
    return LinearGaussian(
        old.coefficients + settings.step * change, covariance + np.diag(settings.floor**2)
    )
