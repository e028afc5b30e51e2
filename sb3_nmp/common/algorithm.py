"""`TrajectoryAlgorithm`: the loop, collection and bookkeeping of all algorithms, written once.

An algorithm of this kind works in generations: it draws what the next generation needs, proposes
a trajectory for each member once the member's context is known, and learns from the outcome.
"""

import sys
import time
from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback, Schedule
from stable_baselines3.common.utils import safe_mean
from stable_baselines3.common.vec_env import VecEnv

from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.common.policies import TrajectoryPolicy


@dataclass(frozen=True)
class Generation:
    """The N rollouts of a generation, in the order of its members.

    :param contexts: shape (N, C)
    :param trajectories: as they were sent to the environment, shape (N, T, D)
    :param rewards: shape (N,)
    :param successes: the info's ``is_success``, False where it has none, shape (N,)
    :param terms: the reward's terms, from the info's ``reward_<name>``, each of shape (N,)
    :param step_rewards: the info's ``step_rewards``: the summands of the reward over time, shape
        (N, T); None where it has none
    """

    contexts: NDArray[np.float32]
    trajectories: NDArray[np.float32]
    rewards: NDArray[np.float64]
    successes: NDArray[np.bool_]
    terms: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    step_rewards: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        """Return the number of rollouts, N."""
        return len(self.rewards)

    @classmethod
    def from_step(
        cls,
        contexts: NDArray[np.float32],
        trajectories: NDArray[np.float32],
        rewards: NDArray[np.floating],
        infos: list[dict[str, Any]],
    ) -> "Generation":
        """Gather what one step of the environments gave.

        :param contexts: shape (N, C)
        :param trajectories: shape (N, T, D)
        :param rewards: shape (N,)
        :param infos: one for each environment
        """
        names = [key for key in infos[0] if key.startswith("reward_")]
        steps = [info.get("step_rewards") for info in infos]
        return cls(
            contexts,
            trajectories,
            np.asarray(rewards, np.float64),
            np.array([bool(info.get("is_success", False)) for info in infos]),
            {
                name.removeprefix("reward_"): np.array([info[name] for info in infos], np.float64)
                for name in names
            },
            None if any(step is None for step in steps) else np.array(steps, np.float64),
        )

    @classmethod
    def concatenate(cls, parts: list["Generation"]) -> "Generation":
        """Join parts in their order.

        :param parts: at least one
        """
        steps = [part.step_rewards for part in parts]
        return cls(
            np.concatenate([part.contexts for part in parts]),
            np.concatenate([part.trajectories for part in parts]),
            np.concatenate([part.rewards for part in parts]),
            np.concatenate([part.successes for part in parts]),
            {name: np.concatenate([part.terms[name] for part in parts]) for name in parts[0].terms},
            None
            if any(step is None for step in steps)
            else np.concatenate(cast(list[NDArray[np.float64]], steps)),
        )

    def __getitem__(self, rows: slice | NDArray[Any]) -> "Generation":
        """Return some of the rollouts.

        :param rows: a slice, or an array of indices or booleans
        """
        return Generation(
            self.contexts[rows],
            self.trajectories[rows],
            self.rewards[rows],
            self.successes[rows],
            {name: term[rows] for name, term in self.terms.items()},
            None if self.step_rewards is None else self.step_rewards[rows],
        )


class TrajectoryAlgorithm(BaseAlgorithm):
    """Base class of the algorithms that search a trajectory for a contextual bandit.

    One SB3 timestep is one rollout, which is one episode. A generation may be cut by the end of
    ``learn`` or by a callback, and goes on where it stopped in the next ``learn`` or after
    ``save`` and ``load``: interrupted and resumed runs equal uninterrupted ones where the context
    is fixed. All randomness of an algorithm comes from its own generator ``rng``.

    :param policy: the policy's class or alias
    :param env: the environment or its id; T x D trajectories as actions, contexts as observations
    :param population_size: rollouts a generation; a multiple of the number of environments
    :param learning_rate: of the gradient-based parts, or a schedule of it
    :param policy_kwargs: further arguments of the policy
    :param stats_window_size: rollouts over which the logged success rate and reward are averaged
    :param tensorboard_log: folder for TensorBoard; None switches it off
    :param verbose: 0 nothing, 1 the log table, 2 debug messages
    :param seed: of Python, NumPy, PyTorch, the environment and this algorithm's generator
    :param device: of the networks
    :param _init_setup_model: whether to build the networks at once
    :raises ConfigurationError: the environment or the population does not fit
    """

    policy: TrajectoryPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {}

    def __init__(
        self,
        policy: str | type[TrajectoryPolicy],
        env: GymEnv | str,
        population_size: int,
        learning_rate: float | Schedule,
        policy_kwargs: dict[str, Any] | None,
        stats_window_size: int,
        tensorboard_log: str | None,
        verbose: int,
        seed: int | None,
        device: Any,  # noqa: ANN401
        _init_setup_model: bool,
    ) -> None:
        if isinstance(policy, str) and policy not in self.policy_aliases:
            raise ConfigurationError(
                f"{type(self).__name__} has no policy '{policy}'; it has "
                f"{', '.join(self.policy_aliases)}."
            )
        if isinstance(env, str):
            check_env_id(env)
        super().__init__(
            policy=policy,
            env=env,
            learning_rate=learning_rate,
            policy_kwargs=policy_kwargs,
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            seed=seed,
            device=device,
            support_multi_env=True,
            supported_action_spaces=(spaces.Box,),
        )
        self.population_size = population_size
        self.rng = np.random.default_rng(seed)
        self._n_updates = 0
        self._generation_started = False
        self._collected: list[Generation] = []
        if _init_setup_model:
            self._setup_model()

    # -- what an algorithm supplies ------------------------------------------------------------

    @abstractmethod
    def _begin_generation(self) -> None:
        """Draw all that the next generation needs, before any of its contexts is known."""

    @abstractmethod
    def _propose(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        """Return the trajectories of some members of the generation, shape (n, T, D).

        :param members: which of the ``population_size`` members
        :param contexts: theirs, shape (n, C)
        """

    @abstractmethod
    def _end_generation(self, generation: Generation) -> None:
        """Learn from a complete generation."""

    def _observe(self, rollouts: Generation) -> None:
        """Take in rollouts as soon as they are done, before their generation is complete."""

    @property
    def generation_size(self) -> int:
        """How many rollouts the generation at hand has; a multiple of the environments."""
        return self.population_size

    def _wanted_contexts(self, members: slice) -> NDArray[np.float32] | None:
        """Return the contexts, shape (n, C), in which some members are to run.

        :param members: which ones
        :return: None, the default, takes whatever the environment draws
        """
        return None

    # -- set-up --------------------------------------------------------------------------------

    def _setup_model(self) -> None:
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        if self.env is not None:
            self._check_population(self.env)
        self._check_spaces()
        self.policy = cast(type[TrajectoryPolicy], self.policy_class)(
            self.observation_space, self.action_space, self.lr_schedule, **self.policy_kwargs
        )
        self.policy = self.policy.to(self.device)

    def _check_spaces(self) -> None:
        action, observation = self.action_space, self.observation_space
        if len(action.shape or ()) != 2:
            raise ConfigurationError(
                f"the action space has shape {action.shape}; {type(self).__name__} answers with "
                "whole trajectories and needs (T, D): T time points, D dimensions."
            )
        if not isinstance(observation, spaces.Box) or len(observation.shape) != 1:
            raise ConfigurationError(
                f"the observation space is {observation}; {type(self).__name__} needs a Box of "
                "shape (C,): the context."
            )

    def _check_population(self, env: VecEnv) -> None:
        if self.population_size < 1 or self.population_size % env.num_envs:
            raise ConfigurationError(
                f"the population of {self.population_size} does not fit {env.num_envs} parallel "
                f"environments: it must be a positive multiple of {env.num_envs}. Change the "
                "population or n_envs."
            )

    def set_env(self, env: GymEnv, force_reset: bool = True) -> None:
        """Exchange the environment; see SB3.

        :param env: the new environment; its spaces must be the old one's
        :param force_reset: reset it before training goes on
        :raises ConfigurationError: the population does not fit the number of environments
        """
        super().set_env(env, force_reset)
        self._check_population(cast(VecEnv, self.env))

    def initial_trajectory(self) -> NDArray[np.float64]:
        """Return the environment's naive trajectory for the current context, shape (T, D).

        It is read from the environment's method ``initial_trajectory``; without such a method, it
        rests in the middle of the action space.
        """
        env = cast(VecEnv, self.env)
        try:
            return np.asarray(env.env_method("initial_trajectory", indices=[0])[0], np.float64)
        except AttributeError:
            space = cast(spaces.Box, self.action_space)
            return (space.low.astype(np.float64) + space.high) / 2

    def exploration_scale(self) -> tuple[float, ...]:
        """Return the environment's scale of exploration by dimension, length D.

        It is read from the environment's attribute ``exploration_scale``; without such an
        attribute, it is a tenth of the action space's range.
        """
        env = cast(VecEnv, self.env)
        try:
            scale = np.asarray(env.get_attr("exploration_scale", indices=[0])[0], np.float64)
        except AttributeError:
            space = cast(spaces.Box, self.action_space)
            scale = (space.high.astype(np.float64) - space.low).mean(axis=0) / 10
        return tuple(scale.tolist())

    # -- the loop ------------------------------------------------------------------------------

    def learn(
        self,
        total_timesteps: int,
        callback: MaybeCallback = None,
        log_interval: int = 1,
        tb_log_name: str | None = None,
        reset_num_timesteps: bool = True,
        progress_bar: bool = False,
    ) -> Self:
        """Search for ``total_timesteps`` rollouts, never more.

        :param total_timesteps: the budget in rollouts; what is left over when it is no multiple
            of the number of environments is not spent
        :param callback: SB3 callbacks, called after every step of the environments
        :param log_interval: generations between two lines of the log
        :param tb_log_name: name of the TensorBoard run; the algorithm's by default
        :param reset_num_timesteps: count rollouts from 0 again; the search itself always goes on
        :param progress_bar: show one (needs tqdm and rich)
        :raises ConfigurationError: the budget does not allow a single step of the environments
        """
        env = cast(VecEnv, self.env)
        if total_timesteps < env.num_envs:
            raise ConfigurationError(
                f"total_timesteps is {total_timesteps}, but one step of {env.num_envs} parallel "
                f"environments spends {env.num_envs} rollouts; give at least that."
            )
        total_timesteps, callback = self._setup_learn(
            total_timesteps,
            callback,
            reset_num_timesteps,
            tb_log_name or type(self).__name__,
            progress_bar,
        )
        callback.on_training_start(locals(), globals())
        generations = 0
        while self.num_timesteps + env.num_envs <= total_timesteps:
            if not self._collect_generation(env, callback, total_timesteps):
                break
            self._update_current_progress_remaining(self.num_timesteps, total_timesteps)
            if self._n_collected < self.generation_size:
                break
            generations += 1
            self._learn_generation()
            if log_interval and generations % log_interval == 0:
                self.dump_logs(generations)
        callback.on_training_end()
        return self

    @property
    def _n_collected(self) -> int:
        return sum(len(part.rewards) for part in self._collected)

    def _learn_generation(self) -> None:
        """Let the algorithm learn from the complete generation, and close it."""
        parts, self._collected, self._generation_started = self._collected, [], False
        self._end_generation(Generation.concatenate(parts))
        self._n_updates += 1
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")

    def _collect_generation(
        self, env: VecEnv, callback: BaseCallback, total_timesteps: int
    ) -> bool:
        """Run the generation's remaining members as far as the budget goes.

        :return: False if a callback asks to stop
        """
        if not self._generation_started:
            self._begin_generation()
            self._generation_started = True
        callback.on_rollout_start()
        space = cast(spaces.Box, self.action_space)
        n_envs = env.num_envs
        while (
            self._n_collected < self.generation_size
            and self.num_timesteps + n_envs <= total_timesteps
        ):
            members = slice(self._n_collected, self._n_collected + n_envs)
            contexts = self._show_contexts(env, members)
            proposed = self._propose(members, contexts)
            actions = np.clip(proposed, space.low, space.high).astype(np.float32)
            new_obs, rewards, dones, infos = env.step(actions)
            if not dones.all():
                raise ConfigurationError(
                    f"an episode went on after its first step: {type(self).__name__} is made for "
                    "trajectory bandits, where one step executes a whole trajectory and ends the "
                    "episode."
                )
            rollouts = Generation.from_step(contexts, actions, rewards, infos)
            self._collected.append(rollouts)
            self._observe(rollouts)
            self._last_obs = cast(NDArray[np.float32], new_obs)
            self.num_timesteps += n_envs
            self._update_info_buffer(infos, dones)
            callback.update_locals(locals())
            if not callback.on_step():
                return False
        callback.on_rollout_end()
        return True

    def _show_contexts(self, env: VecEnv, members: slice) -> NDArray[np.float32]:
        """Return the contexts that the environments are in, after asking for those wanted.

        :param env: the environments
        :param members: those that come next
        :raises ConfigurationError: the environments do not take the reset option ``context``
        """
        wanted = self._wanted_contexts(members)
        if wanted is not None and not np.array_equal(np.asarray(self._last_obs), wanted):
            env.set_options([{"context": context} for context in wanted])
            self._last_obs = cast(NDArray[np.float32], env.reset())
            if not np.allclose(self._last_obs, wanted, atol=1e-5):
                raise ConfigurationError(
                    f"{type(self).__name__} asked the environments for the context "
                    f"{wanted[0].tolist()} and got {np.asarray(self._last_obs)[0].tolist()}: their "
                    "reset must take options={'context': c}, or pin the context."
                )
        return np.array(self._last_obs, np.float32)

    def dump_logs(self, iteration: int = 0) -> None:
        """Write the log's current values.

        :param iteration: generations in this call of ``learn``
        """
        elapsed = max((time.time_ns() - self.start_time) / 1e9, sys.float_info.epsilon)
        self.logger.record("time/iterations", iteration, exclude="tensorboard")
        if self.ep_info_buffer:
            self.logger.record(
                "rollout/ep_rew_mean", safe_mean([info["r"] for info in self.ep_info_buffer])
            )
            self.logger.record(
                "rollout/ep_len_mean", safe_mean([info["l"] for info in self.ep_info_buffer])
            )
        if self.ep_success_buffer:
            self.logger.record("rollout/success_rate", safe_mean(list(self.ep_success_buffer)))
        spent = self.num_timesteps - self._num_timesteps_at_start
        self.logger.record("time/fps", int(spent / elapsed))
        self.logger.record("time/time_elapsed", int(elapsed), exclude="tensorboard")
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(step=self.num_timesteps)


def check_env_id(env_id: str) -> None:
    """Raise a helpful error for an environment id that Gymnasium does not know.

    :param env_id: such as ``"nmp/Bottles-v0"`` or ``"module:id"``
    :raises ConfigurationError: it is not registered
    """
    if ":" in env_id or env_id in gym.registry:
        return
    known = sorted(key for key in gym.registry if key.startswith("nmp/"))
    raise ConfigurationError(
        f"no environment '{env_id}' is registered with Gymnasium. "
        + (
            f"There are: {', '.join(known)}, besides Gymnasium's own."
            if known
            else "The nmp/* tasks are registered by 'import benchmark_envs'."
        )
    )
