"""`SearchingAlgorithm`: which searches ACNMP begins, and in which of several ways (thesis 5.1, VI).

Shape letters: N contexts, C context, T time points, D dimensions of the trajectory.
"""

from typing import Literal, cast

import numpy as np
import torch as th
from numpy.typing import NDArray

from sb3_nmp.acnmp.exploration import directions
from sb3_nmp.acnmp.policy import ACNMPPolicy
from sb3_nmp.acnmp.search import PolicySearch
from sb3_nmp.acnmp.settings import ACNMPExploration
from sb3_nmp.acnmp.ways import WaysSearch
from sb3_nmp.bayesian.search import CriticSearch, Subspace
from sb3_nmp.bayesian.settings import ACNMPCritic
from sb3_nmp.bayesian.shaped_noise import nearer_scale
from sb3_nmp.common.adaptive import AdaptiveAlgorithm
from sb3_nmp.common.context_search import ContextSearch, thresholds
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.elites import SAME_CONTEXT
from sb3_nmp.common.rollouts import Generation

SearchKind = Literal["critic", "policy"]


class SearchingAlgorithm(AdaptiveAlgorithm):
    """The part of ACNMP that searches.

    Where the demonstrations go several ways (``n_modes`` of `CNMPArchitecture`) and contexts are
    drawn, an answer that does not satisfy is followed by those of the other modes, before anything
    is searched (`WaysSearch`). Which modes' answers satisfied in which contexts teaches the gate.
    """

    policy: ACNMPPolicy
    search: SearchKind
    exploration: ACNMPExploration
    critic: ACNMPCritic

    def _new_search(self, context: NDArray[np.float32]) -> CriticSearch | PolicySearch | WaysSearch:
        cnmp, row = self.policy.cnmp, context.astype(np.float64)
        if cnmp.gate is None or self._pinned or self.search == "policy":
            return self._search_around(row, cnmp.trajectories(row[None])[0], self._shown_like(row))
        shares = cnmp.gate.log_shares(self._standardised(row[None]))[0].cpu().numpy()
        modes = [int(mode) for mode in np.argsort(-shares, kind="stable") if shares[mode] > -np.inf]
        answers = cnmp.each_mode(cnmp.times.new_tensor(row[None]))[0].cpu().numpy()
        searches = [
            self._search_around(row, answers[mode].astype(np.float64), self._shown_in(mode))
            for mode in modes
        ]
        least_reward = thresholds(self.reward_threshold)[0]
        return WaysSearch(modes, cast(list[CriticSearch], searches), least_reward)

    def _search_around(
        self, context: NDArray[np.float64], answer: NDArray[np.float64], shown: Demonstrations
    ) -> CriticSearch | PolicySearch:
        """Return a search that starts from an answer (T, D) in the context (C,)."""
        scale = self.first_scale()
        if self._may_search_nearer:
            scale = nearer_scale(self.exploration, scale, shown)
        along = directions(self.exploration, scale, self.policy.cnmp, shown, context)
        space = Subspace(answer, along)
        if self.search == "policy":
            return PolicySearch(space, self.exploration)
        elsewhere = self._shown_nearest(context, answer)
        unit, radius = self._context_unit(), self.exploration.radius
        return CriticSearch(space, radius, self.critic, unit, elsewhere)

    def _shown_like(self, context: NDArray[np.float64]) -> Demonstrations:
        """Return the demonstrations of the mode in which the network answers a context (C,)."""
        gate = self.policy.cnmp.gate
        mode = 0 if gate is None else int(gate(self._standardised(context[None])))
        return self._shown_in(mode)

    def _shown_in(self, mode: int) -> Demonstrations:
        """Return the demonstrations of a mode; all of them where it has none."""
        cnmp, shown = self.policy.cnmp, cast(Demonstrations, self.demonstrations)
        if cnmp.gate is None:
            return shown
        same = (cnmp.nearest_modes(shown) == mode).cpu().numpy()
        return shown[same] if same.any() else shown

    def _standardised(self, contexts: NDArray[np.floating]) -> th.Tensor:
        """Return contexts as the gate sees them, shape (N, C)."""
        cnmp = self.policy.cnmp
        return cnmp.normalise_contexts(cnmp.times.new_tensor(contexts))

    def _open_searches(self, tried: Generation) -> None:
        super()._open_searches(tried)
        gate = self.policy.cnmp.gate
        if gate is not None and self.search == "critic":
            answered_by = gate(self._standardised(tried.contexts))
            satisfied = th.as_tensor(self._satisfactory(tried))
            self._learn_ways(tried.contexts, answered_by, satisfied)

    def _close_searches(self) -> list[ContextSearch]:
        """Learn which other modes' answers satisfied; where one did, nothing is to be searched."""
        told = [
            (each.context, mode, satisfied)
            for each in self.searches
            if isinstance(each.search, WaysSearch)
            for mode, satisfied in each.search.take_news().items()
        ]
        if told:
            contexts, modes, satisfied = zip(*told, strict=True)
            self._learn_ways(np.stack(contexts), th.tensor(modes), th.tensor(satisfied))
        self.searches = [
            each
            for each in self.searches
            if not (isinstance(each.search, WaysSearch) and each.search.is_answered)
        ]
        return super()._close_searches()

    def _learn_ways(
        self, contexts: NDArray[np.floating], modes: th.Tensor, satisfied: th.Tensor
    ) -> None:
        """Teach the gate which modes' answers satisfied in contexts (N, C)."""
        cnmp, known = self.policy.cnmp, self.training_set()
        if cnmp.gate is not None:
            cnmp.gate.outcomes.remember(self._standardised(contexts), modes, satisfied)
            cnmp.teach_gate(known, cnmp.nearest_modes(known))

    def _satisfying_answers(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return contexts (N, C) and answers (N, T, D) that satisfied without any search."""
        elites, least_reward = self.policy.elites, thresholds(self.reward_threshold)[0]
        searched = np.concatenate(
            [self.replay_buffer.contexts, *(each.context[None] for each in self.searches)]
        )
        contexts = elites.contexts.cpu().numpy()
        satisfied = (elites.solved & (elites.rewards >= least_reward)).cpu().numpy()
        apart = np.abs(contexts[:, None] - searched).max(axis=2) > SAME_CONTEXT
        rows = satisfied & apart.all(axis=1)
        return contexts[rows], elites.trajectories.cpu().numpy()[rows]
