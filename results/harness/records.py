"""`RunRecord`: what a run leaves behind.

A record holds all that a table or a figure says, so that these read records and nothing else.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from results.harness.machine import Machine
from results.harness.slugs import slug, task_slug

Curve = dict[str, list[Any]]


@dataclass(frozen=True)
class ProtocolRecord:
    """Where and how a run took place.

    :param name: of the protocol
    :param settings: what runs must share to be compared
    :param number: of the run's context, where the protocol numbers them
    :param kind: of that context, such as ``"extrapolation"``: tables keep kinds apart
    """

    name: str
    settings: dict[str, Any] = field(default_factory=dict)
    number: int | None = None
    kind: str = ""

    @property
    def shared(self) -> "ProtocolRecord":
        """It without the run's own context: the same for all runs that are compared."""
        return ProtocolRecord(self.name, self.settings)


@dataclass(frozen=True)
class SuiteRecord:
    """What the suite of a run says to its tables; runs are comparable whatever it is.

    :param name: of the suite
    :param labels: of all its algorithms, in the order of the rows
    :param checkpoints: rollouts at which the greedy error is reported
    :param published: rollouts that the thesis's method needed, None where it tells none
    """

    name: str = ""
    labels: tuple[str, ...] = ()
    checkpoints: tuple[int, ...] = ()
    published: int | None = None


@dataclass(frozen=True)
class SpecificationRecord:
    """What was asked for.

    >>> run = SpecificationRecord(
    ...     "RC-NMP",
    ...     "",
    ...     "rcnmp",
    ...     {},
    ...     "nmp/Push-v0",
    ...     {},
    ...     7,
    ...     100,
    ...     False,
    ...     ProtocolRecord("leave-one-out", number=9),
    ... )
    >>> run.stem
    'rc-nmp_push-v0_target-09_seed-007'

    :param label: the algorithm's name in tables and figures
    :param description: of the algorithm, one line
    :param algorithm: its stable name
    :param settings: of the algorithm, as JSON values
    :param task: its id
    :param task_settings: the task's constructor arguments, as JSON values
    :param seed: of the algorithm and of the contexts that the task draws
    :param budget: rollouts
    :param own_budget: whether the budget is the algorithm's own, which others need not share
    :param protocol: where and how
    :param suite: what it belongs to
    :param variant: the name of the task's settings, where a suite runs several of them
    :param n_trials: of the study that found the settings; None where none did, and in old records
    """

    label: str
    description: str
    algorithm: str
    settings: dict[str, Any]
    task: str
    task_settings: dict[str, Any]
    seed: int
    budget: int
    own_budget: bool
    protocol: ProtocolRecord
    suite: SuiteRecord = SuiteRecord()
    variant: str = ""
    n_trials: int | None = None

    @property
    def stem(self) -> str:
        """The name of the run's file, without its ending."""
        number = self.protocol.number
        variant = f"_{slug(self.variant)}" if self.variant else ""
        target = "" if number is None else f"_target-{number:02d}"
        return f"{slug(self.label)}_{task_slug(self.task)}{variant}{target}_seed-{self.seed:03d}"

    @property
    def name(self) -> str:
        """The run's name in messages."""
        number = self.protocol.number
        variant = f", {self.variant}" if self.variant else ""
        target = "" if number is None else f", target {number}"
        return f"{self.label} on {self.task}{variant}{target}, seed {self.seed}"


@dataclass(frozen=True)
class TaskRecord:
    """What the task says of itself.

    :param context_names: what each entry of the context means, with its unit, length C
    :param trajectory_names: what each dimension of the trajectory means, with its unit, length D
    :param dt: from one time point to the next, in s
    :param error_unit: of minus the reward, where that is one error
    :param optimum: name and value of the largest reward, where it is known
    """

    context_names: tuple[str, ...]
    trajectory_names: tuple[str, ...]
    dt: float
    error_unit: str = ""
    optimum: tuple[str, float] | None = None


@dataclass(frozen=True)
class ContextRecord:
    """The one context of a run.

    :param values: shape (C,)
    :param scene: what to draw of it in the plane of the trajectories (`Task.scene`), if that is one
    """

    values: tuple[float, ...]
    scene: dict[str, Any] | None = None


@dataclass(frozen=True)
class RolloutRecord:
    """A trajectory in the run's context.

    :param trajectory: set-points, shape (T, D), in single precision: simulated again as float32
        they give the same bits
    :param executed: what the robot did, shape (T, D); None where it was not executed
    :param success: whether it solved the task; None where it was not executed
    :param mode: the way in which it solved the task, where there are several
    :param reward: its reward; None where it was not executed, and in old records
    """

    trajectory: list[list[float]]
    executed: list[list[float]] | None = None
    success: bool | None = None
    mode: str = ""
    reward: float | None = None


@dataclass(frozen=True)
class Measurements:
    """What a protocol measured in a finished run.

    :param curve: lists of equal length by column; one of them is ``rollouts``
    :param context: where there is but one
    :param rollouts: by name: ``greedy``, the last one; ``untrained``, the first; ``solving``, the
        greedy one from which on all succeeded; ``own``, the model's own answer; ``expert``
    :param more: anything else, as JSON values
    """

    curve: Curve
    context: ContextRecord | None = None
    rollouts: dict[str, RolloutRecord] = field(default_factory=dict)
    more: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that the curve has rows."""
        lengths = {len(column) for column in self.curve.values()}
        if not self.curve.get("rollouts") or len(lengths) > 1:
            raise ValueError("a curve without rollouts, or with columns of different lengths")


@dataclass(frozen=True)
class Provenance:
    """Where a result comes from.

    :param commit: of this code; None outside a repository
    :param dirty: whether there were local changes
    :param packages: versions by name, None where one is not installed
    :param python: its version
    :param platform: of the machine
    :param started: date and time
    :param machine: what decides the last bits; None in old records
    """

    commit: str | None
    dirty: bool | None
    packages: dict[str, str | None]
    python: str
    platform: str
    started: str
    machine: Machine | None = None


@dataclass(frozen=True)
class Seconds:
    """How long a run took, in s.

    :param training: rollouts and learning; None where nobody measured it
    :param evaluation: greedy evaluations, which are not counted as training
    """

    training: float | None
    evaluation: float


@dataclass(frozen=True)
class ErrorRecord:
    """Why a run failed.

    :param type: of the exception
    :param message: its text
    :param traceback: for whoever mends it
    """

    type: str
    message: str
    traceback: str


@dataclass(frozen=True)
class Result:
    """What a finished run gave.

    :param task: what the task says of itself
    :param seconds: that it took
    :param measured: by its protocol
    :param sees: what its algorithm learns from; None in old records
    :param n_together: the most runs whose networks were trained as one, this one included; 1 is a
        run that can be done again to the bit
    """

    task: TaskRecord
    seconds: Seconds
    measured: Measurements
    sees: tuple[str, ...] | None = None
    n_together: int = 1


@dataclass(frozen=True)
class RunRecord:
    """One run.

    :param specification: what was asked for
    :param provenance: where it comes from
    :param outcome: how it ended
    :param result: of a finished run
    :param error: of a failed one
    """

    specification: SpecificationRecord
    provenance: Provenance
    outcome: Literal["finished", "failed"]
    result: Result | None = None
    error: ErrorRecord | None = None

    def __post_init__(self) -> None:
        """Check that the outcome has what belongs to it."""
        wanted = self.result if self.outcome == "finished" else self.error
        if wanted is None:
            raise ValueError(f"a {self.outcome} run without its {self.outcome} part")

    @property
    def finished(self) -> bool:
        """Whether it ended as it should."""
        return self.outcome == "finished"

    @property
    def measured(self) -> Measurements:
        """What a finished run measured."""
        return self._result.measured

    @property
    def curve(self) -> Curve:
        """The curve of a finished run."""
        return self.measured.curve

    @property
    def task(self) -> TaskRecord:
        """What the task of a finished run says of itself."""
        return self._result.task

    @property
    def seconds(self) -> Seconds:
        """How long a finished run took."""
        return self._result.seconds

    @property
    def sees(self) -> tuple[str, ...] | None:
        """What the algorithm of a finished run learns from, None where the record is older."""
        return self._result.sees

    @property
    def n_together(self) -> int:
        """The most runs that a finished run was trained with as one, itself included."""
        return self._result.n_together

    @property
    def reason(self) -> str:
        """Why a failed run failed; empty for a finished one."""
        return "" if self.error is None else f"{self.error.type}: {self.error.message}"

    @property
    def _result(self) -> Result:
        if self.result is None:
            raise ValueError(f"{self.specification.name} has failed: {self.reason}")
        return self.result


def labels_of(records: Iterable[RunRecord]) -> list[str]:
    """Return the algorithms in the order of the rows: those of the suites, then any others.

    :param records: of one folder
    """
    known = list(records)
    suites = [label for record in known for label in record.specification.suite.labels]
    return list(dict.fromkeys([*suites, *(record.specification.label for record in known)]))


def finished(records: Sequence[RunRecord]) -> list[RunRecord]:
    """Return the runs that ended as they should.

    :param records: of finished and failed runs
    """
    return [record for record in records if record.finished]
