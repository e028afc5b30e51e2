"""Regression on contexts, in the place of a network: what the twins of our methods answer by.

Shape letters: M known contexts, N asked ones, C context, P values in each.
"""

from collections.abc import Callable
from typing import Any, Literal, cast, get_args

import numpy as np
import torch as th
from numpy.typing import NDArray

from sb3_nmp.common.exceptions import ConfigurationError

FloatArray = NDArray[np.float64]
#: how contexts are answered: by the nearest one, a linear or a quadratic function, or by processes
Regression = Literal["nearest", "ridge", "quadratic", "gaussian-process"]
#: from contexts, shape (N, C), to values, shape (N, P)
Answer = Callable[[FloatArray], FloatArray]

RIDGE = 0.3  # of the slopes, contexts having a standard deviation of 1
#: penalties on slopes, of which `least_error_penalty` takes one
PENALTIES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1000.0)
NEWEST = 600  # contexts that a Gaussian process sees at most
LENGTHS = (0.3, 0.5, 0.8, 1.2, 2.0, 3.0, 5.0, 8.0)  # of its kernel, to choose from by evidence
NOISES = (1e-4, 1e-3, 1e-2, 0.1, 0.3, 1.0)  # variances, as shares of the kernel's


def check_regression(name: str) -> None:
    """Raise for a regression that does not exist.

    :param name: of the regression
    :raises ConfigurationError: there is none of that name
    """
    if name not in get_args(Regression):
        raise ConfigurationError(
            f"no regression '{name}'; there are {', '.join(get_args(Regression))}."
        )


def fit(regression: Regression, contexts: FloatArray, values: FloatArray) -> Answer:
    """Return what answers contexts by regression on known ones.

    >>> known = np.array([[0.0], [1.0], [2.0]])
    >>> fit("nearest", known, known**2)(np.array([[1.8]])).tolist()
    [[4.0]]
    >>> fit("ridge", known, 2 * known)(np.array([[1.0]])).round(6).tolist()
    [[2.0]]

    :param regression: which one
    :param contexts: the known ones, shape (M, C)
    :param values: theirs, shape (M, P)
    """
    std = contexts.std(axis=0)
    std = np.where(std > 1e-9, std, 1.0)
    known = contexts / std
    if regression == "nearest":
        answer = nearest(known, values)
    elif regression == "ridge":
        answer = ridge(known, values)
    elif regression == "quadratic":
        answer = quadratic(known, values)
    else:
        answer = gaussian_process(known[-NEWEST:], values[-NEWEST:])
    return lambda asked: answer(np.asarray(asked, np.float64) / std)


class Refitted:
    """A regression on what is known, fitted when it is first asked after that has changed.

    >>> regression, known = Refitted("nearest"), th.tensor([[0.0], [1.0]])
    >>> values = 4 * known
    >>> regression.on(known, values)(np.array([[0.9]])).tolist()
    [[4.0]]
    >>> regression.on(known, values) is regression.on(known, values)
    True

    :param regression: which one
    :raises ConfigurationError: there is no such regression
    """

    def __init__(self, regression: Regression) -> None:
        check_regression(regression)
        self.regression: Regression = regression
        self._fitted: tuple[th.Tensor, Answer] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: functions that answer are fitted again."""
        return {"regression": self.regression, "_fitted": None}

    def on(self, contexts: th.Tensor, values: th.Tensor) -> Answer:
        """Return what answers contexts.

        :param contexts: the known ones, shape (M, C)
        :param values: theirs, shape (M, ...), which the answers have flat; fitted again where it is
            another tensor than before: learned or loaded since
        """
        if self._fitted is None or self._fitted[0] is not values:
            rows, flat = contexts.cpu().numpy(), values.flatten(1).cpu().numpy()
            self._fitted = values, fit(self.regression, rows, flat)
        return self._fitted[1]


def nearest(known: FloatArray, values: FloatArray) -> Answer:
    """Return what answers with the values of the nearest known context.

    :param known: contexts with a standard deviation of 1, shape (M, C)
    :param values: theirs, shape (M, P)
    """
    return lambda asked: values[np.square(asked[:, None] - known).sum(axis=2).argmin(axis=1)]


def ridge(known: FloatArray, values: FloatArray) -> Answer:
    """Return what answers linearly in the context.

    :param known: contexts with a standard deviation of 1, shape (M, C)
    :param values: theirs, shape (M, P)
    """
    centre, middle, slopes = linear_regression(known, values, RIDGE)
    return lambda asked: middle + (asked - centre) @ slopes


def linear_regression(
    known: FloatArray, values: FloatArray, penalty: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a ridge regression: middle + (asked - centre) @ slopes.

    :param known: contexts with a standard deviation of 1, shape (M, C)
    :param values: theirs, shape (M, P)
    :param penalty: on the squared slopes
    :return: centre, shape (C,), middle, shape (P,), and slopes, shape (C, P)
    """
    centre, middle = known.mean(axis=0), values.mean(axis=0)
    rows = known - centre
    slopes = np.linalg.solve(_gram(rows, penalty), rows.T @ (values - middle))
    return centre, middle, slopes


def _gram(rows: FloatArray, penalty: float) -> FloatArray:
    """Return the matrix of the normal equations of a ridge regression, shape (C, C)."""
    return rows.T @ rows + penalty * np.eye(rows.shape[1])


def least_error_penalty(known: FloatArray, values: FloatArray) -> float:
    """Return the penalty of `linear_regression` with the least leave-one-out error.

    >>> rng = np.random.default_rng(0)
    >>> known = rng.normal(size=(20, 2))
    >>> least_error_penalty(known, known), least_error_penalty(known, rng.normal(size=(20, 2)))
    (0.1, 1000.0)

    :param known: contexts with a standard deviation of 1, shape (M, C)
    :param values: theirs, shape (M, P)
    """
    return min(PENALTIES, key=lambda penalty: leave_one_out_error(known, values, penalty))


def leave_one_out_error(known: FloatArray, values: FloatArray, penalty: float) -> float:
    """Return the mean squared error of each row, predicted by `linear_regression` on the others.

    Of least squares these errors are known from one fit: its own by one minus the row's leverage.
    With a penalty it is so but for the centre, which is that of all rows.

    :param known: contexts with a standard deviation of 1, shape (M, C)
    :param values: theirs, shape (M, P)
    :param penalty: on the squared slopes
    """
    centre, middle, slopes = linear_regression(known, values, penalty)
    rows = known - centre
    inverse = np.linalg.inv(_gram(rows, penalty))
    leverage = 1 / len(rows) + np.einsum("mc,mc->m", rows @ inverse, rows)
    errors = (values - middle - rows @ slopes) / np.maximum(1.0 - leverage, 1e-3)[:, None]
    return float(np.mean(errors**2))


def quadratic(known: FloatArray, values: FloatArray) -> Answer:
    """Return what answers linearly in the context's entries and their products, of two each.

    :param known: contexts with a standard deviation of 1, shape (M, C)
    :param values: theirs, shape (M, P)
    """
    centre = known.mean(axis=0)
    one, other = np.triu_indices(known.shape[1])

    def features(contexts: FloatArray) -> FloatArray:
        rows = contexts - centre
        return np.column_stack([rows, rows[:, one] * rows[:, other]])

    answer = ridge(features(known), values)
    return lambda asked: answer(features(asked))


def gaussian_process(known: FloatArray, values: FloatArray) -> Answer:
    """Return what answers with the mean of Gaussian processes, with one kernel for all values.

    Length scale and noise are those of largest marginal likelihood.

    :param known: contexts with a standard deviation of 1, shape (M, C)
    :param values: theirs, shape (M, P)
    """
    middle = values.mean(axis=0)
    centred = values - middle
    squares = np.square(known[:, None] - known).sum(axis=2)
    best: tuple[float, float, FloatArray] | None = None
    for length in LENGTHS:
        eigenvalues, axes = np.linalg.eigh(np.exp(-0.5 * squares / length**2))
        seen = axes.T @ centred
        for noise in NOISES:
            spread = np.maximum(eigenvalues, 0.0) + noise
            misfit = float((np.square(seen).sum(axis=1) / spread).sum()) / centred.size
            surprise = np.log(max(misfit, 1e-12)) + np.log(spread).sum() / len(centred)
            if best is None or surprise < best[0]:
                best = (float(surprise), length, axes @ (seen / spread[:, None]))
    _, length, factors = cast(tuple[float, float, FloatArray], best)

    def answer(asked: FloatArray) -> FloatArray:
        cross = np.square(asked[:, None] - known).sum(axis=2)
        return middle + np.exp(-0.5 * cross / length**2) @ factors

    return answer
