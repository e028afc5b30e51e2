"""`DMP`: dynamical movement primitives (Ijspeert et al. 2013, Eq. 2.1)."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from baselines.primitives.primitive import FloatArray, Primitive, Response
from sb3_nmp.common.settings import settings_name


@settings_name("dmp")
@dataclass(frozen=True)
class DMP(Primitive):
    """A spring-damper system that a learnt force bends on its way from the start to the goal.

    With time scaled to [0, 1]::

        d2y/dt2 = alpha (beta (g - y) - dy/dt) + f(z),    dz/dt = -alpha_z z,    z(0) = 1
        f(z) = z sum_k psi_k(z) w_k / sum_k psi_k(z)

    The force is not scaled by (g - y0), which is 0 in a dimension where start and goal agree.
    It starts at rest. Since y is linear in (w, y0, g), the system is integrated (fourth-order
    Runge-Kutta) once, on unit inputs.

    Ijspeert, Nakanishi, Hoffmann, Pastor and Schaal, "Dynamical movement primitives: learning
    attractor models for motor behaviors", 2013.

    >>> dmp = DMP(n_bases=5, n_time_points=100)
    >>> path = dmp.trajectories(np.zeros((1, 5, 2)), start=[0.0, 0.0], goal=[1.0, 2.0])[0]
    >>> path[0].tolist(), path[-1].round(1).tolist()
    ([0.0, 0.0], [1.0, 2.0])

    :param n_bases: K, evenly spaced in time
    :param n_time_points: T
    :param alpha: stiffness of the transformation system
    :param beta: of the transformation system; critical damping by default: alpha / 4
    :param final_phase: z(1)
    :param overlap: a basis's value at the centre of the next one
    :raises ConfigurationError: a value outside its range
    """

    n_bases: int = 10
    n_time_points: int = 200
    alpha: float = 25.0
    beta: float = 6.25
    final_phase: float = 0.01
    overlap: float = 0.8

    def __post_init__(self) -> None:
        """Check the values."""
        self.check()
        for name, high in (("alpha", np.inf), ("beta", np.inf), ("final_phase", 1), ("overlap", 1)):
            self.check_number(name, 0.0, high)

    def response(self) -> Response:
        """Return the system's response to unit weights, start and goal."""
        return _response(self)

    def phase(self, times: FloatArray) -> FloatArray:
        """Return z, the canonical system's state, shape of ``times``.

        :param times: in [0, 1]
        """
        return self.final_phase**times

    def forces(self, times: FloatArray) -> FloatArray:
        """Return the force of each unit weight, shape (O, K).

        :param times: in [0, 1], shape (O,)
        """
        centres = self.phase(np.linspace(0.0, 1.0, self.n_bases))
        gaps = np.diff(centres)
        widths = -math.log(self.overlap) / np.append(gaps, gaps[-1]) ** 2
        z = self.phase(times)[:, None]
        exponent = -widths * (z - centres) ** 2
        psi = np.exp(exponent - exponent.max(axis=1, keepdims=True))
        return z * psi / psi.sum(axis=1, keepdims=True)


@lru_cache(maxsize=16)
def _response(dmp: DMP) -> Response:
    """Integrate the system on unit inputs: K weights, the start, the goal."""
    n, k = dmp.n_time_points, dmp.n_bases
    step = 1.0 / (n - 1)
    forces = np.zeros((2 * n - 1, k + 2))  # at the time points and half-way between them
    forces[:, :k] = dmp.forces(np.linspace(0.0, 1.0, 2 * n - 1))
    forces[:, k + 1] = dmp.alpha * dmp.beta  # the pull of the goal

    def derivative(state: FloatArray, force: FloatArray) -> FloatArray:
        position, velocity = state
        return np.stack([velocity, force - dmp.alpha * (dmp.beta * position + velocity)])

    state = np.zeros((2, k + 2))  # position, velocity
    state[0, k] = 1.0
    path = [state[0]]
    for i in range(n - 1):
        before, middle, after = forces[2 * i], forces[2 * i + 1], forces[2 * i + 2]
        k1 = derivative(state, before)
        k2 = derivative(state + step / 2 * k1, middle)
        k3 = derivative(state + step / 2 * k2, middle)
        k4 = derivative(state + step * k3, after)
        state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        path.append(state[0])
    x = np.stack(path)
    return Response(x[:, :k].copy(), x[:, k : k + 1].copy(), x[:, k + 1 :].copy())
