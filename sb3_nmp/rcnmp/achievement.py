"""RC-NMP's skill where rollouts tell what they achieved: every rollout is a demonstration of that.

An ensemble learns what is achieved, ``a(c, w)``, from all rollouts, whatever was asked of them. The
answer begins at the rollouts that achieved what is nearest to the context; each is corrected by
gradient until the ensemble, its known error there taken off, predicts the context, and the one that
is predicted best is taken. Entries of a context that every rollout achieves as they were given,
such as how much a cup holds, are circumstances that the ensemble is told; the others are goals.

Shape letters: N contexts, M rollouts that achieved something, C context, P weights, E members.
"""

from typing import ClassVar

import numpy as np
import torch as th

from sb3_nmp.common.contextual import Experience
from sb3_nmp.common.growing import GrowingModule
from sb3_nmp.models.ensemble import Ensemble
from sb3_nmp.models.skill_space import N_MOMENTS, SkillSpace
from sb3_nmp.models.standardised import Standardised
from sb3_nmp.rcnmp.settings import RCNMPAchievement
from sb3_nmp.rcnmp.skill import BETAS


class AchievementConditionedSkill(GrowingModule):
    """Answers contexts by correcting the rollouts that achieved the nearest.

    :param space: of the trajectories' weights
    :param context_dim: C
    :param settings: of the ensemble and of the correction
    """

    growing: ClassVar[tuple[str, ...]] = ("achieved", "weights")

    goals: th.Tensor
    achieved: th.Tensor
    weights: th.Tensor

    def __init__(self, space: SkillSpace, context_dim: int, settings: RCNMPAchievement) -> None:
        super().__init__()
        self.settings = settings
        n_moments = N_MOMENTS * space.n_dimensions
        self.contexts, self.moments = Standardised(context_dim), Standardised(n_moments)
        self.model = Ensemble(
            [context_dim + n_moments, *settings.arch, context_dim],
            settings.n_members,
            th.Generator().manual_seed(0),
        )
        self.register_buffer("goals", th.ones(context_dim))
        self.register_buffer("achieved", th.empty(0, context_dim))
        self.register_buffer("weights", th.empty(0, space.n_weights))

    def learn(self, space: SkillSpace, known: Experience, generator: th.Generator) -> None:
        """Go on training, and take over what was achieved.

        :param space: of the trajectories' weights
        :param known: all rollouts so far; some of them achieved something
        :param generator: of the batches
        """
        if known.achieved is None:
            raise ValueError("these rollouts tell nothing of what they achieved")
        told = np.isfinite(known.achieved).all(axis=1)
        contexts, achieved, weights = (
            th.as_tensor(rows[told], dtype=th.float32)
            for rows in (known.contexts, known.achieved, known.weights)
        )
        n_new = len(achieved) - len(self.achieved)
        if len(self.achieved) == 0:
            self.contexts.take(contexts)
            moments = space.moments(weights) + space.initial_moments(achieved)
            self.moments.take(moments, groups=space.n_dimensions)
        self.goals.copy_((contexts != achieved).any(dim=0))
        self.achieved, self.weights = self.contexts(achieved), weights
        inputs = self._inputs(space, self.achieved, weights)
        n_steps = round(self.settings.steps_per_rollout * n_new)
        self.model.fit(inputs, self.achieved, n_steps, self.settings.training, generator)

    def answer(self, space: SkillSpace, contexts: th.Tensor) -> th.Tensor:
        """Return the weights that are predicted to achieve contexts, shape (N, P).

        :param space: of the trajectories' weights
        :param contexts: shape (N, C)
        """
        wanted = self.contexts(contexts)
        nearest = th.cdist(wanted, self.achieved).argsort(dim=1)[:, : self.settings.n_starts]
        corrected, errors = zip(
            *(self._correct(space, wanted, rows) for rows in nearest.T), strict=True
        )
        best = th.stack(errors).argmin(dim=0)
        return th.stack(corrected)[best, th.arange(len(contexts))]

    def _correct(
        self, space: SkillSpace, wanted: th.Tensor, rows: th.Tensor
    ) -> tuple[th.Tensor, th.Tensor]:
        """Return corrected weights (N, P), and how far they are from what is wanted (N,).

        :param wanted: standardised contexts, shape (N, C)
        :param rows: of the rollouts to begin with, shape (N,)
        """
        s, start = self.settings, self.weights[rows]
        bias = self.achieved[rows] - self.model(self._inputs(space, self.achieved[rows], start))
        with th.enable_grad():
            step = th.zeros_like(start, requires_grad=True)
            descent = th.optim.Adam([step], s.correction_rate, betas=BETAS)
            for _ in range(s.correction_steps):
                loss = self._loss(space, wanted, start, step, bias)
                descent.zero_grad()
                loss.sum().backward()
                descent.step()
        step = step.detach()
        return start + space.scale * step, self._loss(space, wanted, start, step, bias)

    def _loss(
        self,
        space: SkillSpace,
        wanted: th.Tensor,
        start: th.Tensor,
        step: th.Tensor,
        bias: th.Tensor,
    ) -> th.Tensor:
        """Return the expected squared error, the members' spread included, and the step's price."""
        s = self.settings
        predicted = self.model(self._inputs(space, wanted, start + space.scale * step)) + bias
        errors = (self.goals * (predicted - wanted) ** 2).sum(dim=-1).mean(dim=0)
        return errors / (2 * s.tolerance**2) + 0.5 * (step**2).sum(dim=1) / s.width**2

    def _inputs(self, space: SkillSpace, contexts: th.Tensor, weights: th.Tensor) -> th.Tensor:
        """Return what the ensemble sees: circumstances, and where trajectories are at some moments.

        Goals are none of its business.

        :param contexts: from whose initial trajectories the weights deviate, standardised (N, C)
        :param weights: shape (N, P)
        """
        circumstances = (1.0 - self.goals) * contexts
        begun = space.initial_moments(contexts * self.contexts.std + self.contexts.mean)
        return th.cat([circumstances, self.moments(space.moments(weights) + begun)], dim=1)
