"""`SafeFiles`: saving and loading of algorithms, as Stable-Baselines3 does it, without pickles."""

from collections.abc import Callable, Iterable
from io import BufferedIOBase
from pathlib import Path
from typing import Any, Self, cast

import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.save_util import (
    load_from_zip_file,
    recursive_getattr,
    recursive_setattr,
)
from stable_baselines3.common.type_aliases import GymEnv, TensorDict
from stable_baselines3.common.utils import get_system_info

from sb3_nmp.common import files
from sb3_nmp.common.exceptions import ConfigurationError, FileFormatError, UnsafeFileError
from sb3_nmp.common.policies import TrajectoryPolicy

#: never in a file: an environment's id can import modules
NEVER = "env"
NEEDED = ("observation_space", "action_space", "policy_class", "policy_kwargs")


class SafeFiles(BaseAlgorithm):
    """Base of algorithms whose files hold JSON and safetensors, so that no code from them runs."""

    def save(
        self,
        path: files.AnyPath,
        exclude: Iterable[str] | None = None,
        include: Iterable[str] | None = None,
    ) -> None:
        """Write the model to a zip file; see SB3.

        The file appears whole or not at all, and its folder is made. What the codec does not know
        (a function of your own as learning rate, say) is pickled, with a `PickleWarning`.

        :param path: of the file, ``.zip`` where it has no ending; or an open file
        :param exclude: attributes to leave out besides those that always are
        :param include: attributes to write though they are left out else
        :raises ConfigurationError: ``env`` is to be included
        """
        if NEVER in (include or ()):
            raise ConfigurationError("env cannot be saved; give it to load instead.")
        modules, variables = self._get_torch_save_params()
        apart = {name.split(".")[0] for name in [*modules, *variables]}
        left_out = {*(exclude or ()), *self._excluded_save_params()} - set(include or ()) | apart
        data = {name: value for name, value in self.__dict__.items() if name not in left_out}
        if "policy_class" in data:
            data["policy_class"] = self._alias(data["policy_class"])
        parts = {
            "about": {
                "algorithms": _lineage(type(self)),
                "system": get_system_info(print_info=False)[1],
            },
            "data": data,
            "parameters": self.get_parameters(),
            "variables": {name: recursive_getattr(self, name).data for name in variables},
        }
        files.write(path, "model", parts, "zip")

    @classmethod
    def load(
        cls,
        path: files.AnyPath,
        env: GymEnv | None = None,
        device: th.device | str = "auto",
        custom_objects: dict[str, Any] | None = None,
        print_system_info: bool = False,
        force_reset: bool = True,
        *,
        allow_pickle: bool = False,
        **kwargs: Any,  # noqa: ANN401
    ) -> Self:
        """Read a model from a zip file; see SB3. No code from the file is run.

        :param path: of the file, or an open file
        :param env: the environment to go on with; None suffices for `predict`
        :param device: of the policy
        :param custom_objects: attributes that stand for those of the file, which are not read
        :param print_system_info: print on what system it was saved, and this one's
        :param force_reset: reset the environment before training goes on
        :param allow_pickle: read files with pickles too, which **can run any code**: those of
            Stable-Baselines3's format, and those that a `PickleWarning` was given for. Only for
            files of someone you trust
        :param kwargs: attributes to change; another seed begins new random numbers
        :raises UnsafeFileError: the file holds pickles, and ``allow_pickle`` is False
        :raises FileFormatError: it is no model, one of another algorithm, or damaged
        :raises ConfigurationError: other ``policy_kwargs`` than those of the file, or an
            environment with other spaces
        """
        saved = cls._read(path, custom_objects, allow_pickle)
        if print_system_info:
            print("== CURRENT SYSTEM INFO ==")
            get_system_info()
            print(f"== SAVED MODEL SYSTEM INFO ==\n{saved['about']['system']}")
        data = saved["data"]
        if kwargs.get("policy_kwargs", data["policy_kwargs"]) != data["policy_kwargs"]:
            raise ConfigurationError(
                f"policy_kwargs is {kwargs['policy_kwargs']}, but the model in the file has "
                f"{data['policy_kwargs']}; leave them out."
            )
        if env is not None:
            env = cls._wrap_env(env, data.get("verbose", 0))
            data["n_envs"] = env.num_envs
            if force_reset:
                data["_last_obs"] = None
        make = cast(Callable[..., Self], cls)
        model = make(data["policy_class"], env, device=device, _init_setup_model=False)
        vars(model).update(data | kwargs)
        model._setup_model()
        model.set_parameters(saved["parameters"], exact_match=True, device=device)
        for name, values in saved["variables"].items():
            recursive_setattr(model, f"{name}.data", values)
        if "seed" in kwargs and kwargs["seed"] != data.get("seed"):
            model.set_random_seed(kwargs["seed"])
        return model

    def set_parameters(
        self,
        load_path_or_dict: files.AnyPath | TensorDict,
        exact_match: bool = True,
        device: th.device | str = "auto",
        *,
        allow_pickle: bool = False,
    ) -> None:
        """Take over the parameters of a file or of a dictionary; see SB3.

        :param load_path_or_dict: a file that `save` wrote, or what `get_parameters` returned
        :param exact_match: whether all parameters must be given
        :param device: of the parameters while they are read
        :param allow_pickle: as in `load`
        :raises UnsafeFileError: as `load` does
        :raises FileFormatError: as `load` does
        """
        given = load_path_or_dict
        if not isinstance(given, dict):
            given = self._read(given, None, allow_pickle, ("about", "parameters"))["parameters"]
        super().set_parameters(given, exact_match, device)

    @classmethod
    def _read(
        cls,
        path: files.AnyPath,
        replaced: dict[str, Any] | None,
        allow_pickle: bool,
        only: tuple[str, ...] | None = None,
    ) -> dict[str, dict[str, Any]]:
        """Return what a file holds, by group.

        :raises FileFormatError: of another algorithm, or without what every model has
        """
        try:
            saved = files.read(path, "model", "zip", replaced, allow_pickle, only)
        except UnsafeFileError:
            if not allow_pickle:
                raise
            saved = _read_pickles(path, replaced)
        known, names = _lineage(cls), saved["about"]["algorithms"]
        if names and cls.__name__ not in names and names[0] not in known:
            raise FileFormatError(
                f"the file holds a model of {names[0]}, not of {cls.__name__}: load it with "
                f"{names[0]}.load."
            )
        if "data" in saved:
            saved["data"] = cls._checked(saved["data"])
        return saved

    @classmethod
    def _checked(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Return the attributes of a file, the policy's class in place of its alias."""
        missing = [name for name in NEEDED if name not in data]
        if NEVER in data:
            raise FileFormatError("the file names an environment, which is given to load instead.")
        if missing:
            raise FileFormatError(f"the file lacks {', '.join(missing)}; it is no whole model.")
        policy = data["policy_class"]
        policy = cls.policy_aliases.get(policy) if isinstance(policy, str) else policy
        if not (isinstance(policy, type) and issubclass(policy, TrajectoryPolicy)):
            raise FileFormatError(
                f"the policy in the file is {data['policy_class']!r}; {cls.__name__} has "
                f"{', '.join(cls.policy_aliases)}. Give one of your own as custom_objects="
                "{'policy_class': ...}."
            )
        return data | {"policy_class": policy}

    def _alias(self, policy: type[BasePolicy]) -> str | type[BasePolicy]:
        """Return the name under which a policy stands in files; itself where it has none."""
        names = [name for name, known in self.policy_aliases.items() if known is policy]
        return names[0] if names else policy


def _lineage(cls: type) -> list[str]:
    """Return the names of an algorithm's class and of those that it derives from."""
    return [each.__name__ for each in cls.__mro__ if issubclass(each, SafeFiles)]


def _read_pickles(
    path: files.AnyPath, replaced: dict[str, Any] | None
) -> dict[str, dict[str, Any]]:
    """Return what a file in the format of Stable-Baselines3 holds, which can run any code."""
    opened = path if isinstance(path, BufferedIOBase) else Path(path)
    data, parameters, variables = load_from_zip_file(opened, custom_objects=replaced)
    data = {name: value for name, value in (data or {}).items() if name != NEVER}
    return {
        "about": {"algorithms": [], "system": "(not read: a file of Stable-Baselines3's format)"},
        "data": data,
        "parameters": dict(parameters),
        "variables": {name: each.data for name, each in (variables or {}).items()},
    }
