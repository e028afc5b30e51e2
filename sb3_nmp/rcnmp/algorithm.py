"""RC-NMP: skill learning as supervised learning, conditioned on reward (thesis chapter 6)."""

from dataclasses import dataclass
from typing import ClassVar, Unpack, get_args

import numpy as np
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, Schedule

from sb3_nmp.common.buffer import RewardScaling, scale_rewards, selection_weights
from sb3_nmp.common.contextual import TUNABLE_OVER_CONTEXTS
from sb3_nmp.common.lockstep import train
from sb3_nmp.common.niches import View
from sb3_nmp.common.operators import blend
from sb3_nmp.common.population import PopulationArguments, PopulationSearch
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import Rules
from sb3_nmp.common.tuning import Choice, Range, SearchSpace
from sb3_nmp.rcnmp.policy import RCNMPPolicy
from sb3_nmp.rcnmp.reward_model import judge
from sb3_nmp.rcnmp.settings import RCNMPRewardModel, RCNMPTraining
from sb3_nmp.rcnmp.training import ElboPhase, batches


@dataclass(frozen=True)
class Parents:
    """What N offspring are made of.

    Each follows its first parent until its cut in time, and its second parent from it on. A parent
    is a stored rollout, or what its latent decodes to.

    :param latents: of both parents, and their categories' one-hot vectors where there are several,
        shape (2, N, code_dim)
    :param rows: of both parents: the stored rollout's row in the buffer, -1 for none, shape (2, N)
    :param cuts: time index of the cut, shape (N,); T where there is no second parent
    """

    latents: NDArray[np.float32]
    rows: NDArray[np.int_]
    cuts: NDArray[np.int_]


class RCNMP(PopulationSearch):
    """Reward Conditioned Neural Movement Primitives (thesis 6.1).

    A generation, with the numerals of Fig. 6.1: train the reward-conditioned neural process on
    the replay buffer (I, II, Eq. 6.2); decode latents drawn from a Gaussian at the best reward
    (III); cross pairs of parents, latents or stored rollouts, over in time (IV); add smooth noise
    (V); filter by a PD controller (VI, Eq. 6.3); of ``n_candidates`` for each member execute the
    one that an ensemble trained on all rollouts holds for the likeliest to earn the wanted reward
    (`RCNMPRewardModel`), and store what was sent. The first generation is the initial trajectory
    and mutations of it.

    Where this departs from the original code (measured in results/experiments/rcnmp_bottles.md):
    the buffer keeps every rollout; rewards enter as ranks; good rollouts are drawn more often in
    training; the latents of the search are wider than the prior; parents of a crossover may be
    stored rollouts; the noise is smoother and, after the first generation, sparse; both crossover
    children are kept with their parents swapped; what is stored has passed the PD controller.

    On an environment that draws contexts it learns a skill for all of them. Each rollout tries the
    present answer to a new context, with noise. The answer is the mode of
    ``p(w | c, r*) ~ p(w | c) p(r* | c, w)``: a regression on what was right, conditioned on the
    reward that successes have by an ensemble that has seen all rollouts (`RCNMPSkill`); where
    rollouts tell what they achieved, they are demonstrations of that (`RCNMPAchievement`). The
    operators of Fig. 6.1 have no part in it. How this was chosen stands in
    results/experiments/rcnmp_contexts.md.

    With ``n_modes`` above 1 it looks for several ways to do the task in one context
    (`sb3_nmp.common.niches`); ``policy.modes`` returns them, ``predict`` the best.

    Every element can be switched off: ``n_crossover=0``, ``mutation=None``,
    ``pd_controller=None``, ``reward_conditioning=False``, ``beta=0``, ``temperature=math.inf``
    (draws every stored rollout alike), ``buffer_size=population_size`` with ``n_elites=0`` (keeps
    the last generation only).

    >>> import benchmark_envs
    >>> model = RCNMP("MlpPolicy", "nmp/Bottles-v0", seed=0).learn(40)
    >>> model.predict(model.get_env().reset(), deterministic=True)[0].shape
    (1, 200, 2)

    :param elite_parents: probability that a parent of a crossover is a stored rollout, drawn like
        those for training, instead of a decoded latent; 0 is the thesis's crossover
    :param latent_std: standard deviation of the latents in the search, where training has 1
    :param reward_scaling: how the network sees rewards: ``"rank"`` in [-1, 1], ``"standardize"``
    :param reward_conditioning: whether the neural process sees the reward; ``n_candidates=1``
        switches the reward model off
    :param beta: weight of the KL divergence in Eq. 6.2
    :param training: length and mini-batches of the training after each generation
    :param reward_model: that judges candidates
    """

    policy: RCNMPPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": RCNMPPolicy}

    tunable: ClassVar[SearchSpace] = {
        "population_size": Choice((20, 30)),
        "mutation_decay": Range(0.65, 0.95),
        "mutation.n_bases": Range(6, 15, integer=True),
        "temperature": Range(1.0, 10.0, log=True),
    }
    tunable_over_contexts: ClassVar[SearchSpace] = TUNABLE_OVER_CONTEXTS

    def __init__(
        self,
        policy: str | type[RCNMPPolicy],
        env: GymEnv | str,
        *,
        learning_rate: float | Schedule = 3e-3,
        population_size: int = 20,
        n_crossover: int = 16,
        elite_parents: float = 0.6,
        latent_std: float = 3.0,
        mutation_decay: float = 0.75,
        n_explorers: int = 1,
        reward_scaling: RewardScaling = "rank",
        reward_conditioning: bool = True,
        temperature: float = 4.0,
        beta: float = 0.3,
        n_candidates: int = 10,
        training: RCNMPTraining = RCNMPTraining(),  # noqa: B008 (frozen)
        reward_model: RCNMPRewardModel = RCNMPRewardModel(),  # noqa: B008 (frozen)
        **shared: Unpack[PopulationArguments],
    ) -> None:
        self.elite_parents, self.latent_std = elite_parents, latent_std
        self.reward_scaling: RewardScaling = reward_scaling
        self.reward_conditioning = reward_conditioning
        self.beta, self.training, self.reward_model = beta, training, reward_model
        super().__init__(
            policy,
            env,
            learning_rate=learning_rate,
            population_size=population_size,
            n_crossover=n_crossover,
            mutation_decay=mutation_decay,
            n_explorers=n_explorers,
            temperature=temperature,
            n_candidates=n_candidates,
            **shared,
        )

    def _rules(self) -> Rules:
        return {
            "elite_parents": (0 <= self.elite_parents <= 1, "in [0, 1]"),
            "latent_std": (self.latent_std > 0, "> 0"),
            "beta": (self.beta >= 0, ">= 0"),
            "reward_scaling": (
                self.reward_scaling in get_args(RewardScaling),
                "'rank' or 'standardize'",
            ),
        } | dict(super()._rules())

    def _offspring(self, n: int, n_crossover: int, view: View) -> NDArray[np.float64]:
        """Decode samples (III), and cross pairs of parents over (IV)."""
        if not self.policy.is_scaled:  # the buffer was seeded by the user
            self._train()
        parents = self._draw_parents(n, n_crossover, view)
        before, after = (
            self._parent(latents, rows)
            for latents, rows in zip(parents.latents, parents.rows, strict=True)
        )
        return blend(before, after, parents.cuts)

    def _draw_parents(self, n: int, n_crossover: int, view: View) -> Parents:
        """Draw latents of samples, and parents and cuts of pairs of children.

        :param n: how many members
        :param n_crossover: so many, the last ones, are crossover children
        :param view: what the stored rollouts are worth
        """
        rng, n_time_points = self.rng, self.policy.trajectory_shape[0]
        n_plain, n_draws = n - n_crossover, n - n_crossover // 2
        latents, are_of_use = self._draw_latents(n_draws, view)
        weights = selection_weights(view.rewards, self.temperature)
        rows = rng.choice(len(weights), (2, n_draws), p=weights)
        if are_of_use:
            rows[rng.uniform(size=rows.shape) >= self.elite_parents] = -1
            rows[:, :n_plain] = -1
        cuts = rng.integers(1, n_time_points, n_draws)
        cuts[:n_plain] = n_time_points
        twins = slice(n_plain, None)  # the second child has the parents swapped
        return Parents(
            latents=np.concatenate([latents, latents[::-1, twins]], axis=1),
            rows=np.concatenate([rows, rows[::-1, twins]], axis=1),
            cuts=np.concatenate([cuts, cuts[twins]]),
        )

    def _draw_latents(self, n: int, view: View) -> tuple[NDArray[np.float32], bool]:
        """Draw latents of both parents, shape (2, n, code_dim), and tell whether they are of use.

        One network holds all ways to do the task, and a child of two of them is of neither: where
        a view is of one way, latents that decode to another are replaced by some that do not.

        :param n: how many pairs
        :param view: of one way or of all
        :return: besides, False where no latent decodes to the view's way
        """
        context = self.replay_buffer.contexts[-1]
        latents = self.policy.draw_codes(self.rng, context, (2, n), self.latent_std)
        if view.way is None:
            return latents, True
        codes = latents.reshape(2 * n, -1)
        line = self.initial.mean(axis=0)
        ways = self._niches.nearest(self._decode(codes), self.replay_buffer, line)
        own = np.flatnonzero(ways == view.way)
        if len(own) == 0:
            return latents, False
        others = np.flatnonzero(ways != view.way)
        codes[others] = codes[self.rng.choice(own, len(others))]
        return codes.reshape(latents.shape), True

    def _parent(self, latents: NDArray[np.float32], rows: NDArray[np.int_]) -> NDArray[np.float32]:
        """Return parents: stored rollouts, or what latents decode to, shape (N, T, D).

        :param latents: shape (N, code_dim)
        :param rows: of the stored ones, -1 for the others, shape (N,)
        """
        parents, decoded = self.replay_buffer.trajectories[rows], rows < 0
        parents[decoded] = self._decode(latents[decoded])
        return parents

    def _decode(self, latents: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return what latents (N, code_dim) decode to at the best reward, shape (N, T, D)."""
        codes = th.as_tensor(latents, device=self.device)
        context = th.as_tensor(self.replay_buffer.contexts[-1:], device=self.device)
        with th.no_grad():
            decoded = self.policy.generate(context.expand(len(codes), -1), codes)
        return decoded.cpu().numpy()

    def _promise(self, trajectories: NDArray[np.float64], view: View) -> NDArray[np.float64]:
        """Let an ensemble that has seen all rollouts judge."""
        generator = th.Generator().manual_seed(int(self.rng.integers(2**31)))
        stored = self.replay_buffer.trajectories
        return judge(stored, view, trajectories, self.reward_model, generator)

    def _begin_in_another_context(self, before: NDArray[np.float32]) -> None:
        super()._begin_in_another_context(before)
        self.policy.scale.zero_()  # the network's origin and unit are those of the new start

    def _end_generation(self, generation: Generation) -> None:
        super()._end_generation(generation)
        if self._search is None:
            self._train()

    def _train(self) -> None:
        """Train the network on the buffer (II)."""
        policy, buffer = self.policy, self.replay_buffer
        if not policy.is_scaled:
            policy.set_scale(self.initial.mean(axis=0), buffer.trajectories)
        self._update_learning_rate(policy.optimizer)
        scores = scale_rewards(buffer.rewards, self.reward_scaling)
        shown = scores if self.reward_conditioning else np.zeros_like(scores)
        policy.target_reward.fill_(shown.max())
        contexts = th.as_tensor(buffer.contexts, device=self.device)
        rewards = th.as_tensor(shown, dtype=th.float32, device=self.device)
        policy.train()
        drawn = batches(
            self.training,
            policy.times,
            policy.normalise(buffer.trajectories),
            policy.condition(contexts, rewards),
            self._shares(),
            policy.latent_dim,
            self.rng,
        )
        phase = ElboPhase(policy.network, policy.optimizer, self.training, drawn, self.beta)
        train(phase)
        policy.train(False)
        bound = phase.bound
        if bound is not None:
            self.logger.record("train/loss", bound.loss.item())
            self.logger.record("train/log_likelihood", bound.log_likelihood.item())
            self.logger.record("train/kl_divergence", bound.divergence.item())

    def _shares(self) -> NDArray[np.float64]:
        """Return with which probabilities stored rollouts are drawn, all modes alike, (N,)."""
        views = self._views(self.population_size)
        each = [selection_weights(view.rewards, self.temperature) for view in views]
        return np.mean(each, axis=0)

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return ["policy", "policy.optimizer"], []
