"""`TrajectoryAlgorithm`: the loop, collection and bookkeeping of all algorithms, written once.

An algorithm of this kind works in generations: it draws what the next generation needs, proposes
a trajectory for each member once the member's context is known, and learns from the outcome.
"""

from abc import abstractmethod
from typing import Any, ClassVar, Self, Unpack, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import maybe_make_env
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback, Schedule
from stable_baselines3.common.vec_env import VecEnv

from sb3_nmp.common import arguments, environment, hints, stream
from sb3_nmp.common.argument_types import check_types
from sb3_nmp.common.arguments import SB3Arguments, check_learn, check_names, check_values, complete
from sb3_nmp.common.demonstrations import Demonstrations, check_type
from sb3_nmp.common.environment import Scale
from sb3_nmp.common.logs import write_log
from sb3_nmp.common.policies import TrajectoryPolicy
from sb3_nmp.common.rollouts import Generation, Information
from sb3_nmp.common.settings import Rules, check_rules
from sb3_nmp.common.under_way import GenerationAlgorithm


class TrajectoryAlgorithm(GenerationAlgorithm):
    """Base class of the algorithms that search a trajectory for a contextual bandit.

    One SB3 timestep is one rollout, which is one episode. A generation may be cut by the end of
    ``learn`` or by a callback, and goes on where it stopped in the next ``learn`` or after
    ``save`` and ``load``: interrupted and resumed runs equal uninterrupted ones
    (`GenerationAlgorithm`). All randomness of an algorithm comes from its own generator ``rng``.

    A subclass supplies `_begin_generation`, `_propose` and `_end_generation`. Its constructor names
    its own arguments, and passes on the others as ``**shared`` (`sb3_nmp.common.arguments`).

    :param policy: the policy's class, or ``"MlpPolicy"``
    :param env: the environment or its id; T x D trajectories as actions, contexts as observations
    :param population_size: rollouts per generation; a multiple of the number of environments, to
        which the default is rounded up
    :param learning_rate: of the gradient-based parts, or a schedule of it
    :param demonstrations: of an expert
    :param exploration_scale: standard deviation of the first trajectories that are tried, in the
        trajectory's unit, one value or one per dimension; None takes the environment's
        ``exploration_scale``
    :param device: of the policy. The networks are small: a GPU would mostly wait for rollouts
    :param _init_setup_model: whether to build the policy at once
    :raises ConfigurationError: a value outside its range, or an environment that does not fit
    :raises InvalidDataError: demonstrations that do not fit the environment
    """

    policy: TrajectoryPolicy
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {}
    #: share of the environment's scale that is taken where no ``exploration_scale`` is given
    default_exploration: ClassVar[float] = 1.0

    def __init_subclass__(cls, **kwargs: Any) -> None:  # noqa: ANN401
        super().__init_subclass__(**kwargs)
        complete(cls)

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:  # noqa: ANN401
        """Refuse arguments that do not exist before anything else is looked at.

        :param args: of the constructor
        :param kwargs: of the constructor
        """
        del args
        check_names(cls, kwargs)
        check_types(cls, kwargs)
        made = super().__new__(cls)
        made._population_given = "population_size" in kwargs
        return made

    def __init__(
        self,
        policy: str | type[TrajectoryPolicy],
        env: GymEnv | str,
        *,
        population_size: int,
        learning_rate: float | Schedule = 0.0,
        demonstrations: Demonstrations | None = None,
        exploration_scale: Scale | None = None,
        device: Any = "cpu",  # noqa: ANN401
        _init_setup_model: bool = True,
        **shared: Unpack[SB3Arguments],
    ) -> None:
        shared["seed"] = check_values(type(self), policy, shared.get("seed"), device)
        environment.check_env(env, needed=_init_setup_model)
        env = cast(GymEnv, maybe_make_env(env, shared.get("verbose", 0)))
        if env is not None:  # SB3 would fail an assertion
            environment.check_spaces(env.action_space, env.observation_space, type(self).__name__)
        chosen = self.policy_aliases[policy] if isinstance(policy, str) else policy
        super().__init__(
            chosen, env, learning_rate, device=device, support_multi_env=True, **shared
        )
        self.population_size, self.exploration_scale = population_size, exploration_scale
        self.demonstrations, self._was_shown = check_type(demonstrations), bool(demonstrations)
        self.rng = np.random.default_rng(self.seed)
        self._n_updates, self._generation_started = 0, False
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
    def information(self) -> frozenset[Information]:
        """What it learns from in its latest run; a subclass adds what else its code reads."""
        shown = {Information.DEMONSTRATIONS} if self._was_shown else set[Information]()
        return frozenset({Information.REWARD} | shown)

    def _rules(self) -> Rules:
        """Return the rules that the settings must fit."""
        usable = arguments.is_learning_rate(self.learning_rate)
        return {
            "learning_rate": (usable, "finite and >= 0, or a schedule of such values"),
            "_stats_window_size": (self._stats_window_size >= 1, "1 or more"),
        }

    def _wanted_contexts(self, members: slice) -> NDArray[np.float32] | None:
        """Return the contexts, shape (n, C), in which some members are to run.

        :param members: which ones
        :return: None, the default, takes whatever the environment draws
        """
        return None

    # -- set-up --------------------------------------------------------------------------------

    def _setup_model(self) -> None:
        check_rules(self, {**TrajectoryAlgorithm._rules(self), **self._rules()})
        self._setup_lr_schedule()
        self.lr_schedule = arguments.CheckedSchedule(self.lr_schedule)
        super().set_random_seed(self.seed)  # a loaded model's own generator goes on
        if self.env is not None:
            self._fit_environments(self.env)
        self._check_scale("exploration_scale")
        policy_class = cast(type[TrajectoryPolicy], self.policy_class)
        check_names(policy_class, self.policy_kwargs)
        check_types(policy_class, self.policy_kwargs)
        self.policy = policy_class(
            self.observation_space, self.action_space, self.lr_schedule, **self.policy_kwargs
        ).to(self.device)
        if self.demonstrations is not None:
            environment.check_shown(self.demonstrations, self.observation_space, self.action_space)

    def _check_scale(self, name: str) -> None:
        """Raise unless an attribute is None or a standard deviation that fits a trajectory."""
        if getattr(self, name) is not None:
            n_dimensions = cast(spaces.Box, self.action_space).shape[1]
            environment.check_scale(name, getattr(self, name), n_dimensions)

    def _fit_environments(self, env: VecEnv) -> None:
        """Round a default population up to the environments, and check that they can be used."""
        environment.check_unnormalised(env)
        step = 1 if self._population_given else env.num_envs
        size = environment.rounded_up(self.population_size, step)
        environment.check_multiple("the population", size, env.num_envs)
        environment.check_alike(env, self.observation_space, self.action_space, self.n_envs)
        self.population_size = size

    def set_random_seed(self, seed: int | None = None) -> None:
        """Begin new random numbers; see SB3.

        :param seed: None changes nothing
        :raises ConfigurationError: it is no seed
        """
        super().set_random_seed(arguments.check_seed(seed))
        if seed is not None:
            self.rng = np.random.default_rng(seed)

    def set_env(self, env: GymEnv | str, force_reset: bool = True) -> None:
        """Exchange the environment; see SB3. What was begun in the one before is dropped.

        :param env: the new environment, or the id of one; its spaces must be the old one's
        :param force_reset: reset it before training goes on
        :raises ConfigurationError: none, one with other spaces, or another number of environments
        """
        environment.check_env(env, needed=True)
        made = maybe_make_env(cast(GymEnv, env), self.verbose)
        ready = self._wrap_env(cast(GymEnv, made), self.verbose)
        self._fit_environments(ready)
        had_one = self.env is not None
        super().set_env(ready, force_reset)
        if had_one:
            self._leave_environment()

    def initial_trajectory(self) -> NDArray[np.float64]:
        """Return the environment's naive trajectory for the current context, shape (T, D)."""
        return hints.initial_trajectory(cast(VecEnv, self.env), cast(spaces.Box, self.action_space))

    def first_scale(self) -> tuple[float, ...]:
        """Return the scale at which exploration begins, in the trajectory's unit, length D.

        It is the argument ``exploration_scale``; where that is None, the environment's, times
        ``default_exploration``.
        """
        space = cast(spaces.Box, self.action_space)
        if self.exploration_scale is not None:
            given = np.broadcast_to(np.asarray(self.exploration_scale, np.float64), space.shape[1:])
            return tuple(given.tolist())
        found = hints.exploration_scale(cast(VecEnv, self.env), space)
        return tuple((self.default_exploration * found).tolist())

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "demonstrations", "lr_schedule"]

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
        :raises ConfigurationError: the budget does not allow a single step of the environments, or
            another argument does not fit
        """
        env = environment.to_learn_in(self.env, type(self).__name__)
        total_timesteps, callback = self._setup_learn(
            check_learn(total_timesteps, callback, log_interval, env.num_envs),
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
        self._end_learning()
        self._standing = stream.generator_states(env)
        callback.on_training_end()
        return self

    def _end_learning(self) -> None:
        """Do what is left when ``learn`` ends; a search that goes on must not depend on it."""

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
        n_envs, space = env.num_envs, cast(spaces.Box, self.action_space)
        self._drop_what_does_not_fit(n_envs)
        self._finite(self._last_obs)
        if not self._generation_started:
            self._begin_generation()
            self._generation_started, self._size_begun = True, self.generation_size
        callback.on_rollout_start()
        while (
            self._n_collected < self.generation_size
            and self.num_timesteps + n_envs <= total_timesteps
        ):
            members = slice(self._n_collected, self._n_collected + n_envs)
            contexts = self._show_contexts(env, members)
            proposed = self._propose(members, contexts)
            actions = environment.executable(proposed, n_envs, space, type(self).__name__)
            self._before_reset = stream.generator_states(env)
            new_obs, rewards, dones, infos = env.step(actions)
            self._last_obs = cast(NDArray[np.float32], new_obs)  # before anything can be refused
            environment.check_ended(dones, type(self).__name__)
            own = environment.rewards_of(env, rewards)
            rollouts = Generation.from_step(contexts, actions, own, infos)
            self._collected.append(rollouts)
            self._observe(rollouts)
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
        :raises InvalidDataError: a context that is not finite
        """
        wanted, seen = self._wanted_contexts(members), self._finite(self._last_obs)
        if wanted is None or np.array_equal(seen, wanted):
            return seen
        self._last_obs = environment.ask_contexts(env, wanted, type(self).__name__)
        return np.array(self._last_obs, np.float32)

    def dump_logs(self, iteration: int = 0) -> None:
        """Write the log's current values.

        :param iteration: generations in this call of ``learn``
        """
        write_log(self, iteration)


complete(TrajectoryAlgorithm)
