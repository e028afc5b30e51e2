"""RC-NMP's policy: the reward-conditioned neural process and the best trajectories seen."""

from typing import Any, cast

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import Schedule
from torch import nn

from sb3_nmp.common.policies import ElitePolicy
from sb3_nmp.models.neural_process import NeuralProcess
from sb3_nmp.rcnmp.contextual_skill import ContextualSkill
from sb3_nmp.rcnmp.settings import RCNMPAchievement, RCNMPSkill


class RCNMPPolicy(ElitePolicy):
    """Answers a context with the best trajectory seen in it, else with what the network proposes.

    The network models trajectories as deviations from the initial trajectory ``offset``, in units
    of the deviations' standard deviation ``scale``, both fixed when training starts.

    >>> import gymnasium as gym
    >>> import benchmark_envs
    >>> env = gym.make("nmp/Bottles-v0")
    >>> policy = RCNMPPolicy(env.observation_space, env.action_space, lambda progress: 1e-3)
    >>> policy.predict(env.reset(seed=0)[0], deterministic=True)[0].shape
    (200, 2)

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    :param lr_schedule: learning rate of Adam
    :param latent_dim: size of z
    :param encoder_arch: hidden layers of the encoder
    :param decoder_arch: hidden layers of the decoder
    :param n_frequencies: of the time features (`TimeFeatures`)
    :param decoder_std: of the likelihood in Eq. 6.2, in units of ``scale``
    :param activation_fn: between the layers
    :param skill: of the answers to contexts where these vary
    :param achievement: of the same, where rollouts tell what they achieved
    :param n_categories: of the discrete latent beside z; 1 is the thesis's network without one
    """

    offset: th.Tensor
    scale: th.Tensor
    target_reward: th.Tensor
    times: th.Tensor
    context_middle: th.Tensor
    context_half_range: th.Tensor

    def __init__(
        self,
        observation_space: spaces.Box,
        action_space: spaces.Box,
        lr_schedule: Schedule,
        latent_dim: int = 4,
        encoder_arch: tuple[int, ...] = (64, 64),
        decoder_arch: tuple[int, ...] = (64, 64),
        n_frequencies: int = 4,
        decoder_std: float = 0.1,
        activation_fn: type[nn.Module] = nn.Tanh,
        skill: RCNMPSkill = RCNMPSkill(),  # noqa: B008 (frozen)
        achievement: RCNMPAchievement = RCNMPAchievement(),  # noqa: B008 (frozen)
        n_categories: int = 1,
    ) -> None:
        super().__init__(observation_space, action_space)
        self.settings: dict[str, Any] = {
            "latent_dim": latent_dim,
            "encoder_arch": encoder_arch,
            "decoder_arch": decoder_arch,
            "n_frequencies": n_frequencies,
            "decoder_std": decoder_std,
            "activation_fn": activation_fn,
            "skill": skill,
            "achievement": achievement,
            "n_categories": n_categories,
        }
        self.latent_dim = latent_dim
        shape = self.trajectory_shape
        self.network = NeuralProcess(
            value_dim=shape[1],
            condition_dim=self.context_dim + 1,
            latent_dim=latent_dim,
            encoder_arch=list(encoder_arch),
            decoder_arch=list(decoder_arch),
            n_frequencies=n_frequencies,
            decoder_std=decoder_std,
            activation_fn=activation_fn,
            n_categories=n_categories,
        )
        self.register_buffer("times", th.linspace(0.0, 1.0, shape[0]))
        self.register_buffer("offset", th.zeros(shape))
        self.register_buffer("scale", th.zeros(shape[1]))
        self.register_buffer("target_reward", th.ones(()))
        low, high = th.as_tensor(observation_space.low), th.as_tensor(observation_space.high)
        self.register_buffer("context_middle", (low + high) / 2)
        self.register_buffer("context_half_range", ((high - low) / 2).clamp(min=1e-6))
        self.skill = ContextualSkill(self.context_dim, shape, skill, achievement)
        self.optimizer = th.optim.Adam(self.network.parameters(), lr_schedule(1), fused=True)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return super()._get_constructor_parameters() | self.settings

    def condition(self, contexts: th.Tensor, rewards: th.Tensor) -> th.Tensor:
        """Return the network's condition: contexts scaled to [-1, 1], and rewards; (B, C + 1).

        :param contexts: shape (B, C)
        :param rewards: scaled rewards, shape (B,)
        """
        scaled = (contexts - self.context_middle) / self.context_half_range
        return th.cat([scaled, rewards[:, None]], dim=1)

    def generate(self, contexts: th.Tensor, codes: th.Tensor) -> th.Tensor:
        """Return what the network proposes for the best reward seen, shape (B, T, D).

        :param contexts: shape (B, C)
        :param codes: z, and the one-hot vector of k where there are categories, shape (B, code_dim)
        """
        condition = self.wanted(contexts)
        return self.offset + self.scale * self.network.decode(self.times, codes, condition).mean

    def wanted(self, contexts: th.Tensor) -> th.Tensor:
        """Return the condition at the best reward seen, shape (B, C + 1).

        :param contexts: shape (B, C)
        """
        return self.condition(contexts, self.target_reward.expand(len(contexts)))

    @th.no_grad()
    def draw_codes(
        self,
        rng: np.random.Generator,
        context: NDArray[np.floating],
        n: tuple[int, ...],
        std: float,
    ) -> NDArray[np.float32]:
        """Draw z from a Gaussian and k from p(k | context, best reward), ``(*n, code_dim)``.

        :param rng: the generator to draw from
        :param context: shape (C,)
        :param n: how many, as a shape
        :param std: standard deviation of z
        """
        latents = std * rng.standard_normal((*n, self.latent_dim)).astype(np.float32)
        if self.network.n_categories == 1:
            return latents
        row = self.offset.new_tensor(context)[None]
        probabilities = self.network.category_prior(self.wanted(row)).probs[0].cpu().numpy()
        shares = probabilities.astype(np.float64) / probabilities.sum(dtype=np.float64)
        category = th.as_tensor(rng.choice(len(shares), n, p=shares))
        return self.network.code(th.as_tensor(latents), category).numpy()

    @property
    def answers_by_network(self) -> bool:
        """Whether its greedy answers are the network's: a skill over contexts searches for them."""
        return not self.skill.is_ready

    def generalise(self, contexts: th.Tensor, deterministic: bool = True) -> th.Tensor:
        """Return the skill's answers, or what the network proposes for the best reward, (N, T, D).

        :param contexts: shape (N, C)
        :param deterministic: decode the latent 0 in the likeliest category instead of drawing both
        """
        if self.skill.is_ready:
            rows = contexts.cpu().numpy()
            answered = self.skill.space.trajectories(rows, self.skill.answer(rows))
            return th.as_tensor(answered, dtype=th.float32, device=contexts.device)
        latents = contexts.new_zeros((len(contexts), self.latent_dim))
        prior = self.network.category_prior(self.wanted(contexts))
        if deterministic or self.network.n_categories == 1:
            category = prior.probs.argmax(dim=1)
        else:
            category = prior.sample()
        drawn = latents if deterministic else th.randn_like(latents)
        return self.generate(contexts, self.network.code(drawn, category))

    def _learned(self, contexts: th.Tensor) -> th.Tensor | None:
        """Return the skill's or the network's answers; before any training there are none."""
        return self.generalise(contexts) if self.skill.is_ready or self.is_scaled else None

    def modes(
        self, contexts: NDArray[np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the trajectories of all modes (N, K, T, D), and what each promises (N, K).

        Of a skill over contexts the promise is log p(r* | c, w) up to a constant, as far as a
        success has told r*; before, it is the logarithm of the mode's share of what was right.
        `predict` answers a new context with the mode that promises most. K is the number of modes
        found, at most ``n_modes`` of `RCNMPSkill`; the commonest comes first.

        Where one context was pinned, they are the best rollouts of its modes, and their rewards.

        :param contexts: shape (N, C), or (C,) for one
        :raises ConfigurationError: no modes were looked for, or none has been found yet
        :raises InvalidDataError: contexts of another shape, or not finite
        """
        if not self.skill.is_ready:
            return super().modes(contexts)
        rows = self._checked_contexts(contexts)
        weights, promises = self.skill.modes(rows)
        space = cast(spaces.Box, self.action_space)
        each = [self.skill.space.trajectories(rows, w) for w in weights.swapaxes(0, 1)]
        return np.clip(np.stack(each, axis=1), space.low, space.high), promises

    def _may_answer(self, elite: int) -> bool:
        """Return False for a trajectory that failed, where a skill has been learned."""
        return bool(self.elites.solved[elite]) or not self.skill.is_ready

    @property
    def is_scaled(self) -> bool:
        """Whether `set_scale` has been called."""
        return bool((self.scale > 0).any())

    def set_scale(self, offset: NDArray[np.floating], trajectories: NDArray[np.floating]) -> None:
        """Fix the network's origin, and its unit: the deviations' root mean square.

        :param offset: shape (T, D)
        :param trajectories: shape (N, T, D)
        """
        scale = np.sqrt(np.mean((trajectories - offset) ** 2, axis=(0, 1)))
        self.offset.copy_(self.offset.new_tensor(offset))
        self.scale.copy_(self.scale.new_tensor(scale).clamp(min=1e-6))

    def normalise(self, trajectories: NDArray[np.floating]) -> th.Tensor:
        """Return trajectories as the network's values, shape (N, T, D).

        :param trajectories: shape (N, T, D)
        """
        raw = th.as_tensor(trajectories, dtype=th.float32, device=self.offset.device)
        return (raw - self.offset) / self.scale
