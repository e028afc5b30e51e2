"""RC-NMP's skill over contexts: what the wanted reward makes of what was right elsewhere.

Two ensembles are trained on the rollouts of all contexts: the *prior* ``p(w | c)``, a regression
from contexts to the weights of what was right, and the *reward model* ``p(r | c, w)``, from all
rollouts, failures too. The answer is the mode of the reward-conditioned skill (thesis 6.1 asks for
trajectories given a reward; here by Bayes' rule)::

    p(w | c, r*) ~ p(w | c) p(r* | c, w)

found by gradient ascent from the prior's mean. r* is the mean reward of the successes, so the
answer keeps a margin, which the best rollouts lack.

With more than one way ("mode") to do a task, the mean of two ways may be none. So the prior has a
categorical latent k (chapter 7 names it as future work), ``p(w | c) = sum_k p(k) p(w | c, k)``,
with an ensemble for each mode that was found among what was right (`sort_into_modes`). The ascent
begins from every mode's mean, and the mode that promises most, by ``p(r* | c, w)``, answers.

Where demonstrations are shown, the prior begins as a linear regression, whose penalty is the one of
least leave-one-out error, and the reward model is believed as far as it has foretold the newest
rollouts: a few of them must not spoil what was shown.

Shape letters: N contexts, M perturbations, E members of an ensemble, K modes found, C context, P
weights.
"""

from typing import cast

import numpy as np
import torch as th
from numpy.typing import NDArray
from torch import nn

from sb3_nmp.common.contextual import Experience
from sb3_nmp.common.regression import least_error_penalty, linear_regression
from sb3_nmp.models.ensemble import Ensemble, EnsembleTraining
from sb3_nmp.models.modes import sort_into_modes
from sb3_nmp.models.skill_space import N_MOMENTS, SkillSpace
from sb3_nmp.models.standardised import Standardised
from sb3_nmp.rcnmp.settings import RCNMPSkill

FloatArray = NDArray[np.float64]
BETAS = (0.7, 0.95)  # of Adam in the ascent, which has but a few steps


class RewardConditionedSkill(nn.Module):
    """Answers contexts by the reward-conditioned skill.

    :param space: of the trajectories' weights
    :param context_dim: C
    :param settings: of both models and of the ascent
    """

    middles: th.Tensor
    shares: th.Tensor
    target_reward: th.Tensor
    residual: th.Tensor
    n_rated: th.Tensor

    def __init__(self, space: SkillSpace, context_dim: int, settings: RCNMPSkill) -> None:
        super().__init__()
        self.settings = settings
        n_moments = N_MOMENTS * space.n_dimensions
        self.sizes = {
            "prior": [context_dim, *settings.arch, space.n_weights],
            "reward": [context_dim + n_moments, *settings.arch, 1],
        }
        self.contexts, self.moments = Standardised(context_dim), Standardised(n_moments)
        self.rewards = Standardised(1)
        self.register_buffer("middles", th.zeros(settings.n_modes, space.n_weights))
        self.register_buffer("shares", th.zeros(settings.n_modes))  # p(k), 0 of modes not found
        self.register_buffer("target_reward", th.zeros(()))
        self.register_buffer("residual", th.zeros(()))  # mean squared error of the reward model
        self.register_buffer("n_rated", th.zeros((), dtype=th.long))  # rollouts it has learned from
        self._renew(th.Generator().manual_seed(0))

    def _renew(self, generator: th.Generator) -> None:
        """Begin with new networks: trained from scratch, they forget what misled them."""
        n_members = self.settings.n_members
        self.priors = nn.ModuleList(
            Ensemble(self.sizes["prior"], n_members, generator)
            for _ in range(self.settings.n_modes)
        )
        self.reward = Ensemble(self.sizes["reward"], n_members, generator)

    def learn(self, space: SkillSpace, known: Experience, generator: th.Generator) -> None:
        """Train both models.

        :param space: of the trajectories' weights
        :param known: all rollouts so far, at least one of them right
        :param generator: of weights and batches
        """
        shown = len(known.rated) < len(known.rewards)
        foretold = self._error_on_new(space, known) if shown else None
        self._renew(generator)
        contexts = th.as_tensor(known.contexts, dtype=th.float32)
        weights = th.as_tensor(known.weights, dtype=th.float32)
        self.contexts.take(contexts)
        n_steps = _clipped(0.3 * len(weights), self.settings.prior_steps)
        modes = self._find_modes(space, known)
        self.shares.zero_()
        for k, rows in enumerate(map(th.as_tensor, modes)):
            self.shares[k] = len(rows) / sum(map(len, modes))
            self.middles[k] = weights[rows].mean(dim=0)
            asked = self.contexts(contexts[rows])
            if shown and len(rows) > 1:
                self._begin_linear(space, k, asked, weights[rows])
            self.prior(k).fit(
                asked,
                (weights[rows] - self.middles[k]) / space.scale,
                n_steps,
                EnsembleTraining(),
                generator,
            )
        self._learn_rewards(space, contexts, weights, known, generator)
        if foretold is not None:
            self.residual.fill_(foretold)

    def _begin_linear(
        self, space: SkillSpace, k: int, asked: th.Tensor, weights: th.Tensor
    ) -> None:
        """Let the prior of a mode begin as the ridge regression of what was right.

        :param space: of the trajectories' weights
        :param k: which mode
        :param asked: standardised contexts, shape (N, C)
        :param weights: shape (N, P)
        """
        rows, values = asked.double().numpy(), (weights / space.scale).double().numpy()
        centre, middle, slopes = linear_regression(rows, values, least_error_penalty(rows, values))
        self.middles[k] = space.scale * th.as_tensor(middle - centre @ slopes, dtype=th.float32)
        self.prior(k).begin_with(th.as_tensor(slopes, dtype=th.float32))

    @th.no_grad()
    def _error_on_new(self, space: SkillSpace, known: Experience) -> float:
        """Return the mean squared error of the rewards that the model foretells of new rollouts.

        In units of their variance when it learned; 1, as that of a constant, where it foretells
        nothing yet.
        """
        new = known.rated[int(self.n_rated) :]
        foretells = int(self.n_rated) > 0 and not bool(self.target_reward.isnan())
        if not foretells or len(new) == 0:
            return 1.0
        contexts, weights, rewards = (
            th.as_tensor(rows[new], dtype=th.float32)
            for rows in (known.contexts, known.weights, known.rewards)
        )
        inputs = self._reward_inputs(space, self.contexts(contexts), weights)
        return float(self._reward_error(inputs, self.rewards(rewards[:, None])))

    def _find_modes(self, space: SkillSpace, known: Experience) -> list[NDArray[np.intp]]:
        """Return the rows of each mode among what was right, the commonest first."""
        right = known.right
        if self.settings.n_modes == 1:
            return [right]
        labels = sort_into_modes(
            self.contexts(th.as_tensor(known.contexts[right], dtype=th.float32)).numpy(),
            known.weights[right] / space.scale.numpy(),
            self.settings.n_modes,
        )
        return [right[labels == k] for k in range(labels.max() + 1)]

    def _learn_rewards(
        self,
        space: SkillSpace,
        contexts: th.Tensor,
        weights: th.Tensor,
        known: Experience,
        generator: th.Generator,
    ) -> None:
        """Train the reward model on what was executed; before a success it wants no reward."""
        rated = known.rated
        self.target_reward.fill_(th.nan)
        self.n_rated.fill_(len(rated))
        if not known.successes[rated].any():
            return
        contexts, weights = contexts[rated], weights[rated]
        rewards = th.as_tensor(known.rewards[rated], dtype=th.float32)[:, None]
        self.moments.take(space.moments(weights), groups=space.n_dimensions)
        self.rewards.take(rewards)
        succeeded = th.as_tensor(known.successes[rated])
        self.target_reward.copy_(self.rewards(rewards[succeeded].mean(dim=0))[0])
        inputs = self._reward_inputs(space, self.contexts(contexts), weights)
        self.reward.fit(
            inputs,
            self.rewards(rewards),
            _clipped(0.6 * len(weights), self.settings.reward_steps),
            EnsembleTraining(weight_decay=0.1),
            generator,
        )
        self.residual.copy_(self._reward_error(inputs, self.rewards(rewards)))

    def _reward_inputs(
        self, space: SkillSpace, contexts: th.Tensor, weights: th.Tensor
    ) -> th.Tensor:
        """Return what the reward model sees, shape (rows, inputs).

        :param contexts: standardised, shape (rows, C)
        :param weights: shape (rows, P)
        """
        return th.cat([contexts, self.moments(space.moments(weights))], dim=1)

    def _reward_error(self, inputs: th.Tensor, rewards: th.Tensor) -> th.Tensor:
        """Return the mean squared error of the rewards that the model foretells.

        :param inputs: shape (rows, inputs)
        :param rewards: standardised, shape (rows, 1)
        """
        return ((self.reward(inputs).mean(dim=0) - rewards) ** 2).mean()

    @property
    def n_found(self) -> int:
        """K."""
        return int((self.shares > 0).sum())

    def prior(self, k: int) -> Ensemble:
        """Return the regression of a mode.

        :param k: which one
        """
        return cast(Ensemble, self.priors[k])

    def prior_mean(self, space: SkillSpace, contexts: th.Tensor, k: int = 0) -> th.Tensor:
        """Return the mean of p(w | c, k), shape (N, P).

        :param space: of the trajectories' weights
        :param contexts: shape (N, C)
        :param k: which mode; 0 is the commonest
        """
        return self.middles[k] + space.scale * self.prior(k)(self.contexts(contexts)).mean(dim=0)

    def answer(self, space: SkillSpace, contexts: th.Tensor) -> th.Tensor:
        """Return the mode of p(w | c, r*), by its best category, shape (N, P).

        :param space: of the trajectories' weights
        :param contexts: shape (N, C)
        """
        answers, promises = self.modes(space, contexts)
        return answers[th.arange(len(answers)), promises.argmax(dim=1)]

    def modes(self, space: SkillSpace, contexts: th.Tensor) -> tuple[th.Tensor, th.Tensor]:
        """Return each mode's answers, shape (N, K, P), and what they promise, shape (N, K).

        An answer promises log p(r* | c, w) up to a constant, or, as long as no reward is wanted,
        the logarithm of its mode's share p(k).

        :param space: of the trajectories' weights
        :param contexts: shape (N, C)
        """
        starts = [self.prior_mean(space, contexts, k) for k in range(self.n_found)]
        if not self.settings.reward_conditioning or bool(self.target_reward.isnan()):
            shares = self.shares[: self.n_found].log()
            return th.stack(starts, dim=1), shares.expand(len(contexts), -1)
        climbed = [self._climb(space, contexts, start) for start in starts]
        answers, promises = zip(*climbed, strict=True)
        return th.stack(answers, dim=1), th.stack(promises, dim=1)

    def _climb(
        self, space: SkillSpace, contexts: th.Tensor, start: th.Tensor
    ) -> tuple[th.Tensor, th.Tensor]:
        """Return the mode of p(w | c, r*) next to a mean (N, P), and what it promises (N,)."""
        s = self.settings
        drawn = th.randn(
            s.n_perturbations // 2, 1, start.shape[1], generator=th.Generator().manual_seed(0)
        )
        perturbations = s.robustness * th.cat([drawn, -drawn])
        seen = self.contexts(contexts).repeat(len(perturbations), 1)

        def unlikely(step: th.Tensor) -> th.Tensor:
            tried = start + space.scale * (step + perturbations)
            surprise = self._surprise(space, seen, tried.flatten(0, 1))
            return surprise.unflatten(0, (len(perturbations), -1)).mean(dim=0)

        with th.enable_grad():
            step = th.zeros_like(start, requires_grad=True)
            ascent = th.optim.Adam([step], s.ascent_rate, betas=BETAS)
            for _ in range(s.ascent_steps):
                loss = unlikely(step).sum() + 0.5 * (step**2).sum() / s.width**2
                ascent.zero_grad()
                loss.backward()
                ascent.step()
        step = step.detach()
        return start + space.scale * step, -unlikely(step)

    def _surprise(self, space: SkillSpace, contexts: th.Tensor, weights: th.Tensor) -> th.Tensor:
        """Return -log p(r* | c, w) up to a constant, shape (rows,).

        :param contexts: standardised, shape (rows, C)
        :param weights: shape (rows, P)
        """
        predicted = self.reward(self._reward_inputs(space, contexts, weights))[..., 0]
        mean, variance = predicted.mean(dim=0), predicted.var(dim=0, correction=0)
        variance = variance + self.residual + self.settings.floor**2
        return 0.5 * ((self.target_reward - mean) ** 2 / variance + variance.log())


def _clipped(steps: float, limits: tuple[int, int]) -> int:
    return int(np.clip(steps, *limits))
