"""What a run is: an algorithm with its settings, a task, a seed and a budget."""

import dataclasses
import inspect
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import numpy as np
from torch import nn

from results.exceptions import BenchmarkError
from results.harness.protocol import Protocol
from results.harness.records import ProtocolRecord, SpecificationRecord, SuiteRecord
from sb3_nmp import Demonstrations
from sb3_nmp.common.settings import stable_name


@dataclass(frozen=True)
class Algorithm:
    """An algorithm as the benchmark knows it; its class is imported only where it runs.

    >>> Algorithm("ga", "baselines:GA", {"population_size": 10}).load().__name__
    'GA'

    :param name: under which records keep it, whatever its class is called
    :param path: of the class, such as ``"baselines:REPS"``
    :param settings: constructor arguments besides policy, environment, seed and demonstrations;
        plain values or registered settings
    :param description: one line for the tables
    :param pretrained: whether it can answer before its first rollout, where it was shown some
    :param budget: rollouts of a run, where it needs more than a suite's other algorithms
    :param shown_initial: whether the task's initial trajectory, which knows nothing of the context,
        is its only demonstration: for one that cannot begin without any
    :param n_trials: of the study whose best settings these are; None where no study found them
    """

    name: str
    path: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    description: str = ""
    pretrained: bool = True
    budget: int | None = None
    shown_initial: bool = False
    n_trials: int | None = None

    def arguments(self, demonstrations: Demonstrations | None) -> dict[str, Any]:
        """Return all constructor arguments besides policy, environment and seed.

        :param demonstrations: what the protocol shows; None shows nothing
        """
        shown = {} if demonstrations is None else {"demonstrations": demonstrations}
        return {**self.settings, **shown}

    def load(self) -> Any:  # noqa: ANN401
        """Import the class; nothing of it is called.

        :raises BenchmarkError: there is no such module or class, or it is no algorithm
        """
        module_name, _, class_name = self.path.partition(":")
        try:
            found = getattr(import_module(module_name), class_name)
        except Exception as error:  # whatever a foreign module does when it is imported
            known = isinstance(error, ImportError | AttributeError)
            told = str(error) if known else f"{type(error).__name__}: {error}"
            raise BenchmarkError(
                f"the algorithm '{self.path}' cannot be imported ({told}); its path must read "
                "'module:Class', such as 'sb3_nmp:RCNMP'."
            ) from error
        lacks = [each for each in ("learn", "predict") if not callable(getattr(found, each, None))]
        if not isinstance(found, type) or lacks or inspect.isabstract(found):
            raise BenchmarkError(
                f"'{self.path}' is {_kind(found)} and no algorithm: that is a class as "
                "Stable-Baselines3 has them, with learn, predict and a constructor that takes "
                "policy, env and seed, such as 'sb3_nmp:RCNMP'."
            )
        return found


def _kind(found: object) -> str:
    """Return what an object is, in words."""
    if not isinstance(found, type):
        return f"a {type(found).__name__}"
    return "an abstract class" if inspect.isabstract(found) else "a class of another kind"


@dataclass(frozen=True)
class RunSpecification:
    """All that determines a run.

    :param label: the algorithm's name in tables and figures
    :param algorithm: its class and settings
    :param task: the task's id
    :param seed: of the algorithm and of the contexts that the task draws
    :param budget: rollouts
    :param protocol: where the run takes place, what it is shown and how it is evaluated
    :param task_settings: the task's constructor arguments
    :param own_budget: whether the budget is the algorithm's own, which others need not share
    :param suite: what it belongs to
    :param variant: the name of these task settings, where a suite runs several of them
    :param imports: modules that the run's process imports first; no part of its record
    """

    label: str
    algorithm: Algorithm
    task: str
    seed: int
    budget: int
    protocol: Protocol
    task_settings: Mapping[str, Any] = field(default_factory=dict)
    own_budget: bool = False
    suite: SuiteRecord = SuiteRecord()  # noqa: RUF009 (frozen)
    variant: str = ""
    imports: tuple[str, ...] = ()

    @property
    def record(self) -> SpecificationRecord:
        """The specification as a record keeps it."""
        return SpecificationRecord(
            label=self.label,
            description=self.algorithm.description,
            algorithm=self.algorithm.name,
            settings=plain(self.algorithm.settings),
            task=self.task,
            task_settings=plain(self.task_settings),
            seed=self.seed,
            budget=self.budget,
            own_budget=self.own_budget,
            protocol=ProtocolRecord(
                self.protocol.name,
                plain(self.protocol.settings),
                self.protocol.number,
                self.protocol.kind,
            ),
            suite=self.suite,
            variant=self.variant,
            n_trials=self.algorithm.n_trials,
        )

    @property
    def stem(self) -> str:
        """The name of the run's file, without its ending."""
        return self.record.stem

    @property
    def name(self) -> str:
        """The run's name in messages."""
        return self.record.name


def plain(value: Any) -> Any:  # noqa: ANN401
    """Return a setting as JSON values; registered settings become their fields and stable name.

    >>> from sb3_nmp import SmoothNoise
    >>> plain({"mutation": SmoothNoise(n_bases=5)})["mutation"]["settings"]
    'smooth-noise'

    :param value: None, a number, text, an activation, registered settings, or a collection of these
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
    if isinstance(value, type) and issubclass(value, nn.Module):
        return value.__name__
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"settings": _registered(value), **fields}
    raise BenchmarkError(
        f"the setting {value!r} is a {type(value).__name__}: a run's settings must be plain values "
        "(None, numbers, text, lists, dictionaries), activations of torch.nn or registered "
        "settings (sb3_nmp.common.settings), so that a result file can state them."
    )


def _registered(value: object) -> str:
    try:
        return stable_name(type(value))
    except ValueError as error:
        raise BenchmarkError(f"the setting {value!r} cannot be written down: {error}") from error
