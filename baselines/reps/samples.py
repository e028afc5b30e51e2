"""`Samples`: what REPS and DREPS learn from."""

from dataclasses import dataclass, fields

import numpy as np

from baselines.reps.gaussian import FloatArray, weighted_regression
from sb3_nmp.common.settings import saved_state


@saved_state("reps-samples")
@dataclass(frozen=True)
class Samples:
    """Weights of a movement primitive that were tried, and their rewards.

    :param weights: flattened, shape (N, P)
    :param features: of the contexts, shape (N, F)
    :param rewards: shape (N,)
    """

    weights: FloatArray
    features: FloatArray
    rewards: FloatArray

    @classmethod
    def concatenate(cls, parts: "list[Samples]") -> "Samples":
        """Return the samples of all parts, in their order.

        :param parts: at least one
        """
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))

    def advantages(self) -> FloatArray:
        """Return the rewards less what the context alone predicts, shape (N,).

        Without it an update would prefer easy contexts to good weights. A regression linear in the
        features stands for the value function of contextual REPS's dual, whose linear features it
        shares; where the context is constant, only the mean reward is subtracted, to which REPS
        is indifferent.
        """
        equal = np.full(len(self.rewards), 1 / len(self.rewards))
        coefficients = weighted_regression(self.rewards[:, None], self.features, equal)
        return self.rewards - (self.features @ coefficients)[:, 0]
