"""`RelevanceSearch`: relevance-weighted policy optimisation for a single context.

After Ewerton et al. 2019 (thesis [2]), by ask and tell.
"""

from dataclasses import dataclass

import numpy as np

from baselines.primitives import Primitive
from baselines.promp_rl.relevance import relevance, update
from baselines.promp_rl.reps_search import decode
from baselines.reps.dual import solve
from baselines.reps.gaussian import FloatArray
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import saved_state, settings_name


@settings_name("relevance-search-settings")
@dataclass(frozen=True)
class RelevanceSettings:
    """Of `RelevanceSearch`.

    :param epsilon: bound on KL(weights of the samples || uniform), in nats
    :param floor: least standard deviation of each weight, shape (P,)
    """

    epsilon: float
    floor: FloatArray


@saved_state("relevance-search")
class RelevanceSearch:
    """Improves one objective after the other, moving mostly the weights that matter to it.

    A cycle is a generation with the whole variance, from which the relevance of every weight to
    every objective is learnt, and then a generation for each objective that varied: its samples
    have variances scaled by the relevances to that objective, and mean and variances take a
    reward-weighted step for it alone. The published algorithm can evaluate its objectives in closed
    form; ours spends rollouts on them. Every rollout reports all objectives, so that one generation
    teaches all relevances, and it moves the mean as well, by what its samples say about each
    objective, in proportion to the relevances (a third fewer rollouts on the aperture task).

    :param primitive: whose weights are searched
    :param mean: of the first Gaussian, flattened weights, shape (P,)
    :param std: of the weights, shape (P,)
    :param settings: of the updates
    """

    def __init__(
        self, primitive: Primitive, mean: FloatArray, std: FloatArray, settings: RelevanceSettings
    ) -> None:
        self.primitive, self.settings = primitive, settings
        self.mean, self.variances = mean, std**2
        self.relevances: dict[str, FloatArray] = {}
        self._pending: list[str] = []
        self._asked: FloatArray | None = None
        self._is_new = True

    @property
    def objective(self) -> str | None:
        """The objective that is improved next; None where relevances are learnt first."""
        return self._pending[0] if self._pending else None

    def ask(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return n trajectories to try, shape (n, T, D); a new search's first one is the mean's.

        :param n: how many, at least 2
        :param rng: the generator to draw from
        """
        variances = self.variances
        if self.objective is not None:
            variances = variances * self.relevances[self.objective]
        self._asked = self.mean + rng.standard_normal((n, len(variances))) * np.sqrt(variances)
        if self._is_new:
            self._asked[0] = self.mean
        return decode(self.primitive, self._asked)

    def tell(self, rollouts: Generation) -> None:
        """Learn relevances, or take a step for the objective at hand.

        :param rollouts: those of the last `ask` in their order; others of this context say only
            that the greedy trajectory has been tried
        """
        samples, self._asked, self._is_new = self._asked, None, False
        if samples is None:
            return
        objectives = rollouts.terms or {"reward": rollouts.rewards}
        if self.objective is None:
            self._learn_relevances(samples, objectives)
        else:
            self._improve(self._pending.pop(0), samples, objectives)

    def _learn_relevances(self, samples: FloatArray, objectives: dict[str, FloatArray]) -> None:
        found = {name: relevance(samples, values) for name, values in objectives.items()}
        self.relevances = {name: values for name, values in found.items() if values.any()}
        self._pending = list(self.relevances)
        step, total = np.zeros_like(self.mean), np.zeros_like(self.mean)
        for name, relevances in self.relevances.items():
            shares = solve(objectives[name], self.settings.epsilon).weights
            step += relevances * (shares @ samples - self.mean)
            total += relevances
        self.mean = self.mean + step / np.maximum(total, 1.0)

    def _improve(self, name: str, samples: FloatArray, objectives: dict[str, FloatArray]) -> None:
        self.mean, variances = update(
            samples,
            objectives[name],
            self.mean,
            self.variances,
            self.relevances[name],
            self.settings.epsilon,
        )
        self.variances = np.maximum(variances, self.settings.floor**2)
