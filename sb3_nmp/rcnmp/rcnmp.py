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
from sb3_nmp.common.population import PopulationSearch, blend, crossover_pairs
from sb3_nmp.rcnmp.policies import RCNMPPolicy
from sb3_nmp.rcnmp.training import Elbo, TrainingSettings, batches, elbo


@dataclass(frozen=True)
class LatentPlan:
    """The latents of a generation's N members: until a cut in time, and from it on.

    :param before: shape (N, Z)
    :param after: shape (N, Z)
    :param cuts: time index of the cut, shape (N,)
    """

    before: NDArray[np.float32]
    after: NDArray[np.float32]
    cuts: NDArray[np.int_]


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
    :param mutation: noise of the first generation, in the trajectory's unit; None switches it off
    :param mutation_decay: factor on the noise after each generation, in (0, 1]
    :param pd_controller: filter of every trajectory, from the initial trajectory's first point to
        its last one; None sends trajectories as they are
    :param initial_trajectories: demonstrations or guesses whose rewards are not known, shape
        (T, D) or (M, T, D); by default the environment's ``initial_trajectory``
    :param buffer_size: rollouts kept; None keeps all
    :param n_elites: best rollouts that a full buffer never drops
    :param reward_scaling: how rewards enter: ``"rank"`` in [-1, 1], or ``"standardize"``
    :param reward_conditioning: whether the network sees the reward
    :param temperature: rollouts are drawn for training with weight exp(scaled reward / this)
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
        learning_rate: float | Schedule = 2e-3,
        n_sampled: int = 10,
        n_crossover: int = 10,
        mutation: SmoothNoise | None = SmoothNoise(0.15),  # noqa: B008 (frozen)
        mutation_decay: float = 0.78,
        pd_controller: PDController | None = PDController(),  # noqa: B008 (frozen)
        initial_trajectories: ArrayLike | None = None,
        buffer_size: int | None = None,
        n_elites: int = 1,
        reward_scaling: Literal["rank", "standardize"] = "rank",
        reward_conditioning: bool = True,
        temperature: float = 0.05,
        beta: float = 1.0,
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
        self.reward_scaling: Literal["rank", "standardize"] = reward_scaling
        self.reward_conditioning = reward_conditioning
        self.beta = beta
        self.training = training
        self._plan: LatentPlan | None = None
        super().__init__(
            policy=policy,
            env=env,
            n_plain=n_sampled,
            n_crossover=n_crossover,
            mutation=mutation,
            mutation_decay=mutation_decay,
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
        enough = 2 if self.n_crossover else 1
        return {
            "n_sampled": (
                self.n_sampled >= enough,
                f"at least {enough}" + (": a crossover needs two parents" if enough == 2 else ""),
            ),
            "beta": (self.beta >= 0, ">= 0"),
            "reward_scaling": (
                self.reward_scaling in ("rank", "standardize"),
                "'rank' or 'standardize'",
            ),
        } | super()._rules()

    def _draw_members(self) -> None:
        """Draw latents from N(0, I) (III) and cross random pairs of them over (IV)."""
        if not self.policy.is_scaled:  # the buffer was seeded by the user
            self._train()
        shape = (self.n_sampled, self.policy.latent_dim)
        latents = self.rng.standard_normal(shape).astype(np.float32)
        n_time_points = self.policy.trajectory_shape[0]
        before, after, cuts = crossover_pairs(
            self.rng, self.n_sampled, self.n_crossover, n_time_points
        )
        self._plan = LatentPlan(
            before=np.concatenate([latents, latents[before]]),
            after=np.concatenate([latents, latents[after]]),
            cuts=np.concatenate([np.full(self.n_sampled, n_time_points), cuts]),
        )

    def _member(self, member: int, context: NDArray[np.float32]) -> NDArray[np.float64]:
        """Decode both latents of a member and blend them at its cut, shape (T, D)."""
        plan = cast(LatentPlan, self._plan)
        latents = np.stack([plan.before[member], plan.after[member]])
        contexts = th.as_tensor(context, device=self.device).expand(2, -1)
        with th.no_grad():
            decoded = self.policy.generate(contexts, th.as_tensor(latents, device=self.device))
        before, after = decoded.cpu().numpy().astype(np.float64)
        return blend(before, after, int(plan.cuts[member]))

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
            selection_weights(scores, self.temperature),
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
