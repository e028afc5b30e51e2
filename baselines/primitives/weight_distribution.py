"""`WeightDistribution`: a Gaussian over the weights of a movement primitive."""

from dataclasses import dataclass

import numpy as np

from baselines.primitives.primitive import FloatArray
from sb3_nmp.common.exceptions import InvalidDataError


@dataclass(frozen=True)
class WeightDistribution:
    """Gaussian over weights; the entry (k, d) is at k * D + d in the flattened vector.

    >>> weights = WeightDistribution(np.zeros((5, 2)), np.eye(10))
    >>> weights.sample(np.random.default_rng(0), n=3).shape
    (3, 5, 2)

    :param mean: shape (K, D)
    :param covariance: of the flattened weights, shape (K D, K D)
    :raises InvalidDataError: the shapes do not fit
    """

    mean: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        """Check the shapes."""
        if self.covariance.shape != (self.mean.size, self.mean.size):
            raise InvalidDataError(
                f"the covariance has shape {self.covariance.shape}; {self.mean.size} weights need "
                f"({self.mean.size}, {self.mean.size})."
            )

    def sample(self, rng: np.random.Generator, n: int) -> FloatArray:
        """Draw n sets of weights, shape (n, K, D); the covariance may be singular.

        :param rng: the generator to draw from
        :param n: how many
        """
        values, vectors = np.linalg.eigh(self.covariance)
        factor = vectors * np.sqrt(np.maximum(values, 0.0))
        noise = rng.standard_normal((n, self.mean.size)) @ factor.T
        return self.mean + noise.reshape(n, *self.mean.shape)
