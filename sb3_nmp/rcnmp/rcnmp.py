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

    A member follows its first parent until its cut in time, and its second parent from it on. A
    parent is a stored rollout, or what its latent decodes to.

    :param latents: of both parents, shape (2, N, Z)
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
    (V); filter by a PD controller (VI, Eq. 6.3); execute, and store what was sent. The first
    generation is the initial trajectory and mutations of it.

    Where this departs from the original code (measured in results/experiments/rcnmp_bottles.md):
    the buffer keeps every rollout; rewards enter as ranks; good rollouts are drawn more often in
    training; the latents of the search are wider than the prior; parents of a crossover may be
    stored rollouts; the noise is smoother and, after the first generation, sparse; both crossover
    children are kept with their parents swapped; what is stored has passed the PD controller.

    Every element can be switched off: ``n_crossover=0``, ``mutation=None``,
    ``pd_controller=None``, ``reward_conditioning=False``, ``beta=0``, ``temperature=math.inf``
    (draws every stored rollout alike), ``buffer_size=population`` with ``n_elites=0`` (keeps the
    last generation only).

    :param policy: ``"MlpPolicy"``
    :param env: the environment or its id
    :param learning_rate: of Adam, or a schedule of it
    :param n_sampled: members of a generation that are decoded from one latent
    :param n_crossover: members that are crossover children, even
    :param elite_parents: probability that a parent of a crossover is a stored rollout, drawn like
        those for training, instead of a decoded latent; 0 is the thesis's crossover
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
        elite_parents: float = 0.6,
        latent_std: float = 3.0,
        mutation: SmoothNoise | None = SmoothNoise(),  # noqa: B008 (frozen)
        mutation_decay: float = 0.75,
        mutation_rate: float = 0.5,
        n_explorers: int = 1,
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
            "elite_parents": (0 <= self.elite_parents <= 1, "in [0, 1]"),
            "latent_std": (self.latent_std > 0, "> 0"),
            "beta": (self.beta >= 0, ">= 0"),
            "reward_scaling": (
                self.reward_scaling in ("rank", "standardize"),
                "'rank' or 'standardize'",
            ),
        } | super()._rules()

    def _draw_members(self) -> None:
        """Draw latents for samples (III), and parents and cuts for pairs of children (IV)."""
        if not self.policy.is_scaled:  # the buffer was seeded by the user
            self._train()
        rng, n_time_points = self.rng, self.policy.trajectory_shape[0]
        n_draws = self.n_sampled + self.n_crossover // 2
        shape = (2, n_draws, self.policy.latent_dim)
        latents = self.latent_std * rng.standard_normal(shape).astype(np.float32)
        weights = selection_weights(self.replay_buffer.rewards, self.temperature)
        rows = rng.choice(len(weights), (2, n_draws), p=weights)
        rows[rng.uniform(size=rows.shape) >= self.elite_parents] = -1
        rows[:, : self.n_sampled] = -1
        cuts = rng.integers(1, n_time_points, n_draws)
        cuts[: self.n_sampled] = n_time_points
        twins = slice(self.n_sampled, None)  # the second child has the parents swapped
        self._plan = Plan(
            latents=np.concatenate([latents, latents[::-1, twins]], axis=1),
            rows=np.concatenate([rows, rows[::-1, twins]], axis=1),
            cuts=np.concatenate([cuts, cuts[twins]]),
        )

    def _member(self, member: int, context: NDArray[np.float32]) -> NDArray[np.float64]:
        cut = int(cast(Plan, self._plan).cuts[member])
        first = self._parent(0, member, context)
        if cut == len(first):
            return first
        return blend(first, self._parent(1, member, context), cut)

    def _parent(self, which: int, member: int, context: NDArray[np.float32]) -> NDArray[np.float64]:
        """Return the first (0) or second (1) parent of a member, shape (T, D)."""
        plan = cast(Plan, self._plan)
        row = int(plan.rows[which, member])
        if row >= 0:
            return self.replay_buffer.trajectories[row].astype(np.float64)
        return self._decode(plan.latents[which, member], context)

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
