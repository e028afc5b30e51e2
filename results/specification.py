"""What a run is: an algorithm with its settings, a task, a seed and a budget."""

import dataclasses
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal

import numpy as np

from results.exceptions import BenchmarkError
from results.protocols import OneContext, Protocol
from sb3_nmp.common.demonstrations import Demonstrations


@dataclass(frozen=True)
class Algorithm:
    """An algorithm as the benchmark knows it; its class is imported only where it runs.

    :param path: of the class, such as ``"baselines:REPS"``
    :param settings: constructor arguments besides policy, environment and seed; plain values or
        dataclasses
    :param description: one line for the tables
    :param shown_as: the constructor's argument for demonstrations, where a protocol has some:
        ``"demonstrations"`` takes the set, ``"initial_trajectories"`` its trajectories
    :param pretrained: whether it can answer before its first rollout, where it was shown some
    :param budget: rollouts a run, where it needs more than a suite's other algorithms
    """

    path: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    description: str = ""
    shown_as: Literal["demonstrations", "initial_trajectories"] = "demonstrations"
    pretrained: bool = True
    budget: int | None = None

    def arguments(self, demonstrations: Demonstrations | None) -> dict[str, Any]:
        """Return all constructor arguments besides policy, environment and seed.

        :param demonstrations: what the protocol shows; None shows nothing
        """
        if demonstrations is None:
            return dict(self.settings)
        forms = {
            "demonstrations": demonstrations,
            "initial_trajectories": demonstrations.trajectories,
        }
        return {**self.settings, self.shown_as: forms[self.shown_as]}

    def load(self) -> Any:  # noqa: ANN401
        """Import the class.

        :raises BenchmarkError: there is no such module or class
        """
        module_name, _, class_name = self.path.partition(":")
        try:
            return getattr(import_module(module_name), class_name)
        except (ImportError, AttributeError) as error:
            raise BenchmarkError(
                f"the algorithm '{self.path}' cannot be imported ({error}); its path must read "
                "'module:Class', such as 'sb3_nmp.rcnmp:RCNMP'."
            ) from error


@dataclass(frozen=True)
class RunSpecification:
    """All that determines a run.

    :param label: the algorithm's name in tables and plots
    :param algorithm: its class and settings
    :param task: the task's id
    :param seed: of the algorithm and of the contexts that the task draws
    :param budget: rollouts
    :param task_settings: the task's constructor arguments
    :param n_envs: environments that are stepped at once
    :param protocol: where the run takes place, what it is shown and how it is evaluated
    :param own_budget: whether the budget is the algorithm's own, which others need not share
    """

    label: str
    algorithm: Algorithm
    task: str
    seed: int
    budget: int
    task_settings: Mapping[str, Any] = field(default_factory=dict)
    n_envs: int = 1
    protocol: Protocol = OneContext()  # noqa: RUF009 (frozen)
    own_budget: bool = False

    @property
    def stem(self) -> str:
        """The name of the run's file, without its ending."""
        return run_stem(self.as_dict())

    @property
    def name(self) -> str:
        """The run's name in messages."""
        return run_name(self.as_dict())

    def as_dict(self) -> dict[str, Any]:
        """Return the specification as plain JSON values, the settings' dataclasses named."""
        return {
            "label": self.label,
            "algorithm": self.algorithm.path,
            "algorithm_settings": plain(self.algorithm.settings),
            "task": self.task,
            "task_settings": plain(self.task_settings),
            "seed": self.seed,
            "budget": self.budget,
            "n_envs": self.n_envs,
            "protocol": {"name": self.protocol.name, **self.protocol.settings},
            "own_budget": self.own_budget,
            **self.protocol.identity,
        }


@dataclass(frozen=True)
class Suite:
    """Runs that belong together.

    :param name: also of the folder that holds its runs
    :param description: one line
    :param specifications: the runs
    """

    name: str
    description: str
    specifications: tuple[RunSpecification, ...]

    @property
    def labels(self) -> list[str]:
        """The algorithms' labels, in the suite's order."""
        return list(dict.fromkeys(run.label for run in self.specifications))


def slug(text: str) -> str:
    """Return a name that is fit for a file.

    >>> slug("RC-NMP, no crossover")
    'rc-nmp-no-crossover'

    :param text: any name
    """
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def run_stem(identity: Mapping[str, Any]) -> str:
    """Return the name of a run's file, without its ending.

    >>> run_stem({"label": "RC-NMP", "task": "nmp/Bottles-v0", "seed": 7})
    'rc-nmp_bottles-v0_seed-007'

    :param identity: the run's ``label``, ``task`` and ``seed``, and ``target`` where it has one
    """
    task = slug(identity["task"].removeprefix("nmp/"))
    target = f"_target-{identity['target']:02d}" if "target" in identity else ""
    return f"{slug(identity['label'])}_{task}{target}_seed-{identity['seed']:03d}"


def run_name(identity: Mapping[str, Any]) -> str:
    """Return a run's name in messages.

    >>> run_name({"label": "ACNMP", "task": "nmp/Push-v0", "target": 9, "seed": 7})
    'ACNMP on nmp/Push-v0, target 9, seed 7'

    :param identity: the run's ``label``, ``task`` and ``seed``, and ``target`` where it has one
    """
    target = f", target {identity['target']}" if "target" in identity else ""
    return f"{identity['label']} on {identity['task']}{target}, seed {identity['seed']}"


def plain(value: Any) -> Any:  # noqa: ANN401
    """Return a setting as JSON values; a dataclass becomes its fields and its class's name.

    :param value: None, a number, text, a class, a dataclass, or a collection of these
    :raises BenchmarkError: any other value, which could not be compared between runs
    """
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # JSON has no infinity
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, type):
        return f"{value.__module__}:{value.__qualname__}"
    if dataclasses.is_dataclass(value):
        fields = {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"class": plain(type(value)), **fields}
    raise BenchmarkError(
        f"the setting {value!r} is a {type(value).__name__}: a run's settings must be plain values "
        "(None, numbers, text, lists, dictionaries), classes or dataclasses, so that a result file "
        "can state them."
    )
