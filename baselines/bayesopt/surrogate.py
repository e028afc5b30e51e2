"""What TuRBO and LogEI share of BoTorch: isolated random numbers, values, Gaussian processes.

BoTorch is imported where it is used, as the extra ``botorch`` brings it. Shape letters: N rollouts,
n coordinates.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal

import numpy as np
import torch as th
from numpy.typing import NDArray
from scipy.stats import norm, rankdata

from sb3_nmp.bayesian.search import RECHOOSE
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.settings import saved_state

if TYPE_CHECKING:
    from botorch.models import SingleTaskGP

FloatArray = NDArray[np.float64]
#: both with BoTorch's prior, by which length scales grow with the number of coordinates (Hvarfner,
#: Hellsten and Nardi, "Vanilla Bayesian optimization performs great in high dimensions", 2024)
Kernel = Literal["matern", "rbf"]


def check_botorch(algorithm: str) -> None:
    """Raise unless BoTorch is installed.

    :param algorithm: that needs it
    :raises ConfigurationError: it is not
    """
    if find_spec("botorch") is None:
        raise ConfigurationError(
            f"{algorithm} needs BoTorch, which is not installed; install it with "
            "'pip install sb3-nmp[botorch]', or search with BO or CMAES."
        )


@contextmanager
def isolated(rng: np.random.Generator) -> Iterator[None]:
    """Let BoTorch draw from a generator of ours, and keep PyTorch's global one as it is.

    Its warnings are left out: they tell of fits that it repeats by itself.

    :param rng: the generator that seeds PyTorch's
    """
    with th.random.fork_rng(devices=[]), warnings.catch_warnings():
        th.manual_seed(int(rng.integers(2**31)))
        warnings.simplefilter("ignore")
        yield


def values_of(rewards: FloatArray, copula: bool) -> FloatArray:
    """Return what a Gaussian process is fitted to, with mean 0 and variance about 1, shape (N,).

    >>> values_of(np.array([-100.0, 1.0, 2.0]), copula=True).round(2).tolist()
    [-0.67, 0.0, 0.67]

    :param rewards: shape (N,)
    :param copula: replace them by normal quantiles of their ranks, which keeps their order alone
        (Eriksson and Poloczek, "Scalable constrained Bayesian optimization", 2021): a few terrible
        rewards then do not hide how the good ones differ
    """
    if copula:
        return np.asarray(norm.ppf(rankdata(rewards) / (len(rewards) + 1)), np.float64)
    std = float(rewards.std())
    return (rewards - rewards.mean()) / (std if std > 0 else 1.0)


@saved_state("surrogate")
@dataclass
class Surrogate:
    """A Gaussian process over the unit cube, whose kernel is chosen anew now and then.

    The hyper-parameters are those of largest posterior density. They are sought anew when the
    rollouts have grown by a tenth: so a run of N rollouts pays for some ten log N fits.

    :param kernel: which one
    :param max_iterations: of L-BFGS, which bound the cost of a fit
    """

    kernel: Kernel
    max_iterations: int
    _found: dict[str, FloatArray] = field(default_factory=dict, init=False)
    _n_when_found: int = field(default=0, init=False)

    def fit(self, cube: FloatArray, values: FloatArray, n_rollouts: int) -> "SingleTaskGP":
        """Return a process conditioned on rollouts.

        :param cube: coordinates in [0, 1], shape (N, n)
        :param values: shape (N,)
        :param n_rollouts: since the search last began, of which these are some
        """
        from botorch.fit import fit_gpytorch_mll
        from gpytorch.mlls import ExactMarginalLogLikelihood

        process = make_process(cube, values, self.kernel)
        if self._n_when_found <= n_rollouts < RECHOOSE * self._n_when_found:
            found = {name: th.as_tensor(value) for name, value in self._found.items()}
            process.load_state_dict(found, strict=False)
        else:
            likelihood = ExactMarginalLogLikelihood(process.likelihood, process)
            options = {"maxiter": self.max_iterations}
            fit_gpytorch_mll(likelihood, optimizer_kwargs={"options": options})
            self._n_when_found = n_rollouts
            self._found = {
                name: value.detach().numpy().copy() for name, value in process.named_parameters()
            }
        process.eval()
        return process


def make_process(cube: FloatArray, values: FloatArray, kernel: Kernel) -> "SingleTaskGP":
    """Return a Gaussian process with the hyper-parameters from which a fit starts.

    :param cube: coordinates in [0, 1], shape (N, n)
    :param values: shape (N,)
    :param kernel: which one
    """
    from botorch.models import SingleTaskGP
    from botorch.models.utils.gpytorch_modules import get_covar_module_with_dim_scaled_prior

    return SingleTaskGP(
        th.as_tensor(cube),
        th.as_tensor(values)[:, None],
        covar_module=get_covar_module_with_dim_scaled_prior(
            ard_num_dims=cube.shape[1], use_rbf_kernel=kernel == "rbf"
        ),
        outcome_transform=None,
    )


def sobol(n: int, size: int, rng: np.random.Generator) -> FloatArray:
    """Return scrambled Sobol points in the unit cube, shape (n, size).

    :param n: how many
    :param size: coordinates
    :param rng: seeds the scrambling
    """
    engine = th.quasirandom.SobolEngine(size, scramble=True, seed=int(rng.integers(2**31)))
    return engine.draw(n, dtype=th.float64).numpy()
