"""`TrajectoryDistribution`: what ACNMP's network expects, and how sure it is of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.common.exceptions import ConfigurationError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class TrajectoryDistribution:
    """A Gaussian at each time, and what each member of an ensemble expects; E members.

    Shapes are (T, D), or (N, T, D) for several contexts; all in the trajectory's unit.

    :param mean: the answer, inside the action space
    :param aleatoric_std: spread of the demonstrations around it, as the network has learned it
    :param member_means: of each member, shape (E, T, D) or (E, N, T, D)
    """

    mean: FloatArray
    aleatoric_std: FloatArray
    member_means: FloatArray

    @property
    def epistemic_std(self) -> FloatArray:
        """Spread of the members' means: what the demonstrations leave open.

        :raises ConfigurationError: there is one member
        """
        if len(self.member_means) == 1:
            raise ConfigurationError(
                "n_members is 1, and one network has no epistemic spread; train an ensemble with "
                'policy_kwargs={"cnmp": CNMPArchitecture(n_members=5)}, or take aleatoric_std.'
            )
        return self.member_means.std(axis=0, ddof=1)

    def first(self) -> "TrajectoryDistribution":
        """Return that of the first of several contexts."""
        return TrajectoryDistribution(self.mean[0], self.aleatoric_std[0], self.member_means[:, 0])
