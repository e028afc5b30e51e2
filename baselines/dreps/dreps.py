"""`DREPS`: dual REPS, which also keeps away from bad samples (thesis [50])."""

from typing import ClassVar, Unpack

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import GymEnv

from baselines.dreps.clusters import fit_clusters, k_means
from baselines.dreps.dual import DualSolution, References, solve
from baselines.reps.dual import Solution
from baselines.reps.gaussian import FloatArray, LinearGaussian
from baselines.reps.policies import GaussianPrimitivePolicy
from baselines.reps.reps import REPS, REPSArguments
from baselines.reps.samples import Samples
from sb3_nmp.common.settings import Rules
from sb3_nmp.common.tuning import Choice, Range, SearchSpace


class DREPS(REPS):
    """REPS whose next policy also keeps a distance from clusters of bad samples.

    The worst samples are clustered, a Gaussian b_i is fitted to each cluster, and the samples'
    weights come from the dual under ``KL(pi || b_i) >= xi`` besides ``KL(pi || q) <= epsilon``
    (`baselines.dreps.dual`). Between two ways to solve a task this makes the policy choose one
    instead of averaging them. All else is as in `REPS`.

    Colome and Torras, "Dual REPS: a generalization of relative entropy policy search exploiting bad
    experiences", 2017.

    >>> import benchmark_envs
    >>> DREPS("MlpPolicy", "nmp/Bottles-v0", n_clusters=1, seed=0).learn(20).num_timesteps
    20

    :param xi: least KL(pi || b_i), in nats
    :param n_clusters: of bad samples, at most
    :param bad_fraction: of the samples that count as bad, in (0, 1)
    :param chi: bound on KL(pi || good), in nats, for the Gaussian fitted to the best samples;
        None leaves this constraint out
    :param good_fraction: of the samples that count as good, in (0, 1)
    """

    tunable: ClassVar[SearchSpace] = {
        "population_size": Choice((10, 16, 20, 30)),
        "epsilon": Range(0.5, 3.0),
        "n_bases": Range(6, 15, integer=True),
        "xi": Range(1.0, 8.0),
    }

    def __init__(
        self,
        policy: str | type[GaussianPrimitivePolicy],
        env: GymEnv | str,
        *,
        xi: float = 5.0,
        n_clusters: int = 2,
        bad_fraction: float = 0.3,
        chi: float | None = None,
        good_fraction: float = 0.1,
        **shared: Unpack[REPSArguments],
    ) -> None:
        self.xi, self.n_clusters, self.bad_fraction = xi, n_clusters, bad_fraction
        self.chi, self.good_fraction = chi, good_fraction
        super().__init__(policy, env, **shared)

    def _rules(self) -> Rules:
        bounded = bool(np.isfinite(self.xi)) and self.xi >= 0
        share = "in (0, 1)"
        return {
            "xi": (bounded, "finite and >= 0: it bounds a KL divergence in nats from below"),
            "chi": (self.chi is None or self.chi > 0, "> 0, a KL divergence in nats, or None"),
            "n_clusters": (self.n_clusters >= 1, ">= 1; without clusters of bad samples, use REPS"),
            "bad_fraction": (0 < self.bad_fraction < 1, share),
            "good_fraction": (0 < self.good_fraction < 1, share),
            **super()._rules(),
        }

    def _weigh(self, samples: Samples, old: LinearGaussian) -> Solution:
        advantages = samples.advantages()
        deviations = samples.weights - samples.features @ old.coefficients
        references = self._references(advantages, deviations, old.covariance)
        solution = solve(advantages, self.epsilon, references)
        self._log_dual(solution, references)
        return solution

    def _references(
        self, advantages: FloatArray, deviations: FloatArray, covariance: FloatArray
    ) -> References:
        """Fit Gaussians to clusters of the worst samples, and to the best ones if chi is set.

        All is done in units of the policy q: deviations from its mean, whitened.

        :param advantages: shape (N,)
        :param deviations: of the weights from q's mean in their contexts, shape (N, P)
        :param covariance: of q, shape (P, P)
        """
        order = np.argsort(advantages, kind="stable")
        white = np.asarray(
            np.linalg.solve(np.linalg.cholesky(covariance), deviations.T).T, np.float64
        )
        bad = white[order[: _count(self.bad_fraction, len(order))]]
        rows = _log_ratios(white, bad, k_means(bad, self.n_clusters))
        signs, bounds = -np.ones(len(rows)), np.full(len(rows), float(self.xi))
        if self.chi is not None:
            good = white[order[-_count(self.good_fraction, len(order)) :]]
            rows += _log_ratios(white, good, np.zeros(len(good), np.int_))
            signs, bounds = np.append(signs, 1.0), np.append(bounds, self.chi)
        return References(np.stack(rows), signs, bounds)

    def _log_dual(self, solution: DualSolution, references: References) -> None:
        bad = references.signs < 0
        self.logger.record("train/nu", float(solution.multipliers[bad].sum()))
        self.logger.record("train/kl_to_bad", float(solution.divergences[bad].min()))
        self.logger.record("train/feasible", float(solution.feasible))


def _count(fraction: float, n: int) -> int:
    return min(n, max(2, int(fraction * n)))


def _log_ratios(
    white: FloatArray, members: FloatArray, labels: NDArray[np.int_]
) -> list[FloatArray]:
    """Return log r_j - log q of all samples for the Gaussian r_j of each cluster, each (N,).

    :param white: all samples in units of q, shape (N, P)
    :param members: the clustered ones, shape (M, P)
    :param labels: their clusters, shape (M,)
    """
    p = white.shape[1]
    constant = np.ones((len(white), 1))
    standard = LinearGaussian(np.zeros((1, p)), np.eye(p)).log_density(white, constant)
    return [
        LinearGaussian(mean[None], covariance).log_density(white, constant) - standard
        for mean, covariance in fit_clusters(members, labels, np.eye(p))
    ]
