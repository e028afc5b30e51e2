"""`ACNMP`: a network learned from demonstrations, and a search where it fails (thesis ch. 5)."""

import copy
import warnings
from typing import Any, ClassVar, Self, Unpack, cast, get_args

import numpy as np
import torch as th
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, Schedule, TensorDict
from stable_baselines3.common.utils import update_learning_rate

from sb3_nmp.acnmp.distribution import TrajectoryDistribution
from sb3_nmp.acnmp.losses import PolicyGradient
from sb3_nmp.acnmp.policy import ACNMPPolicy
from sb3_nmp.acnmp.search import PolicySearch
from sb3_nmp.acnmp.searching import SearchingAlgorithm, SearchKind
from sb3_nmp.acnmp.settings import ACNMPAdaptation, ACNMPExploration
from sb3_nmp.bayesian.search import CriticSearch, any_has_aimed
from sb3_nmp.bayesian.settings import SEARCH_SPACE, ACNMPCritic
from sb3_nmp.common import files
from sb3_nmp.common.adaptive import AdaptiveArguments
from sb3_nmp.common.context_search import ContextSearch
from sb3_nmp.common.exceptions import UntrainedWarning
from sb3_nmp.common.rollouts import Generation, Information
from sb3_nmp.common.settings import Rules
from sb3_nmp.common.tuning import SearchSpace
from sb3_nmp.models.cnmp_training import (
    CNMPPretraining,
    PointSampler,
    cosine,
    negative_log_likelihood,
    pretrain,
)


class ACNMP(SearchingAlgorithm):
    """Adaptive conditional neural movement primitives.

    The steps are those of Fig. 5.1. (I) A CNMP is trained on the demonstrations (Eq. 4.1). (II-IV)
    It answers each context with a trajectory, which is executed. (V) Where that is not
    satisfactory, a search begins. (VI) Rollouts explore in smooth noise that is shaped like the
    demonstrations, and in directions of their latent space if these are asked for
    (`ACNMPExploration`). (VII) The network is trained on these rollouts by policy gradient (Eq.
    5.2) and on the demonstrations by likelihood (Eq. 4.1) in turns. (VIII) A solved context is
    assimilated: its trajectory joins the demonstrations.

    With ``search="policy"`` the network drives the search, as in the thesis: each generation is
    drawn around its present answer. With ``search="critic"``, the default, a Gaussian process
    chooses the rollouts by all earlier ones in the context: Bayesian optimisation around the
    network's first answer (`sb3_nmp.bayesian.search.CriticSearch`), which needs fewer rollouts. In
    both the network learns from the rollouts: in the end its own answer (``policy.own_answer``)
    mostly succeeds.

    Where this departs from the thesis: a generation has ``population_size`` rollouts instead of
    two; the policy gradient weighs all rollouts of the context by their place instead of the last
    ones by their advantage; how far is explored adapts as a trust region does. What each part
    brings is measured in ``results/experiments/acnmp.md``. The critic reads the reward's terms
    (``info["reward_<term>"]``) and what a rollout achieved (``info["achieved_context"]``) where the
    environment tells them, unless ``ACNMPCritic(terms=False, achieved=False)``.

    >>> import benchmark_envs
    >>> from sb3_nmp import Demonstrations
    >>> shown = Demonstrations.from_task("nmp/Bottles-v0", 3, seed=0)
    >>> quick = CNMPPretraining(n_steps=20)
    >>> model = ACNMP("MlpPolicy", "nmp/Bottles-v0", demonstrations=shown, pretraining=quick)
    >>> model.learn(6).predict(shown.contexts[0], deterministic=True)[0].shape
    (200, 2)

    :param learning_rate: of Adam after the pre-training, or a schedule of it; after each
        generation it starts there and falls to a hundredth along a cosine
    :param search: what chooses a search's rollouts: ``"critic"``, a Gaussian process, or
        ``"policy"``, the network: draws around its answer. There 5 rollouts per generation are good
    :param exploration: directions and scales of exploration
    :param critic: settings of the critic; without effect on ``search="policy"``
    :param adaptation: how the network is trained after a generation; beside a critic by policy
        gradient only in a pinned context, at the first success and whenever a seventh more rollouts
        are known than when it was trained last
    :param pretraining: length and batches of the training on demonstrations
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": ACNMPPolicy}
    rehearses: ClassVar[bool] = True
    tunable: ClassVar[SearchSpace] = SEARCH_SPACE

    def __init__(
        self,
        policy: str | type[ACNMPPolicy],
        env: GymEnv | str,
        *,
        learning_rate: float | Schedule = 1e-3,
        population_size: int = 1,
        max_generations: int = 60,
        n_successes: int = 5,
        search: SearchKind = "critic",
        exploration: ACNMPExploration = ACNMPExploration(),  # noqa: B008 (frozen)
        critic: ACNMPCritic = ACNMPCritic(),  # noqa: B008 (frozen)
        adaptation: ACNMPAdaptation = ACNMPAdaptation(),  # noqa: B008 (frozen)
        pretraining: CNMPPretraining = CNMPPretraining(),  # noqa: B008 (frozen)
        **shared: Unpack[AdaptiveArguments],
    ) -> None:
        self.search = search
        self.exploration, self.critic = exploration, critic
        self.adaptation, self.pretraining = adaptation, pretraining
        self.is_pretrained = self.has_aimed = False
        super().__init__(
            policy,
            env,
            learning_rate=learning_rate,
            population_size=population_size,
            max_generations=max_generations,
            n_successes=n_successes,
            **shared,
        )

    @property
    def information(self) -> frozenset[Information]:
        """What the critic sees besides, and step rewards for the advantages they make."""
        settings, told = self.adaptation, set(super().information)
        if self.search == "critic" and self.critic.terms:
            told.add(Information.TERMS)
        if self.has_aimed:
            told.add(Information.ACHIEVED_CONTEXTS)
        if settings.n_training_steps > 0 and settings.advantage != "place":
            told.add(Information.STEP_REWARDS)
        return frozenset(told)

    def _rules(self) -> Rules:
        return {
            "search": (self.search in get_args(SearchKind), "'critic' or 'policy'"),
            "adaptation": self.adaptation.rule_for(self.population_size),
            **super()._rules(),
        }

    # -- learning from demonstration (I) -------------------------------------------------------

    def pretrain(self) -> Self:
        """Train the CNMP on the demonstrations (Eq. 4.1); `learn` does so first by itself."""
        self._recall_demonstrations()
        pretrain(self.training_set(), self.pretraining, self.rng, self.policy.cnmp)
        self.is_pretrained = True
        return self

    def set_parameters(
        self,
        load_path_or_dict: files.AnyPath | TensorDict,
        exact_match: bool = True,
        device: th.device | str = "auto",
        *,
        allow_pickle: bool = False,
    ) -> None:
        """Take over parameters; see `TrajectoryAlgorithm`.

        A trained network's are not trained anew by `learn`.

        :param load_path_or_dict: a file that `save` wrote, or what `get_parameters` returned
        :param exact_match: whether all parameters must be given
        :param device: of the parameters while they are read
        :param allow_pickle: as in `load`
        """
        super().set_parameters(load_path_or_dict, exact_match, device, allow_pickle=allow_pickle)
        self.is_pretrained = self.policy.cnmp.is_scaled

    def _setup_learn(self, *args: Any, **kwargs: Any) -> tuple[int, Any]:  # noqa: ANN401
        if not self.is_pretrained:
            self.pretrain()  # first, so that callbacks find a policy that can answer
        return super()._setup_learn(*args, **kwargs)

    def predict(
        self,
        observation: NDArray[Any] | dict[str, NDArray[Any]],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = False,
        via_points: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """Return a trajectory for a context, or for each of several; see SB3.

        :param observation: context of shape (C,), or (N, C)
        :param state: unused
        :param episode_start: unused
        :param deterministic: the greedy trajectory instead of a sample
        :param via_points: that the trajectory passes: times in [0, 1], shape (O,), and values in
            the trajectory's unit, shape (O, D). A `ViaPointWarning` tells of those that the action
            space keeps it from
        :return: shape (T, D), or (N, T, D); and ``state``
        :raises InvalidDataError: via-points of a wrong shape, at times outside [0, 1], outside the
            action space, or that contradict each other
        """
        self._warn_untrained()
        if via_points is None:
            return super().predict(observation, state, episode_start, deterministic)
        contexts, vectorized = self.policy.obs_to_tensor(observation)
        with th.no_grad():
            passing = self.policy.through(cast(th.Tensor, contexts), via_points, deterministic)
        trajectories = passing.cpu().numpy()
        return (trajectories if vectorized else trajectories[0]), state

    def predict_distribution(
        self,
        context: NDArray[Any],
        via_points: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> TrajectoryDistribution:
        """Return what the network expects in a context, and how sure it is.

        The aleatoric spread is the network's own Gaussian (Eq. 4.1), the epistemic one that of the
        members' means (`CNMPArchitecture`'s ``n_members``; Lakshminarayanan et al., "Simple and
        scalable predictive uncertainty estimation using deep ensembles", 2017). Both are near 0 at
        via-points. Trajectories that were found by rollouts, with which `predict` answers in their
        contexts, are left aside.

        :param context: of shape (C,), or (N, C)
        :param via_points: as in `predict`
        :return: arrays of shape (T, D), or (N, T, D), in the trajectory's unit
        :raises InvalidDataError: as `predict` does
        """
        self._warn_untrained()
        contexts, vectorized = self.policy.obs_to_tensor(context)
        with th.no_grad():
            found = self.policy.distribution(cast(th.Tensor, contexts), via_points)
        return found if vectorized else found.first()

    def _warn_untrained(self) -> None:
        if not self.is_pretrained and not self.policy.cnmp.is_scaled:
            warnings.warn(
                "this ACNMP has learned nothing yet, so its answers mean nothing: call learn, or "
                "pretrain, which spends no rollout.",
                UntrainedWarning,
                stacklevel=3,
            )

    # -- simultaneous training (VII, VIII) -----------------------------------------------------

    def _adapt(self, searched: list[ContextSearch], solved: list[ContextSearch]) -> None:
        settings = self.adaptation
        self.has_aimed = self.has_aimed or any_has_aimed(searched)
        taught = [each for each in searched if self._teaches(each)]
        n_gradients = settings.n_training_steps if taught else 0
        n_steps = n_gradients
        if solved and not (self._pinned and settings.imitates):
            n_steps += settings.n_assimilation_steps
        if n_steps == 0:
            return
        self._train(taught, n_gradients, n_steps, self.rng, self._current_progress_remaining)
        self._tell_searches(taught)

    def _train(
        self,
        taught: list[ContextSearch],
        n_gradients: int,
        n_steps: int,
        rng: np.random.Generator,
        progress: float,
    ) -> None:
        """Train by likelihood (Eq. 4.1) and, in alternating steps, by policy gradient (Eq. 5.2).

        :param taught: searches that the policy gradient learns from
        :param n_gradients: steps of it, beside the first ones of the likelihood
        :param n_steps: of the likelihood
        :param rng: the generator to draw batches from
        :param progress: remaining, for which a schedule gives the learning rate
        """
        policy, settings, highest = self.policy, self.adaptation, self.lr_schedule(progress)
        policy.train()
        gradient = self._policy_gradient(taught) if n_gradients else None
        network = policy.cnmp.network
        beta = 0.0 if gradient else network.beta_nll  # beside Eq. 5.2 it is Eq. 4.1 as it is
        for step, batch in enumerate(self._sampler(rng).draw(n_steps)):
            update_learning_rate(policy.optimizer, cosine(highest, step / n_steps))
            if settings.supervised:
                self._step(negative_log_likelihood(network, batch, beta))
            if gradient is not None and step < n_gradients:
                self._step(gradient.loss())
        policy.train(False)

    def _step(self, loss: th.Tensor) -> None:
        """Take one step of the optimiser down the gradient of a loss of the present weights."""
        self.policy.optimizer.zero_grad()
        loss.backward()
        self.policy.optimizer.step()

    def _end_learning(self) -> None:
        """Bring the network's own answer to what a critic has found in a pinned context.

        Batches come from a copy of the generator, and the critic does not ask the network: a search
        that goes on does not depend on this. The rate is a schedule's first one: many end at 0.
        """
        found = [
            s
            for s in self.searches
            if isinstance(s.search, CriticSearch) and s.search.has_succeeded
        ]
        n_steps = self.adaptation.n_final_steps
        if self._pinned and found and self.adaptation.imitates and n_steps:
            self._train(found, n_steps, n_steps, copy.deepcopy(self.rng), 1.0)

    def _tell_searches(self, taught: list[ContextSearch]) -> None:
        """Let critics' searches know when they were learned from, and others follow the network.

        :param taught: those that the network has learned from by policy gradient
        """
        for each in taught:
            if isinstance(each.search, CriticSearch):
                each.search.was_taught()
        for each in self.searches:
            if isinstance(each.search, PolicySearch):
                each.search.follow(self.policy.cnmp.trajectories(each.context[None])[0])

    def _teaches(self, searched: ContextSearch) -> bool:
        """Return whether the network learns from a search by policy gradient now.

        One that drives the search always does; beside a critic now and then in a pinned context,
        but not among drawn ones: the best of bad rollouts would move its answers elsewhere.
        """
        if isinstance(searched.search, PolicySearch):
            return True
        return self._pinned and cast(CriticSearch, searched.search).is_to_be_taught

    def _sampler(self, rng: np.random.Generator) -> PointSampler:
        cnmp, known = self.policy.cnmp, self.training_set()
        modes = cnmp.nearest_modes(known)
        cnmp.teach_gate(known, modes)
        if self.adaptation.keep_answers and not self._pinned:
            known = known.joined_with(*self._satisfying_answers())
            modes = cnmp.nearest_modes(known)
        return PointSampler(
            self.pretraining,
            cnmp.times,
            cnmp.normalise(cnmp.times.new_tensor(known.trajectories)),
            cnmp.condition(cnmp.times.new_tensor(known.contexts), modes),
            rng,
            cnmp.network.n_members,
        )

    def _policy_gradient(self, searched: list[ContextSearch]) -> PolicyGradient:
        rollouts = [
            self._learned_from(cast(CriticSearch | PolicySearch, s.search)) for s in searched
        ]
        contexts = np.stack([each.context for each in searched])
        return PolicyGradient(self.policy.cnmp, self.adaptation, contexts, rollouts)

    def _learned_from(self, search: CriticSearch | PolicySearch) -> Generation:
        """Return the rollouts of the policy gradient: all of them if they learn by place."""
        if self.adaptation.advantage == "place":
            return Generation.concatenate(search.rollouts)
        return search.rollouts[-1]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return ["policy", "policy.optimizer"], []
