"""RC-NMP: skill learning as supervised learning, conditioned on reward (thesis chapter 6)."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, cast

import numpy as np
import torch as th
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, Schedule

from sb3_nmp.common.algorithm import Generation
from sb3_nmp.common.buffer import scale_rewards, selection_weights
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.common.population import PopulationSearch, blend
from sb3_nmp.rcnmp.policies import RCNMPPolicy
from sb3_nmp.rcnmp.training import Elbo, TrainingSettings, batches, elbo


@dataclass(frozen=True)
class Plan:
    """What a generation's N members are made of, drawn before their contexts are known.

    The first members are decoded from ``latents``; crossover children blend that with a partner
    at a cut in time: a stored rollout, or what ``partner_latents`` decode to.

    :param latents: shape (N, Z)
    :param partner_latents: shape (N, Z)
    :param partner_rows: stored rollouts by their row in the buffer, shape (N,); -1 for none
    :param cuts: time index of the cut, shape (N,)
    :param partner_first: whether the partner makes the part before the cut, shape (N,)
    """

    latents: NDArray[np.float32]
    partner_latents: NDArray[np.float32]
    partner_rows: NDArray[np.int_]
    cuts: NDArray[np.int_]
    partner_first: NDArray[np.bool_]


class RCNMP(PopulationSearch):
    """Reward Conditioned Neural Movement Primitives (thesis 6.1).

    A generation, with the numerals of Fig. 6.1: train the reward-conditioned neural process on
    the replay buffer (I, II, Eq. 6.2); decode latents drawn from N(0, I) at the best reward (III);
    cross pairs of latents over in time (IV); add smooth noise (V); filter by a PD controller (VI,
    Eq. 6.3); execute, and store what was executed. The first generation is the initial trajectory
    and mutations of it.

    Where this departs from the original code (measured in results/experiments/rcnmp_bottles.md):
    the buffer keeps every rollout; rewards enter as ranks; good rollouts are drawn more often in
    training; the noise is smoother; both crossover children are kept with their parents swapped;
    what is stored has passed the PD controller.

    Every element can be switched off: ``n_crossover=0``, ``mutation=None``,
    ``pd_controller=None``, ``reward_conditioning=False``, ``beta=0``, ``temperature=math.inf``
    (draws every stored rollout alike), ``buffer_size=population`` with ``n_elites=0`` (keeps the
    last generation only).

    :param policy: ``"MlpPolicy"``
    :param env: the environment or its id
    :param learning_rate: of Adam, or a schedule of it
    :param n_sampled: members of a generation that are decoded from one latent
    :param n_crossover: members that are crossover children, even
    :param elite_parents: one parent of each crossover is a stored rollout, drawn like those for
        training; otherwise both are decoded latents, as in the thesis
    :param latent_std: standard deviation of the latents in the search, where training has 1
    :param mutation: noise of the first generation, in the trajectory's unit; None switches it off
    :param mutation_decay: factor on the noise after each generation, in (0, 1]
    :param mutation_rate: probability with which each basis of the noise takes part
    :param n_explorers: members of every generation, the first ones, that mutate the initial
        trajectory as in the first generation
    :param pd_controller: filter of every trajectory, from the initial trajectory's first point to
        its last one; None sends trajectories as they are
    :param initial_trajectories: demonstrations or guesses whose rewards are not known, shape
        (T, D) or (M, T, D); by default the environment's ``initial_trajectory``
    :param buffer_size: rollouts kept; None keeps all
    :param n_elites: best rollouts that a full buffer never drops
    :param reward_scaling: how the network sees rewards: ``"rank"`` in [-1, 1], or
        ``"standardize"``
    :param reward_conditioning: whether the network sees the reward
    :param temperature: rollouts are drawn, for training and as parents, with probability
        proportional to exp(-place / this), where the best has place 0
    :param beta: weight of the KL divergence in Eq. 6.2
    :param training: length and mini-batches of the training after each generation
    :param policy_kwargs: further arguments of `RCNMPPolicy`
    :param stats_window_size: rollouts over which the log averages
    :param tensorboard_log: folder for TensorBoard; None switches it off
    :param verbose: 0 nothing, 1 the log table, 2 debug messages
    :param seed: equal seeds give equal runs, bit for bit
    :param device: of the network
    :param _init_setup_model: whether to build the network at once
    :raises ConfigurationError: a value outside its range, or a population that does not fit
    """

    policy: RCNMPPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": RCNMPPolicy}

    def __init__(
        self,
        policy: str | type[RCNMPPolicy],
        env: GymEnv | str,
        learning_rate: float | Schedule = 3e-3,
        n_sampled: int = 4,
        n_crossover: int = 16,
        elite_parents: bool = True,
        latent_std: float = 3.0,
        mutation: SmoothNoise | None = SmoothNoise(),  # noqa: B008 (frozen)
        mutation_decay: float = 0.7,
        mutation_rate: float = 0.5,
        n_explorers: int = 0,
        pd_controller: PDController | None = PDController(),  # noqa: B008 (frozen)
        initial_trajectories: ArrayLike | None = None,
        buffer_size: int | None = None,
        n_elites: int = 1,
        reward_scaling: Literal["rank", "standardize"] = "rank",
        reward_conditioning: bool = True,
        temperature: float = 4.0,
        beta: float = 0.3,
        training: TrainingSettings = TrainingSettings(),  # noqa: B008 (frozen)
        policy_kwargs: dict[str, Any] | None = None,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: th.device | str = "cpu",
        _init_setup_model: bool = True,
    ) -> None:
        self.n_sampled = n_sampled
        self.elite_parents = elite_parents
        self.latent_std = latent_std
        self.reward_scaling: Literal["rank", "standardize"] = reward_scaling
        self.reward_conditioning = reward_conditioning
        self.beta = beta
        self.training = training
        self._plan: Plan | None = None
        super().__init__(
            policy=policy,
            env=env,
            n_plain=n_sampled,
            n_crossover=n_crossover,
            mutation=mutation,
            mutation_decay=mutation_decay,
            mutation_rate=mutation_rate,
            n_explorers=n_explorers,
            pd_controller=pd_controller,
            initial_trajectories=initial_trajectories,
            buffer_size=buffer_size,
            n_elites=n_elites,
            temperature=temperature,
            learning_rate=learning_rate,
            policy_kwargs=policy_kwargs,
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            seed=seed,
            device=device,
            _init_setup_model=_init_setup_model,
        )

    def _rules(self) -> dict[str, tuple[bool, str]]:
        return {
            "n_sampled": (
                self.n_sampled >= 0 and self.n_sampled + self.n_crossover > 0,
                ">= 0, and positive without crossover",
            ),
            "latent_std": (self.latent_std > 0, "> 0"),
            "beta": (self.beta >= 0, ">= 0"),
            "reward_scaling": (
                self.reward_scaling in ("rank", "standardize"),
                "'rank' or 'standardize'",
            ),
        } | super()._rules()

    def _draw_members(self) -> None:
        """Draw latents (III), and partners and cuts for both children of each crossover (IV)."""
        if not self.policy.is_scaled:  # the buffer was seeded by the user
            self._train()
        rng, n_pairs = self.rng, self.n_crossover // 2
        size, n_time_points = self.policy.latent_dim, self.policy.trajectory_shape[0]
        latents = rng.standard_normal((2, self.n_sampled + n_pairs, size)).astype(np.float32)
        pair = np.concatenate(
            [np.arange(self.n_sampled), self.n_sampled + np.repeat(np.arange(n_pairs), 2)]
        )
        rows = np.full(self.n_sampled + n_pairs, -1)
        if self.elite_parents:
            weights = selection_weights(self.replay_buffer.rewards, self.temperature)
            rows = rng.choice(len(weights), len(rows), p=weights)
        self._plan = Plan(
            latents=self.latent_std * latents[0, pair],
            partner_latents=self.latent_std * latents[1, pair],
            partner_rows=rows[pair],
            cuts=rng.integers(1, n_time_points, len(rows))[pair],
            partner_first=(np.arange(len(pair)) - self.n_sampled) % 2 == 0,
        )

    def _member(self, member: int, context: NDArray[np.float32]) -> NDArray[np.float64]:
        plan = cast(Plan, self._plan)
        sampled = self._decode(plan.latents[member], context)
        if member < self.n_sampled:
            return sampled
        row, cut = int(plan.partner_rows[member]), int(plan.cuts[member])
        if row < 0:
            partner = self._decode(plan.partner_latents[member], context)
        else:
            partner = self.replay_buffer.trajectories[row].astype(np.float64)
        if plan.partner_first[member]:
            return blend(partner, sampled, cut)
        return blend(sampled, partner, cut)

    def _decode(
        self, latent: NDArray[np.float32], context: NDArray[np.float32]
    ) -> NDArray[np.float64]:
        """Return the network's trajectory for one latent at the best reward, shape (T, D)."""
        rows = [th.as_tensor(row[None], device=self.device) for row in (context, latent)]
        with th.no_grad():
            return self.policy.generate(*rows)[0].cpu().numpy().astype(np.float64)

    def _end_generation(self, generation: Generation) -> None:
        super()._end_generation(generation)
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
        bound: Elbo | None = None
        for batch in batches(
            self.training,
            policy.times,
            policy.normalise(buffer.trajectories),
            policy.condition(contexts, rewards),
            selection_weights(buffer.rewards, self.temperature),
            policy.latent_dim,
            self.rng,
        ):
            bound = elbo(policy.network, batch, self.beta)
            policy.optimizer.zero_grad()
            bound.loss.backward()
            policy.optimizer.step()
        policy.train(False)
        if bound is not None:
            self.logger.record("train/loss", bound.loss.item())
            self.logger.record("train/log_likelihood", bound.log_likelihood.item())
            self.logger.record("train/kl_divergence", bound.divergence.item())

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return ["policy", "policy.optimizer"], []
