"""`Examined`: an algorithm under examination, and its runs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm

from sb3_nmp.checking.environments import Recording
from sb3_nmp.common.exceptions import AlgorithmContractError, ConfigurationError

Callback = Callable[[dict[str, Any], dict[str, Any]], bool]


@dataclass(frozen=True)
class Examined:
    """An algorithm with the settings and the environment in which it is tried.

    :param algorithm: the class
    :param make_env: returns a new environment each time
    :param settings: constructor arguments besides policy, environment and seed
    """

    algorithm: type[BaseAlgorithm]
    make_env: Callable[[], gym.Env[Any, Any]]
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The algorithm's, in messages."""
        return self.algorithm.__name__

    @property
    def shown(self) -> dict[str, Any]:
        """What no file holds, and a loaded model is given again."""
        return {key: value for key, value in self.settings.items() if key == "demonstrations"}

    def build(self, env: Any = None, seed: int = 0, **changes: Any) -> Any:  # noqa: ANN401
        """Return a new model.

        :param env: in which it learns; a new one by default
        :param seed: of the model
        :param changes: settings that differ
        """
        make: Callable[..., Any] = self.algorithm
        env = self.make_env() if env is None else env
        return make("MlpPolicy", env, seed=seed, **{**self.settings, **changes})

    @cached_property
    def population(self) -> int:
        """Rollouts per generation, where it tells any."""
        return int(getattr(self.build(), "population_size", 10))

    @property
    def budget(self) -> int:
        """Rollouts of a run: two generations, and a part of the third."""
        return 2 * self.population + 3

    def run(
        self, budget: int | None = None, seed: int = 0, callback: Callback | None = None
    ) -> tuple[Any, list[NDArray[np.float32]]]:
        """Return a model after a run, and the trajectories that it executed.

        :param budget: in rollouts
        :param seed: of the model
        :param callback: see SB3
        """
        env = Recording(self.make_env())
        model = self.build(env, seed)
        model.learn(self.budget if budget is None else budget, callback=callback)
        return model, env.trajectories

    @cached_property
    def reference(self) -> tuple[Any, list[NDArray[np.float32]]]:
        """The run with which others are compared; nobody may train its model further."""
        return self.run()

    @cached_property
    def contexts(self) -> NDArray[np.float32]:
        """The context of a reset, and three others of the space, shape (4, C)."""
        env = self.make_env()
        space = cast(spaces.Box, env.observation_space)
        parts = np.array([[0.2], [0.5], [0.8]])
        others = space.low + parts * (space.high - space.low)
        return np.concatenate([env.reset(seed=0)[0][None], others]).astype(np.float32)

    @cached_property
    def draws_contexts(self) -> bool:
        """Whether episodes differ in their contexts."""
        env = self.make_env()
        return not np.array_equal(env.reset(seed=0)[0], env.reset(seed=1)[0])


def require(holds: object, sentence: str) -> None:
    """Raise unless a rule is kept.

    :param holds: whether it is
    :param sentence: the value, the rule, and the way out
    :raises AlgorithmContractError: it is not
    """
    if not holds:
        raise AlgorithmContractError(sentence)


def apply(rule: Callable[[Examined], None], it: Examined) -> None:
    """Ask a rule of an algorithm; whatever else the algorithm raises is told in a sentence.

    :param rule: one of `ALGORITHM_RULES`
    :param it: the algorithm
    :raises AlgorithmContractError: it breaks the rule, or raises an error of Python's or NumPy's
    :raises ConfigurationError: it refuses its settings
    """
    try:
        rule(it)
    except (AlgorithmContractError, ConfigurationError):
        raise
    except Exception as error:
        asked = (rule.__doc__ or rule.__name__).splitlines()[0]
        raise AlgorithmContractError(
            f"{it.name} raised {type(error).__name__} ({error}) where this was asked of it: "
            f"{asked} No error may end a run; the traceback above shows the line to mend."
        ) from error


def check_maker(make_env: object) -> Callable[[], gym.Env[Any, Any]]:
    """Return a function that makes environments.

    :param make_env: such a function
    :raises ConfigurationError: it is none, such as an environment or an id
    """
    made = make_env() if callable(make_env) else None
    if not isinstance(made, gym.Env):
        raise ConfigurationError(
            f"make_env is {make_env!r}"
            f"{f', which returns {made!r}' if callable(make_env) else ''}; it must be a function "
            "that returns a new environment of Gymnasium, such as lambda: gym.make(id, context=c)."
        )
    return cast(Callable[[], gym.Env[Any, Any]], make_env)


def first_difference(one: list[NDArray[np.float32]], two: list[NDArray[np.float32]]) -> str:
    """Say where two runs part, empty where they are equal to the bit.

    :param one: trajectories, each of shape (T, D)
    :param two: the other run's
    """
    for index, (a, b) in enumerate(zip(one, two, strict=False)):
        if not np.array_equal(a, b):
            return f"rollout {index + 1} differs by up to {float(np.abs(a - b).max()):.3g}"
    return "" if len(one) == len(two) else f"{len(one)} and {len(two)} rollouts were done"
