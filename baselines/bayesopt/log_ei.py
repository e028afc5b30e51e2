"""`LogEISearch`: Bayesian optimisation by the logarithm of expected improvement.

Ament, Daulton, Eriksson, Balandat and Bakshy, "Unexpected improvements to expected improvement for
Bayesian optimization", 2023. Shape letters: N rollouts, n coordinates.
"""

from dataclasses import dataclass

import numpy as np
import torch as th

from baselines.bayesopt.boxed import BoxedSearch
from baselines.bayesopt.surrogate import FloatArray, Kernel, Surrogate, isolated, values_of
from sb3_nmp.bayesian.search import Subspace, best_and_newest
from sb3_nmp.common.settings import saved_state


@saved_state("log-ei-settings")
@dataclass(frozen=True)
class LogEISettings:
    """How LogEI models and chooses.

    :param n_initial: rollouts of the first design
    :param reach: half of the box's edge, in standard deviations of the exploration
    :param kernel: of the process, see `Kernel`
    :param copula: see `values_of`
    :param n_samples: of the process at the points of a generation
    :param n_restarts: of the acquisition function's ascent
    :param n_raw: points from which these begin
    :param n_ascent: iterations of an ascent
    :param n_remembered: rollouts to which the process is fitted at most: half of them the best, the
        others the newest
    :param max_iterations: of a fit
    """

    n_initial: int
    reach: float
    kernel: Kernel
    copula: bool
    n_samples: int
    n_restarts: int
    n_raw: int
    n_ascent: int
    n_remembered: int
    max_iterations: int


@saved_state("log-ei-search")
class LogEISearch(BoxedSearch):
    """qLogExpectedImprovement in one context; a generation's points are chosen one by one.

    :param space: of the trajectories that are searched
    :param settings: how it models and chooses
    """

    def __init__(self, space: Subspace, settings: LogEISettings) -> None:
        super().__init__(space, settings.reach, settings.n_initial)
        self.settings = settings
        self.surrogate = Surrogate(settings.kernel, settings.max_iterations)

    def _propose_by_model(self, n: int, rng: np.random.Generator) -> FloatArray:
        s = self.settings
        rows = best_and_newest(self.rewards, s.n_remembered)
        cube, values = self.cube[rows], values_of(self.rewards[rows], s.copula)
        with isolated(rng):
            from botorch.acquisition import qLogExpectedImprovement
            from botorch.optim import optimize_acqf
            from botorch.sampling import SobolQMCNormalSampler

            process = self.surrogate.fit(cube, values, len(self.rewards))
            seed = int(rng.integers(2**31))
            worth = qLogExpectedImprovement(
                process,
                best_f=float(values.max()),
                sampler=SobolQMCNormalSampler(th.Size([s.n_samples]), seed=seed),
            )
            chosen, _ = optimize_acqf(
                worth,
                bounds=th.tensor([[0.0], [1.0]], dtype=th.float64).repeat(1, self.space.size),
                q=n,
                num_restarts=s.n_restarts,
                raw_samples=s.n_raw,
                options={
                    "maxiter": s.n_ascent,
                    "seed": seed,
                    "sample_around_best": True,
                },
                sequential=True,
            )
        return chosen.numpy()
