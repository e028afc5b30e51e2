"""`RepsSearch`: relative entropy policy search for a single context, by ask and tell."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.primitives import Primitive
from baselines.reps.dual import solve
from baselines.reps.gaussian import FitSettings, FloatArray, LinearGaussian, weighted_fit
from baselines.reps.samples import Samples
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import saved_state, settings_name


@settings_name("reps-search-settings")
@dataclass(frozen=True)
class RepsSettings:
    """Of `RepsSearch`.

    :param epsilon: bound on KL(weights of the samples || uniform), in nats
    :param sample_generations: generations whose samples an update uses
    :param fit: regularisation of the fitted Gaussian
    """

    epsilon: float
    sample_generations: int
    fit: FitSettings


@saved_state("reps-search")
class RepsSearch:
    """Searches the weights of a primitive from a given Gaussian on.

    :param primitive: whose weights are searched
    :param mean: of the first Gaussian, flattened weights, shape (P,)
    :param covariance: shape (P, P)
    :param settings: of the updates
    """

    def __init__(
        self,
        primitive: Primitive,
        mean: FloatArray,
        covariance: FloatArray,
        settings: RepsSettings,
    ) -> None:
        self.primitive, self.settings = primitive, settings
        self.gaussian = LinearGaussian(mean[None], covariance)
        self._asked: FloatArray | None = None
        self._samples: list[Samples] = []

    @property
    def mean(self) -> FloatArray:
        """The Gaussian's mean, flattened weights, shape (P,)."""
        return self.gaussian.coefficients[0]

    def ask(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return n trajectories to try, shape (n, T, D); a new search's first one is the mean's.

        :param n: how many
        :param rng: the generator to draw from
        """
        factor = np.linalg.cholesky(self.gaussian.covariance)
        self._asked = self.mean + rng.standard_normal((n, len(factor))) @ factor.T
        if not self._samples:
            self._asked[0] = self.mean
        return decode(self.primitive, self._asked)

    def tell(self, rollouts: Generation) -> None:
        """Take in rollouts; fit the Gaussian once they are those that were asked for.

        The samples of the last generations are weighted by exp(R / eta), with eta from the dual.

        :param rollouts: those of the last `ask` in their order, or others of this context, which
            count as samples of the next fit
        """
        asked, self._asked = self._asked, None
        weights = encode(self.primitive, rollouts.trajectories) if asked is None else asked
        new = Samples(weights, np.ones((len(weights), 1)), rollouts.rewards)
        self._samples = [*self._samples, new][-self.settings.sample_generations :]
        if asked is None:
            return
        samples = Samples.concatenate(self._samples)
        shares = solve(samples.rewards, self.settings.epsilon).weights
        self.gaussian = weighted_fit(
            samples.weights, samples.features, shares, self.gaussian, self.settings.fit
        )


#: Penalty on the weights, relative to the bases' mean square, when a primitive is fitted. Bases
#: that overlap would otherwise reproduce small details by large weights that alternate in sign,
#: which neither mix nor generalise over contexts.
RIDGE = 1e-3


def encode(primitive: Primitive, trajectories: NDArray[np.floating]) -> FloatArray:
    """Return the flattened weights that come nearest to trajectories, shape (N, P).

    :param primitive: without a start and goal of its own (a ProMP)
    :param trajectories: shape (N, T, D)
    """
    return np.stack([primitive.fit(trajectory, RIDGE).ravel() for trajectory in trajectories])


def decode(primitive: Primitive, weights: FloatArray) -> FloatArray:
    """Return the trajectories of flattened weights, shape (N, T, D).

    :param primitive: without a start and goal of its own (a ProMP)
    :param weights: shape (N, P)
    """
    shaped = weights.reshape(len(weights), primitive.n_bases, -1)
    nothing = np.zeros(shaped.shape[2])
    return primitive.trajectories(shaped, nothing, nothing)
