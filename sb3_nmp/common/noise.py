"""Smooth exploration noise: random low-frequency deviations of a trajectory."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.common.settings import Rules, Settings, settings_name

LEAST_WIDTH = 0.05  # of a basis, in units of the bases' spacing


@settings_name("smooth-noise")
@dataclass(frozen=True)
class SmoothNoise(Settings):
    """Gaussian noise over a trajectory whose values at neighbouring times are correlated.

    A weighted sum of Gaussian bases over time with normal weights, scaled so that the standard
    deviation is ``sigma`` at every time point (thesis 6.1, mutation, "smoothed Gaussian noise").
    Few wide bases bend the whole path; the original code's 20 knots only roughen it.

    >>> noise = SmoothNoise(sigma=0.1, n_bases=5)
    >>> noise.sample(np.random.default_rng(0), n=3, shape=(200, 2)).shape
    (3, 200, 2)

    :param sigma: standard deviation, one value or one per dimension: in the trajectory's unit, or,
        where an algorithm is given the noise, in units of its ``exploration_scale``
    :param n_bases: how many bases, evenly spaced over [0, 1]
    :param width: standard deviation of a basis, in units of the bases' spacing
    :raises ConfigurationError: a value outside its range
    """

    sigma: float | tuple[float, ...] = 1.0
    n_bases: int = 10
    width: float = 1.0

    def rules(self) -> Rules:
        """Return the rules of the values."""
        sigma = np.asarray(self.sigma)
        return {
            "sigma": (bool(np.all((sigma >= 0) & np.isfinite(sigma))), "finite and >= 0"),
            "n_bases": (self.n_bases >= 2, "a whole number, and at least 2"),
            "width": (
                LEAST_WIDTH <= self.width < np.inf,
                f"> 0, and at least {LEAST_WIDTH}: narrower bases leave gaps between them. 1 is "
                "usual",
            ),
        }

    def bases(self, n_time_points: int) -> NDArray[np.float64]:
        """Return the bases, rows of unit length, shape (T, n_bases).

        :param n_time_points: T
        """
        time = np.linspace(0.0, 1.0, n_time_points)[:, None]
        centres = np.linspace(0.0, 1.0, self.n_bases)
        distance = (time - centres) * (self.n_bases - 1) / self.width
        bases = np.exp(-0.5 * distance**2)
        return bases / np.linalg.norm(bases, axis=1, keepdims=True)

    def sample(
        self, rng: np.random.Generator, n: int, shape: tuple[int, int], rate: float = 1.0
    ) -> NDArray[np.float64]:
        """Draw n noise trajectories, shape (n, T, D).

        :param rng: the generator to draw from
        :param n: how many
        :param shape: (T, D)
        :param rate: probability with which each basis takes part; below 1, a noise trajectory
            leaves parts of the path as they are
        """
        weights = rng.standard_normal((n, self.n_bases, shape[1]))
        weights *= rng.uniform(size=(n, self.n_bases, 1)) < rate
        return np.asarray(self.sigma) * (self.bases(shape[0]) @ weights)
