"""Gaussian processes from contexts to the weights of a movement primitive (scikit-learn).

All weights share one kernel: Matern 5/2 with one length scale per entry of the context (ARD), a
linear trend, without which a prediction beyond the data would fall back to their mean, and noise.
Contexts are centred and normalised by their standard deviation; weights are centred, and normalised
by one value per dimension of the trajectory, so that those that hardly vary (a common start) do not
decide on the kernel as much as the others. ``results/experiments/baselines_tuning.md`` has the
measurements. Shape letters: M data, N queries, C context, K bases, D dimensions, P = K D weights.
"""

import warnings
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import (
    ConstantKernel,
    DotProduct,
    Kernel,
    Matern,
    WhiteKernel,
)

from baselines.promp_rl.transfer import context_scale

FloatArray = NDArray[np.float64]

LENGTH_SCALES = (0.5, 100.0)  # in standard deviations of the contexts
#: variances, in units of the weights' mean variance in their dimension
SIGNALS = (0.01, 1000.0)
NOISES = (1e-6, 0.1)


def initial_parameters(context_dim: int) -> FloatArray:
    """Return the kernel's parameters before any fit, in logarithms, shape (C + 3,).

    :param context_dim: C
    """
    return np.asarray(_kernel(context_dim).theta, np.float64)


def fit_parameters(
    contexts: FloatArray, weights: FloatArray, n_dimensions: int, start: FloatArray
) -> FloatArray:
    """Return the kernel's parameters of largest marginal likelihood, in logarithms, shape (C + 3,).

    :param contexts: shape (M, C)
    :param weights: flattened, entry (k, d) at k * D + d, shape (M, P)
    :param n_dimensions: D
    :param start: where the search starts, shape (C + 3,)
    """
    deviations = (weights - weights.mean(axis=0)).reshape(len(weights), -1, n_dimensions)
    scale = np.sqrt(np.mean(deviations**2, axis=(0, 1)))
    normalised = (deviations / np.where(scale > 1e-12, scale, 1.0)).reshape(len(weights), -1)
    process = GaussianProcessRegressor(_kernel(contexts.shape[1]).clone_with_theta(start))
    with warnings.catch_warnings():
        # a parameter at its bound is no failure: an entry that does not matter has a long scale
        warnings.simplefilter("ignore", ConvergenceWarning)
        process.fit(Scaling(contexts)(contexts), normalised)
    return np.asarray(cast(Kernel, process.kernel_).theta, np.float64)


class Scaling:
    """Contexts in units of the data: mean 0 and standard deviation 1.

    :param contexts: the data's, shape (M, C)
    """

    def __init__(self, contexts: FloatArray) -> None:
        self.mean, self.scale = contexts.mean(axis=0), context_scale(contexts)

    def __call__(self, contexts: FloatArray) -> FloatArray:
        """Return scaled contexts, shape (N, C).

        :param contexts: shape (N, C)
        """
        return (contexts - self.mean) / self.scale


class WeightProcess:
    """The Gaussian processes for given data and parameters.

    :param contexts: shape (M, C)
    :param weights: shape (M, P)
    :param parameters: of the kernel, in logarithms, shape (C + 3,)
    """

    def __init__(self, contexts: FloatArray, weights: FloatArray, parameters: FloatArray) -> None:
        self.scaling = Scaling(contexts)
        self.weight_mean, self.weight_std = weights.mean(axis=0), weights.std(axis=0)
        kernel = _kernel(contexts.shape[1]).clone_with_theta(parameters)
        self._process = GaussianProcessRegressor(
            kernel,
            optimizer=None,  # pyright: ignore[reportArgumentType]
        )
        self._process.fit(self.scaling(contexts), weights - self.weight_mean)

    def mean(self, contexts: FloatArray) -> FloatArray:
        """Return the expected weights, shape (N, P).

        :param contexts: shape (N, C)
        """
        predicted = np.asarray(self._process.predict(self.scaling(contexts)), np.float64)
        return self.weight_mean + predicted.reshape(len(contexts), -1)

    def std(self, context: FloatArray) -> FloatArray:
        """Return the standard deviation of the weights, shape (P,).

        That of each weight in the data, scaled by the processes' uncertainty in the context.

        :param context: shape (C,)
        """
        _, std = self._process.predict(self.scaling(context[None]), return_std=True)  # pyright: ignore
        return float(np.ravel(std)[0]) * self.weight_std


def _kernel(context_dim: int) -> Kernel:
    smooth = ConstantKernel(1.0, SIGNALS) * Matern(
        cast(Any, np.ones(context_dim)), LENGTH_SCALES, nu=2.5
    )
    trend = ConstantKernel(1.0, SIGNALS) * DotProduct(0.0, "fixed")
    return smooth + trend + WhiteKernel(1e-3, NOISES)
