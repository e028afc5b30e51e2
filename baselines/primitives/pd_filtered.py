"""`PDFiltered`: a primitive executed through the PD controller of RC-NMP (thesis Eq. 6.3)."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from baselines.primitives.primitive import Primitive, Response
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.common.settings import settings_name


@settings_name("pd-filtered")
@dataclass(frozen=True)
class PDFiltered(Primitive):
    """What the PD controller makes of a primitive's trajectory: it ends near the goal.

    The controller is linear, so that the whole is a primitive again.

    >>> from baselines import ProMP
    >>> filtered = PDFiltered(ProMP(n_bases=5, n_time_points=200), PDController())
    >>> path = filtered.trajectories(np.zeros((1, 5, 1)), start=[0.0], goal=[1.0])[0]
    >>> path[[0, -1], 0].round().tolist()  # the goal pulls, whatever the weights are
    [0.0, 1.0]

    :param desired: the primitive that gives tau of Eq. 6.3
    :param controller: the PD controller
    """

    desired: Primitive
    controller: PDController

    @property
    def n_bases(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """K."""
        return self.desired.n_bases

    @property
    def n_time_points(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """T."""
        return self.desired.n_time_points

    def response(self) -> Response:
        """Return the controller's output for unit weights, start and goal."""
        return _response(self)


def bends(controller: PDController, directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what a controller makes of deviations from a trajectory, of the same size as before.

    Through the controller they vanish at start and goal. Together they keep their mean square over
    time, so that exploration is of the same scale with it and without it.

    :param controller: the PD controller
    :param directions: shape (n, T, D)
    :return: same shape
    """
    still = np.zeros(directions.shape[2])
    filtered = controller(directions, still, still)
    return filtered * np.sqrt(np.sum(directions**2) / np.sum(filtered**2))


@lru_cache(maxsize=16)
def _response(primitive: PDFiltered) -> Response:
    inner, k = primitive.desired.response(), primitive.n_bases
    desired = np.concatenate([inner.weights, inner.start, inner.goal], axis=1)
    start, goal = np.zeros(k + 2), np.zeros(k + 2)
    start[k] = goal[k + 1] = 1.0
    x = primitive.controller(desired[None], start, goal)[0]
    return Response(x[:, :k].copy(), x[:, k : k + 1].copy(), x[:, k + 1 :].copy())
