"""RC-NMP: skill learning as supervised learning, conditioned on reward (thesis chapter 6)."""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self, cast

import numpy as np
import torch as th
from numpy.typing import ArrayLike, NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback, Schedule

from sb3_nmp.common.algorithm import Generation, TrajectoryAlgorithm
from sb3_nmp.common.buffer import TrajectoryBuffer, ranks, selection_weights
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.rcnmp.policies import RCNMPPolicy


@dataclass(frozen=True)
class Plan:
    """What a generation of N members draws before their contexts are known.

    :param first: latent that makes a member's trajectory before its cut, shape (N, Z)
    :param second: latent that makes it from the cut on, shape (N, Z)
    :param cuts: time index of the cut, shape (N,)
    :param noise: the mutation, shape (N, T, D)
    :param start: initial trajectories instead of the network's, shape (N, T, D), or None
    """

    first: NDArray[np.float32]
    second: NDArray[np.float32]
    cuts: NDArray[np.int_]
    noise: NDArray[np.float64]
    start: NDArray[np.float64] | None


class RCNMP(TrajectoryAlgorithm):
    """Reward Conditioned Neural Movement Primitives."""

    policy: RCNMPPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": RCNMPPolicy}

    def __init__(
        self,
        policy: str | type[RCNMPPolicy],
        env: GymEnv | str,
        learning_rate: float | Schedule = 2e-3,
        n_sampled: int = 10,
        n_crossover: int = 10,
        mutation: SmoothNoise | None = SmoothNoise(0.15),
        mutation_decay: float = 0.88,
        pd_controller: PDController | None = PDController(),
        initial_trajectories: ArrayLike | None = None,
        buffer_size: int | None = None,
        reward_scaling: Literal["rank", "standardize"] = "rank",
        temperature: float = 0.1,
        beta: float = 0.01,
        n_training_steps: int = 400,
        batch_size: int = 32,
        n_target_points: int = 30,
        max_conditioning_points: int = 10,
        latent_scale: float = 1.0,
        policy_kwargs: dict[str, Any] | None = None,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: th.device | str = "cpu",
        _init_setup_model: bool = True,
    ) -> None:
        self.n_sampled, self.n_crossover = n_sampled, n_crossover
        self.mutation, self.mutation_decay = mutation, mutation_decay
        self.pd_controller = pd_controller
        self.initial_trajectories = initial_trajectories
        self.buffer_size = buffer_size
        self.reward_scaling, self.temperature = reward_scaling, temperature
        self.beta = beta
        self.n_training_steps, self.batch_size = n_training_steps, batch_size
        self.n_target_points = n_target_points
        self.max_conditioning_points = max_conditioning_points
        self.latent_scale = latent_scale
        self._plan: Plan | None = None
        super().__init__(
            policy=policy, env=env, population_size=n_sampled + n_crossover,
            learning_rate=learning_rate, policy_kwargs=policy_kwargs,
            stats_window_size=stats_window_size, tensorboard_log=tensorboard_log,
            verbose=verbose, seed=seed, device=device, _init_setup_model=_init_setup_model,
        )

    def _setup_model(self) -> None:
        super()._setup_model()
        self.replay_buffer = TrajectoryBuffer(
            self.policy.context_dim, self.policy.trajectory_shape, self.buffer_size
        )

    def learn(self, total_timesteps: int, callback: MaybeCallback = None, log_interval: int = 1, tb_log_name: str | None = None, reset_num_timesteps: bool = True, progress_bar: bool = False) -> Self:
        return super().learn(total_timesteps, callback, log_interval, tb_log_name, reset_num_timesteps, progress_bar)

    def _begin_generation(self) -> None:
        n, half = self.population_size, self.n_sampled
        shape, size = self.policy.trajectory_shape, self.policy.latent_dim
        first = self.latent_scale * self.rng.standard_normal((n, size))
        second = first.copy()
        cuts = np.full(n, shape[0])
        for i in range(half, n, 2):
            a, b = self.rng.choice(half, 2, replace=False)
            cut = self.rng.integers(1, shape[0])
            first[i], second[i], cuts[i] = first[a], first[b], cut
            if i + 1 < n:
                first[i + 1], second[i + 1], cuts[i + 1] = first[b], first[a], cut
        noise = np.zeros((n, *shape))
        if self.mutation is not None:
            noise = self.mutation.sample(self.rng, n, shape, self.mutation_decay**self._n_updates)
        start = None
        if len(self.replay_buffer) == 0:
            line = self.initial_trajectory()
            self.policy.offset = th.as_tensor(line, dtype=th.float32)
            start = np.broadcast_to(line, noise.shape)
            noise[0] = 0
        self._plan = Plan(first.astype(np.float32), second.astype(np.float32), cuts, noise, start)

    def _propose(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        plan = cast(Plan, self._plan)
        out = []
        for i, context in zip(range(members.start, members.stop), contexts, strict=True):
            if plan.start is not None:
                desired = plan.start[i]
            else:
                z = th.as_tensor(np.stack([plan.first[i], plan.second[i]]))
                with th.no_grad():
                    a, b = self.policy.generate(th.as_tensor(context).expand(2, -1), z).numpy().astype(np.float64)
                desired = np.where(np.arange(len(a))[:, None] < plan.cuts[i], a, b)
            out.append(desired + plan.noise[i])
        X = np.stack(out)
        if self.pd_controller is not None:
            line = self.policy.offset.numpy().astype(np.float64)
            X = np.concatenate([self.pd_controller(x[None], line[0], line[-1]) for x in X])
        return X

    def _observe(self, rollouts: Generation) -> None:
        self.policy.elites.update(rollouts.contexts, rollouts.trajectories, rollouts.rewards)

    def _end_generation(self, generation: Generation) -> None:
        self.replay_buffer.add(generation.contexts, generation.trajectories, generation.rewards)
        if self._n_updates == 0:
            dev = self.replay_buffer.trajectories - self.policy.offset.numpy()
            self.policy.scale = th.as_tensor(dev.std(axis=(0, 1)).clip(1e-6), dtype=th.float32)
        self._train()

    def _train(self) -> None:
        buffer, policy = self.replay_buffer, self.policy
        scores = ranks(buffer.rewards) if self.reward_scaling == "rank" else None
        assert scores is not None
        w = selection_weights(scores, self.temperature)
        S, B, K = self.n_training_steps, self.batch_size, self.n_target_points
        T = policy.trajectory_shape[0]
        rows = self.rng.choice(len(buffer), (S, B), p=w)
        n_obs = self.rng.integers(1, self.max_conditioning_points + 1, S)
        t_idx = self.rng.integers(0, T, (S, B, K + self.max_conditioning_points))
        eps = th.as_tensor(self.rng.standard_normal((S, B, policy.latent_dim), dtype=np.float32))
        rows_t, t_idx = th.as_tensor(rows), th.as_tensor(t_idx)
        Y = policy.normalise(buffer.trajectories)
        cond = policy.condition(th.as_tensor(buffer.contexts), th.as_tensor(scores, dtype=th.float32))
        losses = 0.
        for s in range(S):
            r = rows_t[s]; ti = t_idx[s]
            y = Y[r[:, None], ti]; t = policy.times[ti]; c = cond[r]
            o = K + int(n_obs[s])
            q = policy.network.encode(t[:, K:o], y[:, K:o], c)
            z = q.mean + q.stddev * eps[s]
            p = policy.network.decode(t[:, :K], z, c)
            ll = -((y[:, :K] - p.mean) ** 2).sum(-1).mean() / (2 * policy.network.decoder_std ** 2)
            kl = (0.5 * (q.mean ** 2 + q.stddev ** 2 - 1) - q.stddev.log()).sum(-1).mean()
            loss = -ll + self.beta * kl
            policy.optimizer.zero_grad(set_to_none=True)
            loss.backward()
            policy.optimizer.step()
        self.logger.record("train/loss", float(loss.detach()))
        self.logger.record("train/kl", float(kl.detach()))
        self.logger.record("train/mse", float(-ll.detach()*2*policy.network.decoder_std**2))
