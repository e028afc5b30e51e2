"""PPO, SAC and ARS as rows of a suite: they choose the weights of a movement primitive.

They are Stable-Baselines3's and sb3-contrib's as they are, on `MovementPrimitiveWrapper`. What a
run needs besides, trajectories from `predict`, an exact budget and a callback that sees every
rollout, is added around them: their environment counts the rollouts and ends the run.
"""

from importlib import import_module
from typing import Any, ClassVar, Self, cast

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.type_aliases import MaybeCallback, PyTorchObs
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from baselines import PDFiltered, ProMP
from benchmark_envs import MovementPrimitiveWrapper, TrajectoryVecEnv
from results.exceptions import BenchmarkError
from sb3_nmp import PDController
from sb3_nmp.common.policies import TrajectoryPolicy
from sb3_nmp.common.rollouts import Information
from sb3_nmp.common.tuning import Choice, Range, SearchSpace


class EndOfRunError(Exception):
    """The budget is spent, or a callback asks to stop; raised through the learner's own loop."""


class AgentPolicy(TrajectoryPolicy):
    """Answers a context with the trajectory of the weights that an agent's policy chooses.

    :param wrapper: from weights to trajectories, with a mean that does not depend on the context
    :param agent: chooses the weights
    """

    def __init__(self, wrapper: MovementPrimitiveWrapper, agent: BaseAlgorithm) -> None:
        super().__init__(wrapper.observation_space, wrapper.trajectory_space)
        self.wrapper, self.agent = wrapper, agent

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> th.Tensor:
        contexts = cast(th.Tensor, observation).cpu().numpy()
        weights, _ = self.agent.predict(contexts, deterministic=deterministic)
        return th.as_tensor(np.stack([self.wrapper.action(row) for row in weights]))

    def _learned(self, contexts: th.Tensor) -> th.Tensor | None:
        return self._predict(contexts, deterministic=True)


class Counted(VecEnvWrapper):
    """Counts rollouts, shows each to a callback, and ends the run when the budget is spent.

    :param venv: whose actions are weights
    :param learner: the row whose run it is
    """

    def __init__(self, venv: VecEnv, learner: "PrimitiveAgent") -> None:
        super().__init__(venv)
        self.learner = learner

    def reset(self) -> VecEnvObs:
        """Start new episodes."""
        return self.venv.reset()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Let the callback look at what the last update made, then execute weights.

        :param actions: the weights, shape (n, K D)
        """
        self.learner.begin_step()
        self.venv.step_async(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Return what the rollouts gave, unless they end the run."""
        observations, rewards, dones, infos = self.venv.step_wait()
        self.learner.end_step(np.asarray(rewards), dones, infos)
        return observations, rewards, dones, infos


class PrimitiveAgent:
    """An algorithm of Stable-Baselines3 over the weights of a ProMP, as the harness runs it.

    The ProMP bends the environment's initial trajectory in the first context, through the PD
    controller, as the other searches without demonstrations do. A resumed run is not the
    uninterrupted one: these algorithms do not save their generators.

    :param policy: ignored: each has its own
    :param env: of trajectories
    :param seed: of the agent
    :param n_bases: K, per dimension
    :param reach: largest weight, in standard deviations of the exploration
    :param agent: further arguments of the algorithm's constructor, before its defaults here
    """

    path: ClassVar[str]
    policy_name: ClassVar[str] = "MlpPolicy"
    defaults: ClassVar[dict[str, Any]] = {}
    tunable: ClassVar[SearchSpace] = {}
    information: ClassVar[frozenset[Information]] = frozenset({Information.REWARD})

    def __init__(
        self,
        policy: str,
        env: VecEnv,
        *,
        seed: int | None = None,
        n_bases: int = 10,
        reach: float = 3.0,
        agent: dict[str, Any] | None = None,
    ) -> None:
        del policy
        if not isinstance(env, TrajectoryVecEnv):
            raise BenchmarkError(
                f"{type(self).__name__} runs on a TrajectoryVecEnv, not on a {type(env).__name__}; "
                "on any other environment, use MovementPrimitiveWrapper and the algorithm itself."
            )
        env.seed(seed)
        env.reset()
        initial = np.asarray(env.env_method("initial_trajectory", indices=[0])[0])
        n_time_points = cast(spaces.Box, env.action_space).shape[0]
        primitive = PDFiltered(ProMP(n_bases, n_time_points), PDController())
        wrapped = [
            MovementPrimitiveWrapper(each, primitive, mean=initial, reach=reach)
            for each in env.envs
        ]
        over_weights = TrajectoryVecEnv([lambda each=each: each for each in wrapped])
        self.env, self.num_timesteps, self._budget = env, 0, 0
        self._callback: BaseCallback = CallbackList([])
        settings = self.defaults | (agent or {})
        made = self._class()(self.policy_name, Counted(over_weights, self), seed=seed, **settings)
        self.agent: BaseAlgorithm = made
        self.policy = AgentPolicy(wrapped[0], made)

    @classmethod
    def _class(cls) -> type[Any]:
        module, _, name = cls.path.partition(":")
        return getattr(import_module(module), name)

    @property
    def logger(self) -> Logger:
        """The agent's logger."""
        return self.agent.logger

    def get_env(self) -> VecEnv:
        """Return the environment of trajectories."""
        return self.env

    def predict(
        self,
        observation: NDArray[Any],
        *args: Any,  # noqa: ANN401
        deterministic: bool = False,
    ) -> tuple[NDArray[Any], Any]:
        """Return a trajectory, shape (T, D), or one for each of several contexts.

        :param observation: contexts, shape (C,) or (N, C)
        :param args: as SB3's
        :param deterministic: the greedy weights instead of a sample
        """
        return self.policy.predict(observation, *args, deterministic=deterministic)

    def learn(
        self, total_timesteps: int, callback: MaybeCallback = None, progress_bar: bool = False
    ) -> Self:
        """Let the agent learn from so many rollouts, never more.

        :param total_timesteps: the budget in rollouts
        :param callback: sees every rollout
        :param progress_bar: ignored
        """
        del progress_bar
        self._budget, self.num_timesteps = total_timesteps, 0
        if isinstance(callback, BaseCallback):
            self._callback = callback
        self.agent.set_logger(Logger(folder=None, output_formats=[]))
        self._callback.init_callback(cast(BaseAlgorithm, self))
        self._callback.on_training_start(locals(), globals())
        try:
            self.agent.learn(total_timesteps)
        except EndOfRunError:
            pass
        self._callback.on_training_end()
        return self

    def begin_step(self) -> None:
        """Let the callback look at the policy before a step, as before a generation of ours."""
        self._callback.on_rollout_start()

    def end_step(
        self, rewards: NDArray[np.floating], dones: NDArray[np.bool_], infos: list[dict[str, Any]]
    ) -> None:
        """Count the rollouts of a step.

        :param rewards: shape (n,)
        :param dones: shape (n,)
        :param infos: one for each environment
        :raises EndOfRunError: the budget is spent, or the callback asks to stop
        """
        self.num_timesteps += len(rewards)
        self._callback.update_locals({"rewards": rewards, "dones": dones, "infos": infos})
        if not self._callback.on_step() or self.num_timesteps >= self._budget:
            raise EndOfRunError


class PPO(PrimitiveAgent):
    """Proximal policy optimisation (Schulman et al. 2017), of Stable-Baselines3."""

    path = "stable_baselines3:PPO"
    defaults: ClassVar[dict[str, Any]] = {
        "n_steps": 20,
        "batch_size": 20,
        "n_epochs": 20,
        "learning_rate": 3e-3,
        "policy_kwargs": {"net_arch": [32]},
        "device": "cpu",
    }
    tunable: ClassVar[SearchSpace] = {
        "n_bases": Range(4, 15, integer=True),
        "agent.learning_rate": Range(3e-4, 3e-2, log=True),
        "agent.n_epochs": Range(5, 40, integer=True),
        "agent.clip_range": Range(0.1, 0.4),
    }


class SAC(PrimitiveAgent):
    """Soft actor-critic (Haarnoja et al. 2018), of Stable-Baselines3."""

    path = "stable_baselines3:SAC"
    defaults: ClassVar[dict[str, Any]] = {
        "learning_starts": 20,
        "batch_size": 64,
        "learning_rate": 1e-3,
        "policy_kwargs": {"net_arch": [64, 64]},
        "device": "cpu",
    }
    tunable: ClassVar[SearchSpace] = {
        "n_bases": Range(4, 15, integer=True),
        "reach": Range(1.0, 3.0),
        "agent.learning_rate": Range(3e-4, 1e-2, log=True),
        "agent.gradient_steps": Choice((1, 2, 4)),
    }


class ARS(PrimitiveAgent):
    """Augmented random search (Mania et al. 2018), of sb3-contrib."""

    path = "sb3_contrib:ARS"
    policy_name = "LinearPolicy"
    defaults: ClassVar[dict[str, Any]] = {
        "n_delta": 5,
        "n_top": 3,
        "delta_std": 0.5,
        "learning_rate": 0.2,
        "policy_kwargs": {"with_bias": True},
        "device": "cpu",
    }
    tunable: ClassVar[SearchSpace] = {
        "n_bases": Range(4, 15, integer=True),
        "agent.delta_std": Range(0.1, 2.0, log=True),
        "agent.learning_rate": Range(0.02, 2.0, log=True),
        "agent.n_top": Choice((1, 3, 5)),
    }
