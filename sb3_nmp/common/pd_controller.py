"""The PD controller through which RC-NMP executes its trajectories (thesis Eq. 6.3)."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.settings import Rules, Settings, settings_name


@settings_name("pd-controller")
@dataclass(frozen=True)
class PDController(Settings):
    """Makes a desired trajectory smooth and pulls its end to the goal.

    Eq. 6.3, with the goal g, the desired trajectory tau and the position x::

        u(t) = Kp e(t) - Kd de(t)/dt
        e(t) = lambda1(t) (g - x(t)) + lambda2(t) (tau(t) - x(t))

    with lambda1 = 3 t^20 and lambda2 = 1 - t^20 for t in [0, 1]. As in the original code, de/dt is
    the difference of successive errors, and x moves by ``duration * u / (T - 1)`` per time point;
    in several shorter steps where time points are so few that it would oscillate. Since x is linear
    in (tau, g, x(0)), a whole batch is filtered by one matrix product.

    >>> straight = np.linspace([0.0, 0.0], [1.0, 2.0], 200)
    >>> PDController()(straight[None], straight[0], straight[-1])[0, -1].round(2).tolist()
    [1.0, 2.0]

    :param kp: proportional gain Kp
    :param kd: gain Kd on the error's difference
    :param duration: of the trajectory, in s
    :raises ConfigurationError: a value outside its range
    """

    kp: float = 3.0
    kd: float = 1.0
    duration: float = 10.0

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {
            "kp": (self.kp > 0, "> 0"),
            "kd": (self.kd >= 0, ">= 0"),
            "duration": (self.duration > 0, "> 0"),
        }

    @property
    def longest_step(self) -> float:
        """The step in s below which its error fades.

        With steps of length s, and lambda2 = 1, the error of a tau at rest is
        ``e(k + 1) = (1 - s kp + s kd) e(k) - s kd e(k - 1)``. It fades if s kd < 1 and
        s kp < 2 + 2 s kd (Jury's criterion).

        >>> PDController(kp=3.0, kd=1.0).longest_step, PDController(kp=4.0, kd=0.0).longest_step
        (1.0, 0.5)
        """
        by_change = 1.0 / self.kd if self.kd > 0 else np.inf
        by_error = 2.0 / (self.kp - 2 * self.kd) if self.kp > 2 * self.kd else np.inf
        return min(by_change, by_error)

    def __call__(
        self, desired: NDArray[np.float64], start: NDArray[np.float64], goal: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return what the controller makes of desired trajectories, shape (N, T, D).

        :param desired: tau, shape (N, T, D)
        :param start: x(0), shape (D,)
        :param goal: g, shape (D,)
        :raises ConfigurationError: a single time point
        """
        from_desired, from_start, from_goal = _response(self, desired.shape[1])
        return from_desired @ desired + from_start * start + from_goal * goal


@lru_cache(maxsize=16)
def _response(
    pd: PDController, n: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return A (T, T), b (T, 1), c (T, 1) of x = A tau + b x(0) + c g, by running unit inputs."""
    if n < 2:
        raise ConfigurationError(
            "trajectories have a single time point, which no controller can smooth: give "
            "pd_controller=None."
        )
    step = pd.duration / (n - 1)
    n_parts = 1 if step < 0.6 * pd.longest_step else int(np.ceil(2 * step / pd.longest_step))
    size = (n - 1) * n_parts + 1
    step, times = step / n_parts, np.linspace(0.0, 1.0, size)
    inputs = np.zeros((size, n + 2))  # columns: tau at each time point, then x(0), then g
    at, known = np.arange(size), n_parts * np.arange(n)
    inputs[:, :n] = np.stack([np.interp(at, known, unit) for unit in np.eye(n)], axis=1)
    goal = np.zeros(n + 2)
    goal[n + 1] = 1.0
    x = np.zeros((size, n + 2))
    x[0, n] = 1.0
    previous: NDArray[np.float64] | None = None
    for k in range(size - 1):
        lambda1, lambda2 = 3 * times[k] ** 20, 1 - times[k] ** 20
        error = lambda1 * (goal - x[k]) + lambda2 * (inputs[k] - x[k])
        change = error - (error if previous is None else previous)
        x[k + 1] = x[k] + step * (pd.kp * error - pd.kd * change)
        previous = error
    x = x[::n_parts]
    return x[:, :n].copy(), x[:, n : n + 1].copy(), x[:, n + 1 :].copy()
