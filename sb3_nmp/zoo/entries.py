"""What the Zoo needs of an algorithm: how it is made of plain values, loaded, and tuned."""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from typing import Any

import gymnasium as gym
from stable_baselines3.common.vec_env import VecEnv

from sb3_nmp.acnmp import ACNMP
from sb3_nmp.common.algorithm import TrajectoryAlgorithm
from sb3_nmp.common.demonstrations import Demonstrations
from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.rcnmp import RCNMP

#: by name: lowest and highest value, and whether its logarithm is drawn evenly; or the choices
Range = tuple[float, float, bool] | list[Any]


@dataclass(frozen=True)
class Entry:
    """Stands in the Zoo's table of algorithms in the place of a class.

    :param algorithm: the class
    :param tuned: the hyper-parameters that Optuna draws; one of a group is ``group.name``
    """

    algorithm: type[TrajectoryAlgorithm]
    tuned: Mapping[str, Range]

    @property
    def __name__(self) -> str:
        """The class's."""
        return self.algorithm.__name__

    def __call__(self, env: VecEnv, seed: int | None = None, **given: Any) -> TrajectoryAlgorithm:  # noqa: ANN401
        """Return a new model.

        :param env: the environments
        :param seed: of the model and of the expert's contexts
        :param given: further arguments, as they stand in a file
        :raises ConfigurationError: an argument that does not fit
        """
        made: dict[str, Any] = {"policy": "MlpPolicy"} | self._arguments(env, seed, given)
        return self.algorithm(env=env, seed=seed, **made)

    def load(
        self,
        path: str,
        env: VecEnv | None = None,
        seed: int | None = None,
        **given: Any,  # noqa: ANN401
    ) -> TrajectoryAlgorithm:
        """Return a saved model, to enjoy it or to go on.

        :param path: of its file
        :param env: the environments
        :param seed: as in the call that made it
        :param given: arguments of the class's ``load``, and those to change as they stand in a
            file; demonstrations are left out, for the model knows those that it was made with
        :raises ConfigurationError: an argument that does not fit
        """
        given.pop("demonstrations", None)
        return self.algorithm.load(path, env=env, seed=seed, **self._arguments(env, seed, given))

    def _arguments(
        self, env: VecEnv | None, seed: int | None, given: dict[str, Any]
    ) -> dict[str, Any]:
        """Return arguments with settings and demonstrations made of plain values."""
        parameters = inspect.signature(self.algorithm).parameters
        made = dict(given)
        for name, value in given.items():
            default = parameters[name].default if name in parameters else None
            if isinstance(value, dict) and is_dataclass(default):
                made[name] = _settings(name, type(default), value)
        if env is not None and made.get("demonstrations") is not None:
            made["demonstrations"] = demonstrations(made["demonstrations"], env, seed)
        return made

    def sample(
        self,
        trial: Any,  # noqa: ANN401
        n_actions: int,
        n_envs: int,
        additional_args: dict[str, Any],
    ) -> dict[str, Any]:
        """Draw hyper-parameters; the Zoo calls it.

        :param trial: Optuna's
        :param n_actions: unused
        :param n_envs: unused
        :param additional_args: unused
        """
        del n_actions, n_envs, additional_args
        drawn = {}
        for name, told in self.tuned.items():
            if isinstance(told, list):
                drawn[name] = trial.suggest_categorical(name, told)
            else:
                low, high, log = told
                whole = isinstance(low, int) and isinstance(high, int)
                suggest = trial.suggest_int if whole else trial.suggest_float
                drawn[name] = suggest(name, low, high, log=log)
        return self.convert(drawn)

    def convert(self, drawn: Mapping[str, Any]) -> dict[str, Any]:
        """Return what was drawn as arguments, ``group.name`` in a dictionary of its group.

        :param drawn: by name
        """
        made: dict[str, Any] = {}
        for name, value in drawn.items():
            group, _, last = name.rpartition(".")
            (made.setdefault(group, {}) if group else made)[last] = value
        return made


def _settings(name: str, cls: type, value: dict[str, Any]) -> Any:  # noqa: ANN401
    try:
        return cls(**value)
    except TypeError as error:
        raise ConfigurationError(
            f"{name} is {value}, which are no settings of {cls.__name__}: {error}."
        ) from error


def demonstrations(given: int | str, env: VecEnv, seed: int | None) -> Demonstrations:
    """Return demonstrations that a file of hyper-parameters names.

    :param given: how many the task's expert is to give, or a file (.npz, .csv)
    :param env: the environments
    :param seed: of the contexts
    :raises ConfigurationError: neither a number nor the name of such a file
    """
    if isinstance(given, str) and given.endswith(".csv"):
        n_steps = env.action_space.shape[0] if env.action_space.shape else None
        return Demonstrations.from_csv(given, n_steps=n_steps)
    if isinstance(given, str) and given.endswith(".npz"):
        return Demonstrations.load(given)
    if isinstance(given, int) and not isinstance(given, bool):
        spec = env.get_attr("spec")[0]  # with the settings that the environments have
        return Demonstrations.from_task(gym.make(spec.id, **spec.kwargs), given, seed=seed)
    raise ConfigurationError(
        f"demonstrations is {given!r}; a number, or a file that ends in .npz or .csv, is needed."
    )


ENTRIES = {
    "rcnmp": Entry(
        RCNMP,
        {
            "learning_rate": (3e-4, 1e-2, True),
            "mutation_decay": (0.5, 0.95, False),
            "temperature": (1.0, 10.0, True),
            "latent_std": (1.0, 5.0, False),
            "beta": (0.03, 1.0, True),
            "mutation.sigma": (0.3, 2.0, True),
        },
    ),
    "acnmp": Entry(
        ACNMP,
        {
            "learning_rate": (1e-4, 1e-2, True),
            "population_size": [1, 2, 3, 5],
            "search": ["critic", "policy"],
            "exploration.radius": (0.5, 4.0, True),
            "adaptation.temperature": (0.5, 5.0, True),
        },
    ),
}
