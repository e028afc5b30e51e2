"""`MomentRegression`: one robot's joints by regression on another's at the same moment.

Shape letters: N proxy skills, T time points, D joints, F features.
"""

from dataclasses import dataclass
from itertools import product
from typing import Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError
from sb3_nmp.common.finite_arrays import finite_array
from sb3_nmp.common.resampling import resample
from sb3_nmp.transfer.proxy_skills import ProxySkills

FloatArray = NDArray[np.float64]
PENALTIES = (1e-6, 1e-4, 1e-2, 1.0)  # on squared coefficients, beside the mean squared error


@dataclass(frozen=True)
class Function:
    """What a target's joints are in those of the source.

    :param is_quadratic: whether products of two inputs count, or the inputs alone
    :param sees_time: whether time is an input beside the joints
    :param penalty: on the squared coefficients
    """

    is_quadratic: bool
    sees_time: bool
    penalty: float


class MomentRegression:
    """Regression of a robot's joints on another's at the same moment, linear or quadratic.

    The twin of `SkillTransfer`, its networks taken out. Whether the function is quadratic and sees
    the time, and its penalty, are chosen by the error on skills that were left out, one at a time.

    >>> heights = np.linspace(-1, 1, 6)[:, None, None]
    >>> time = np.linspace(0, 1, 20)[:, None]
    >>> one = Demonstrations(heights[:, 0], heights * time)
    >>> two = Demonstrations(heights[:, 0], heights * np.hstack([time, -2 * time]))
    >>> MomentRegression(one, two).fit().translate(0.5 * time)[-1].round(3).tolist()
    [0.5, -1.0]

    :param source: proxy skills shown by one robot
    :param target: the same skills shown by the other, in the same order
    :raises ConfigurationError: ``source`` or ``target`` is no `Demonstrations`
    :raises InvalidDataError: the robots show different skills, or in another order
    """

    def __init__(self, source: Demonstrations, target: Demonstrations) -> None:
        self.skills = ProxySkills(source, target)
        self.n_time_points = target.trajectory_shape[0]
        self.function: Function | None = None
        self._coefficients = np.empty((0, 0))
        self._shown = self._resampled(source.trajectories)
        points = self._shown.reshape(-1, source.trajectory_shape[1])
        std = points.std(axis=0)
        self._scale = points.mean(axis=0), np.where(std > 1e-9, std, 1.0)
        self._middle = target.trajectories.mean(axis=(0, 1), dtype=np.float64)

    def fit(self) -> Self:
        """Choose the function, and fit it to all proxy skills."""
        targets = self.skills.target.trajectories.astype(np.float64) - self._middle
        found = []
        for is_quadratic, sees_time in product((False, True), repeat=2):
            inputs = self._features(self._shown, is_quadratic, sees_time)
            grams = np.einsum("ntf,ntg->nfg", inputs, inputs) / len(inputs[0])
            products = np.einsum("ntf,ntd->nfd", inputs, targets) / len(inputs[0])
            for penalty in PENALTIES:
                error = _left_out_error(inputs, targets, grams, products, penalty)
                fitted = _solve(grams.mean(axis=0), products.mean(axis=0), penalty)
                found.append((error, Function(is_quadratic, sees_time, penalty), fitted))
        _, self.function, self._coefficients = min(found, key=lambda each: each[0])
        return self

    @overload
    def translate(self, shown: Demonstrations) -> Demonstrations: ...
    @overload
    def translate(self, shown: ArrayLike) -> FloatArray: ...
    def translate(self, shown: Demonstrations | ArrayLike) -> Demonstrations | FloatArray:
        """Return what the source showed as trajectories of the target.

        :param shown: shape (N, O, D) or (O, D), at equal distances in time; or `Demonstrations`
        :return: shape (N, T, D), or (T, D) for one; or `Demonstrations` for these
        :raises ConfigurationError: `fit` has not been called
        :raises InvalidDataError: a wrong shape, or a value that is not finite
        """
        if self.function is None:
            raise ConfigurationError("nothing has been fitted; call fit() first.")
        if isinstance(shown, Demonstrations):
            return Demonstrations(shown.contexts, self.translate(shown.trajectories))
        is_one = np.ndim(shown) == 2
        given = np.asarray(shown)[None] if is_one else shown
        rows = finite_array("trajectories", given, "(N, O, D) or (O, D)", 3)
        n_joints = len(self._scale[0])
        if rows.shape[2] != n_joints:
            raise InvalidDataError(
                f"the trajectories have {rows.shape[2]} joints; the source robot has {n_joints}."
            )
        function, resampled = self.function, self._resampled(rows)
        inputs = self._features(resampled, function.is_quadratic, function.sees_time)
        answers = self._middle + inputs @ self._coefficients
        return answers[0] if is_one else answers

    def _resampled(self, trajectories: NDArray[np.floating]) -> FloatArray:
        return resample(list(trajectories), self.n_time_points)

    def _features(
        self, trajectories: FloatArray, is_quadratic: bool, sees_time: bool
    ) -> FloatArray:
        """Return what the target is linear in, shape (N, T, F)."""
        middle, unit = self._scale
        inputs = (trajectories - middle) / unit
        if sees_time:
            time = np.linspace(-1.0, 1.0, inputs.shape[1])[:, None]
            inputs = np.concatenate([inputs, np.tile(time, (len(inputs), 1, 1))], axis=2)
        parts = [np.ones((*inputs.shape[:2], 1)), inputs]
        if is_quadratic:
            one, other = np.triu_indices(inputs.shape[2])
            parts.append(inputs[..., one] * inputs[..., other])
        return np.concatenate(parts, axis=2)


def _solve(gram: FloatArray, products: FloatArray, penalty: float) -> FloatArray:
    return np.asarray(np.linalg.solve(gram + penalty * np.eye(len(gram)), products), np.float64)


def _left_out_error(
    inputs: FloatArray,
    targets: FloatArray,
    grams: FloatArray,
    products: FloatArray,
    penalty: float,
) -> float:
    """Return the mean squared error of each skill, predicted from the others."""
    n, errors = len(inputs), []
    for row in range(n):
        gram, right = ((parts.sum(axis=0) - parts[row]) / (n - 1) for parts in (grams, products))
        errors.append(np.mean((inputs[row] @ _solve(gram, right, penalty) - targets[row]) ** 2))
    return float(np.mean(errors))
