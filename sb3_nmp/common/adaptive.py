"""`AdaptiveAlgorithm`: demonstrations first, then a search wherever they do not suffice.

The loop that ACNMP (thesis Fig. 5.1) and the methods it is compared with share: a policy learned
from demonstrations is tried in its contexts; where a rollout is not satisfactory, a search for
that context starts (a `Case`); once a rollout is satisfactory, it is assimilated.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, cast

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.type_aliases import GymEnv, PyTorchObs, Schedule
from stable_baselines3.common.vec_env import VecEnv

from sb3_nmp.common.algorithm import Generation, TrajectoryAlgorithm
from sb3_nmp.common.buffer import TrajectoryBuffer
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.elites import SAME_CONTEXT, EliteMemory
from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError
from sb3_nmp.common.policies import TrajectoryPolicy

FloatArray = NDArray[np.float64]


class AdaptivePolicy(TrajectoryPolicy):
    """Answers a context with the best trajectory seen in it, else with what it generalises to.

    :param observation_space: contexts, shape (C,)
    :param action_space: trajectories, shape (T, D)
    """

    def __init__(self, observation_space: spaces.Box, action_space: spaces.Box) -> None:
        super().__init__(observation_space, action_space)
        self.elites = EliteMemory(self.context_dim, self.trajectory_shape)

    @abstractmethod
    def generalise(self, contexts: th.Tensor, deterministic: bool = True) -> th.Tensor:
        """Return the learned trajectory for each context, shape (N, T, D).

        :param contexts: shape (N, C)
        :param deterministic: the mean instead of a sample
        """

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> th.Tensor:
        contexts = cast(th.Tensor, observation)
        trajectories = self.generalise(contexts, deterministic)
        if deterministic:
            for row, context in enumerate(contexts):
                elite = self.elites.find(context)
                if elite is not None:
                    trajectories[row] = self.elites.trajectories[elite]
        return trajectories

    def greedy(self, contexts: NDArray[np.floating]) -> FloatArray:
        """Return the greedy trajectories inside the action space, shape (N, T, D).

        :param contexts: shape (N, C)
        """
        rows = th.as_tensor(np.asarray(contexts), dtype=th.float32, device=self.device)
        with th.no_grad():
            answered = self._predict(rows, deterministic=True).cpu().numpy()
        space = cast(spaces.Box, self.action_space)
        return np.clip(answered, space.low, space.high).astype(np.float64)


class Search(Protocol):
    """The search for a trajectory in one context; it is saved with the model."""

    def ask(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return n trajectories to try, shape (n, T, D); a new search's first one is greedy."""
        ...

    def tell(self, rollouts: Generation) -> None:
        """Learn from rollouts in the search's context, whoever proposed them."""
        ...


@dataclass
class Case:
    """A context in which the policy did not satisfy, or the pinned one.

    :param context: shape (C,)
    :param search: the search in it
    :param n_generations: searched so far
    :param solution: the best successful trajectory, shape (T, D); None before there is one
    :param reward: of the solution
    """

    context: NDArray[np.float32]
    search: Search
    n_generations: int = 0
    solution: NDArray[np.float32] | None = None
    reward: float = -np.inf

    def take(self, rollouts: Generation) -> None:
        """Tell the search about rollouts, and keep the best successful one.

        :param rollouts: made in this context
        """
        self.search.tell(rollouts)
        rewards = np.where(rollouts.successes, rollouts.rewards, -np.inf)
        best = int(rewards.argmax())
        if rewards[best] > self.reward:
            self.solution, self.reward = rollouts.trajectories[best], float(rewards[best])


@dataclass(frozen=True)
class Plan:
    """What the members of a generation do.

    :param contexts: shape (G, C)
    :param trajectories: shape (G, T, D)
    :param cases: index of each member's case; -1 tries the greedy trajectory, shape (G,)
    """

    contexts: NDArray[np.float32]
    trajectories: FloatArray
    cases: NDArray[np.int_]


class AdaptiveAlgorithm(TrajectoryAlgorithm):
    """Learns from demonstrations, and searches where the learned policy fails.

    On an environment whose context is fixed, every generation searches in that context. On one
    that draws contexts, a generation tries the greedy trajectory in ``n_contexts`` new ones. Those
    in which it is not satisfactory are then searched side by side, ``population_size`` rollouts
    each a generation, until a rollout is satisfactory or the search has lasted
    ``max_generations``; the best successful rollout is assimilated. What is satisfactory is a
    success, and a reward where ``reward_threshold`` asks for one.

    The demonstrations are not saved with a model, only their digest: give them again to go on,
    ``load(path, env=env, demonstrations=demonstrations)``. What was assimilated is the
    ``replay_buffer``, which `save_replay_buffer` writes apart.

    :param policy: the policy's class or alias
    :param env: the environment or its id; T x D trajectories as actions, contexts as observations
    :param demonstrations: of the expert; None only where the algorithm can do without
    :param population_size: rollouts a generation and context that is searched; a multiple of the
        number of environments
    :param n_contexts: new contexts that are tried at once; None: ``population_size``
    :param reward_threshold: a rollout is satisfactory if its info says ``is_success`` and its
        reward is not below this; None asks for success alone. Solutions that barely succeed teach
        a policy that often fails: a threshold leaves it a margin. Two values: the first one is for
        the greedy rollout, below which a search begins, the second one for the rollout that ends it
    :param max_generations: after so many a search among drawn contexts ends
    :param learning_rate: see `TrajectoryAlgorithm`, as for the rest
    :param policy_kwargs: further arguments of the policy
    :param stats_window_size: rollouts over which the log averages
    :param tensorboard_log: folder for TensorBoard
    :param verbose: amount of printing
    :param seed: of everything random
    :param device: of the policy
    :param _init_setup_model: whether to build the policy at once
    :raises ConfigurationError: a value outside its range, or a population that does not fit
    :raises InvalidDataError: demonstrations that do not fit the environment
    """

    policy: AdaptivePolicy
    needs_demonstrations: ClassVar[bool] = True

    def __init__(
        self,
        policy: str | type[AdaptivePolicy],
        env: GymEnv | str,
        demonstrations: Demonstrations | None,
        population_size: int,
        n_contexts: int | None,
        reward_threshold: float | tuple[float, float] | None,
        max_generations: int,
        learning_rate: float | Schedule,
        policy_kwargs: dict[str, Any] | None,
        stats_window_size: int,
        tensorboard_log: str | None,
        verbose: int,
        seed: int | None,
        device: th.device | str,
        _init_setup_model: bool,
    ) -> None:
        if demonstrations is not None and not isinstance(demonstrations, Demonstrations):
            raise ConfigurationError(
                f"demonstrations is a {type(demonstrations).__name__}; it must be Demonstrations: "
                "Demonstrations(contexts, trajectories) makes them from arrays."
            )
        if max_generations < 1:
            raise ConfigurationError(f"max_generations is {max_generations}; it must be >= 1.")
        begin, end = thresholds(reward_threshold)
        if not begin <= end:
            raise ConfigurationError(
                f"reward_threshold is {reward_threshold}; a search that begins below {begin} must "
                "not end with less: give one value, or (begin, end) with begin <= end."
            )
        self.demonstrations = demonstrations
        self.demonstrations_digest = None if demonstrations is None else demonstrations.digest
        self.n_contexts = population_size if n_contexts is None else n_contexts
        self.reward_threshold = reward_threshold
        self.max_generations = max_generations
        self.cases: list[Case] = []
        self.n_given_up = 0
        self._pinned = False
        self._plan: Plan | None = None
        super().__init__(
            policy=policy,
            env=env,
            population_size=population_size,
            learning_rate=learning_rate,
            policy_kwargs=policy_kwargs,
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            seed=seed,
            device=device,
            _init_setup_model=_init_setup_model,
        )

    # -- what an algorithm supplies ------------------------------------------------------------

    @abstractmethod
    def _new_search(self, context: NDArray[np.float32]) -> Search:
        """Return a search that starts from what has been learned.

        :param context: shape (C,)
        """

    @abstractmethod
    def _adapt(self, searched: list[Case], solved: list[Case]) -> None:
        """Learn after a generation.

        :param searched: the cases that the generation's rollouts were made in
        :param solved: those of them that are closed now with a solution, to be assimilated; they
            are in the replay buffer already. A pinned context's case is among them whenever its
            solution has become better
        """

    # -- set-up --------------------------------------------------------------------------------

    def _setup_model(self) -> None:
        super()._setup_model()
        shape = self.policy.trajectory_shape
        self.replay_buffer = TrajectoryBuffer(self.policy.context_dim, shape)
        if self.needs_demonstrations and self.demonstrations_digest is None:
            raise ConfigurationError(
                f"{type(self).__name__} learns from demonstrations first: give demonstrations=, "
                "such as Demonstrations.from_task(env_id, contexts) or Demonstrations.load(path)."
            )
        if self.demonstrations is not None:
            self.demonstrations.check_fits(self.policy.context_dim, shape)
            if self.demonstrations.digest != self.demonstrations_digest:
                given, known = self.demonstrations.digest, self.demonstrations_digest
                raise InvalidDataError(
                    f"these demonstrations (digest {given[:12]}) are not those that the model was "
                    f"made with ({known[:12] if known else 'none'})."
                )

    def _check_population(self, env: VecEnv) -> None:
        super()._check_population(env)
        if self.n_contexts < 1 or self.n_contexts % env.num_envs:
            raise ConfigurationError(
                f"n_contexts is {self.n_contexts}; it must be a positive multiple of the "
                f"{env.num_envs} parallel environments."
            )

    def set_env(self, env: GymEnv, force_reset: bool = True) -> None:
        """Exchange the environment; see SB3. Searches that are under way are dropped.

        :param env: the new environment; its spaces must be the old one's
        :param force_reset: reset it before training goes on
        :raises ConfigurationError: the population does not fit the number of environments
        """
        if self.env is not None:
            self.cases, self._plan = [], None
            self._collected, self._generation_started = [], False
        super().set_env(env, force_reset)

    def check_can_go_on(self) -> None:
        """Raise unless the demonstrations that the model was made with are there.

        :raises ConfigurationError: the model was loaded without them
        """
        if self.demonstrations is None and self.demonstrations_digest is not None:
            raise ConfigurationError(
                "a saved model does not hold its demonstrations; to go on learning, load it with "
                f"{type(self).__name__}.load(path, env=env, demonstrations=demonstrations) (digest "
                f"{self.demonstrations_digest[:12]})."
            )

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "replay_buffer", "demonstrations"]

    @classmethod
    def load(cls, *args: Any, **kwargs: Any) -> Any:  # noqa: ANN401
        """Load a model; see SB3. Give ``demonstrations`` as well to go on learning.

        :param args: as SB3's
        :param kwargs: as SB3's
        """
        kwargs.setdefault("demonstrations", None)
        return super().load(*args, **kwargs)

    def save_replay_buffer(self, path: str) -> None:
        """Write the assimilated rollouts as .npz; with it, a saved model resumes exactly.

        :param path: of the file; SB3's CheckpointCallback calls this too
        """
        self.replay_buffer.save(path)

    def load_replay_buffer(self, path: str) -> None:
        """Read assimilated rollouts.

        :param path: of a file that `save_replay_buffer` wrote
        :raises FileFormatError: it is not such a file
        :raises InvalidDataError: its rollouts do not fit the environment
        """
        self.replay_buffer.load(path)

    # -- the loop ------------------------------------------------------------------------------

    @property
    def generation_size(self) -> int:
        """How many rollouts the generation at hand has."""
        return self.population_size if self._plan is None else len(self._plan.cases)

    def _setup_learn(self, *args: Any, **kwargs: Any) -> tuple[int, Any]:  # noqa: ANN401
        self.check_can_go_on()
        return super()._setup_learn(*args, **kwargs)

    def _begin_generation(self) -> None:
        if not self.cases:
            drawn = self._draw_contexts()
            contexts = drawn[: self.n_contexts]
            self._pinned = bool(np.all(np.ptp(drawn, axis=0) <= SAME_CONTEXT))
            if not self._pinned:
                greedy = self.policy.greedy(contexts)
                self._plan = Plan(contexts, greedy, np.full(len(contexts), -1))
                return
            self.cases = [Case(contexts[0], self._new_search(contexts[0]))]
        n, rng = self.population_size, self.rng
        self._plan = Plan(
            np.repeat(np.stack([case.context for case in self.cases]), n, axis=0),
            np.concatenate([case.search.ask(n, rng) for case in self.cases]),
            np.repeat(np.arange(len(self.cases)), n),
        )

    def _draw_contexts(self) -> NDArray[np.float32]:
        """Let the environments draw at least two contexts and ``n_contexts``, shape (n, C)."""
        env = cast(VecEnv, self.env)
        drawn = [np.array(self._last_obs, np.float32)]
        while sum(map(len, drawn)) < max(2, self.n_contexts):
            drawn.append(np.array(env.reset(), np.float32))
        self._last_obs = drawn[-1]
        return np.concatenate(drawn)

    def _wanted_contexts(self, members: slice) -> NDArray[np.float32]:
        return cast(Plan, self._plan).contexts[members]

    def _propose(self, members: slice, contexts: NDArray[np.float32]) -> NDArray[np.floating]:
        return cast(Plan, self._plan).trajectories[members]

    def _observe(self, rollouts: Generation) -> None:
        self.policy.elites.update(
            rollouts.contexts, rollouts.trajectories, rollouts.rewards, rollouts.successes
        )

    def _end_generation(self, generation: Generation) -> None:
        plan, self._plan = cast(Plan, self._plan), None
        least_to_begin, least_to_end = thresholds(self.reward_threshold)
        if plan.cases[0] < 0:
            satisfactory = generation.successes & (generation.rewards >= least_to_begin)
            self._open_cases(generation, satisfactory)
            return
        searched, improved = self.cases, []
        for index, case in enumerate(searched):
            rows, before = plan.cases == index, case.reward
            case.take(generation[rows])
            case.n_generations += 1
            if case.reward > before:
                improved.append(case)
        solved = improved
        if not self._pinned:
            closed = [
                (case.solution is not None and case.reward >= least_to_end)
                or case.n_generations >= self.max_generations
                for case in searched
            ]
            ended = [case for case, over in zip(searched, closed, strict=True) if over]
            self.cases = [case for case, over in zip(searched, closed, strict=True) if not over]
            solved = [case for case in ended if case.solution is not None]
            self.n_given_up += len(ended) - len(solved)
        self._assimilate(solved)
        self._adapt(searched, solved)
        self.logger.record("train/open_contexts", len(self.cases))
        self.logger.record("train/assimilated", len(self.replay_buffer))
        self.logger.record("train/given_up", self.n_given_up)

    def _open_cases(self, tried: Generation, satisfactory: NDArray[np.bool_]) -> None:
        """Start a search wherever the greedy trajectory is not satisfactory (V)."""
        for row in np.flatnonzero(~satisfactory):
            case = Case(tried.contexts[row], self._new_search(tried.contexts[row]))
            case.take(tried[row : row + 1])
            self.cases.append(case)
        self.logger.record("train/failure_rate", float(np.mean(~tried.successes)))

    def _assimilate(self, solved: list[Case]) -> None:
        """Add the solutions to the replay buffer (VIII); a pinned context has one at most."""
        if self._pinned and solved:
            self.replay_buffer = TrajectoryBuffer(
                self.policy.context_dim, self.policy.trajectory_shape
            )
        for case in solved:
            solution = cast(NDArray[np.float32], case.solution)
            self.replay_buffer.add(case.context[None], solution[None], np.array([case.reward]))

    def training_set(self) -> Demonstrations:
        """Return the demonstrations together with what was assimilated.

        For algorithms that need demonstrations.

        :raises ConfigurationError: the model was loaded without them
        """
        self.check_can_go_on()
        shown, found = cast(Demonstrations, self.demonstrations), self.replay_buffer
        return shown.joined_with(found.contexts, found.trajectories) if len(found) else shown


def thresholds(given: float | tuple[float, float] | None) -> tuple[float, float]:
    """Return the least rewards with which no search begins, and with which one ends.

    >>> thresholds(None), thresholds(-0.1), thresholds((-0.1, -0.05))
    ((-inf, -inf), (-0.1, -0.1), (-0.1, -0.05))

    :param given: both of them, a single one for both, or None
    """
    if given is None:
        return -np.inf, -np.inf
    begin, end = given if isinstance(given, tuple | list) else (given, given)
    return float(begin), float(end)
