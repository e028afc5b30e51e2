"""A tuning study: trials of an algorithm's settings on tuning seeds, and what is kept of it.

What a trial costs is told by one of two measures. ``"rollouts"``: the mean logarithm of the
rollouts until the greedy policy succeeds, over the tuning runs; a run that never does counts as
twice its budget. ``"reward"``: minus the mean reward of the greedy trajectory at the end. The first
trial are the settings that the suite has, so that tuning can only be a gain on the tuning seeds.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from results.exceptions import BenchmarkError
from results.harness.protocol import Protocol
from results.harness.records import Curve
from results.harness.runner import execute
from results.harness.slugs import slug
from results.harness.specification import Algorithm, RunSpecification, plain
from results.harness.suite import Recipe, find_label
from results.harness.whole_files import write_whole
from results.one_context.protocol import OneContext
from results.report.frames import rollouts_to_success
from sb3_nmp.common.tuning import Choice, SearchSpace, Value, arguments_of

if TYPE_CHECKING:
    import optuna

#: reported runs have smaller seeds
FIRST_TUNING_SEED = 1000

Measure = Literal["rollouts", "reward"]


@dataclass(frozen=True)
class TuningPlan:
    """What is equal for all algorithms.

    :param suite: its name
    :param task: the suite's task
    :param task_settings: its constructor arguments
    :param budget: rollouts of a run
    :param seeds: of the runs of each trial; none of them is reported
    :param n_trials: of each algorithm, its settings in the suite included
    :param protocols: each seed is run once in each
    :param measure: what a trial costs
    :raises BenchmarkError: a seed that reported runs have, no seed, fewer than one trial, or no
        such measure
    """

    suite: str
    task: str
    task_settings: dict[str, Any]
    budget: int
    seeds: tuple[int, ...]
    n_trials: int
    protocols: tuple[Protocol, ...] = (OneContext(),)
    measure: Measure = "rollouts"

    def __post_init__(self) -> None:
        """Check seeds, trials and measure."""
        reported = [seed for seed in self.seeds if seed < FIRST_TUNING_SEED]
        if reported or not self.seeds:
            raise BenchmarkError(
                f"the tuning seeds are {list(self.seeds)}; reported runs have seeds below "
                f"{FIRST_TUNING_SEED}, so tuning needs at least one, and all from there on, such "
                f"as --seeds {FIRST_TUNING_SEED}-{FIRST_TUNING_SEED + 4}."
            )
        if self.n_trials < 1:
            raise BenchmarkError(f"n_trials is {self.n_trials}; at least 1 is needed.")
        if self.measure not in get_args(Measure):
            raise BenchmarkError(
                f"measure is {self.measure!r}; a trial costs {' or '.join(get_args(Measure))}."
            )

    @property
    def record(self) -> dict[str, Any]:
        """Its fields as JSON values."""
        where = [[each.name, each.number] for each in self.protocols]
        names = [each.name for each in fields(self) if each.name != "protocols"]
        return {name: plain(getattr(self, name)) for name in names} | {"protocols": where}

    @property
    def n_runs(self) -> int:
        """The runs of each trial."""
        return len(self.protocols) * len(self.seeds)

    def cost(self, curve: Curve) -> float:
        """Return what a run cost.

        :param curve: of its record
        """
        if self.measure == "reward":
            return -float(curve["greedy_reward"][-1])
        first = rollouts_to_success(curve["rollouts"], curve["greedy_success"])
        return float(np.log(min(max(first, 1.0), 2.0 * self.budget)))

    def told(self, trial: "Trial") -> str:
        """Return a trial's cost in words.

        :param trial: of this plan
        """
        if trial.cost is None:
            return "failed"
        if self.measure == "reward":
            return f"reward {-trial.cost:.4f}"
        return f"{np.exp(trial.cost):.0f} rollouts"

    @classmethod
    def of(
        cls,
        suite: str,
        recipe: Recipe,
        seeds: Sequence[int],
        n_trials: int,
        budget: int | None = None,
        measure: Measure = "rollouts",
    ) -> "TuningPlan":
        """Return the plan for a suite.

        :param suite: its name
        :param recipe: what it is made of
        :param seeds: of the runs of each trial
        :param n_trials: of each algorithm
        :param budget: rollouts of a run; the recipe's by default
        :param measure: what a trial costs
        :raises BenchmarkError: the suite is not of one task, or has no contexts to tune in
        """
        alone = recipe.protocols == (OneContext(),)
        protocols = recipe.tuning or (recipe.protocols if alone else ())
        if not protocols or len(recipe.tasks) != 1:
            raise BenchmarkError(
                f"the suite '{suite}' cannot be tuned: its runs must be of one task, in one "
                "context without demonstrations, as those of quick, bottles and rivals are, or it "
                "must have tuning contexts, as push, pouring and pick-and-place have."
            )
        ((task, settings),) = recipe.tasks.items()
        size = budget or recipe.budget
        return cls(suite, task, dict(settings), size, tuple(seeds), n_trials, protocols, measure)


@dataclass(frozen=True)
class Trial:
    """One setting.

    :param chosen: values by the names of the search space; empty: as in the suite
    :param cost: what it cost; None where a run failed
    """

    chosen: dict[str, Value]
    cost: float | None


@dataclass(frozen=True)
class StudySummary:
    """What is kept of a study.

    :param label: of the algorithm in its suite
    :param algorithm: its stable name
    :param plan: what was equal for all
    :param space: what was tuned
    :param trials: in their order
    """

    label: str
    algorithm: str
    plan: TuningPlan
    space: dict[str, Any]
    trials: tuple[Trial, ...]

    @property
    def best(self) -> Trial:
        """The trial of least cost, the earliest of equal ones."""
        return min(self.trials, key=lambda t: np.inf if t.cost is None else t.cost)

    def write(self, folder: Path) -> Path:
        """Write the summary as JSON, and return its path.

        :param folder: of the studies
        """
        path = study_path(folder, self.plan.suite, self.label)
        path.parent.mkdir(parents=True, exist_ok=True)
        trials = [asdict(trial) for trial in self.trials]
        content = {
            "label": self.label,
            "algorithm": self.algorithm,
            "plan": self.plan.record,
            "space": self.space,
            "trials": trials,
            "best": asdict(self.best),
        }
        write_whole({path: f"{json.dumps(content, indent=1)}\n".encode()})
        return path


def tune(
    label: str,
    algorithm: Algorithm,
    plan: TuningPlan,
    on_trial: Callable[[Trial], None] = lambda _: None,
) -> StudySummary:
    """Try settings of an algorithm, proposed by Optuna's sampler, and return what they cost.

    :param label: of the algorithm in its suite
    :param algorithm: as the suite has it
    :param plan: what is equal for all
    :param on_trial: told each trial
    :raises BenchmarkError: it declares nothing to tune, or Optuna is not installed
    """
    space = space_of(algorithm, plan)
    if not space:
        raise BenchmarkError(f"{label} declares no search space: its class needs 'tunable'.")
    try:
        import optuna
    except ImportError as error:
        raise BenchmarkError(
            "nmp-bench tune needs Optuna; install it with 'pip install sb3-nmp[tune]'."
        ) from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = optuna.samplers.TPESampler(seed=plan.seeds[0])
    study = optuna.create_study(sampler=sampler)
    trials = [Trial({}, cost_of(label, algorithm, plan))]
    on_trial(trials[0])
    while len(trials) < plan.n_trials:
        asked = study.ask()
        chosen = {name: suggest(asked, name, what) for name, what in space.items()}
        cost = cost_of(label, with_settings(algorithm, chosen), plan)
        failed = optuna.trial.TrialState.FAIL
        study.tell(asked, cost) if cost is not None else study.tell(asked, state=failed)
        trials.append(Trial(chosen, cost))
        on_trial(trials[-1])
    kept = {name: plain(asdict(what)) for name, what in space.items()}
    return StudySummary(label, algorithm.name, plan, kept, tuple(trials))


def tune_suite(
    recipe: Recipe,
    plan: TuningPlan,
    folder: Path,
    labels: Sequence[str] | None = None,
    overwrite: bool = False,
) -> Iterator[str]:
    """Tune the algorithms of a suite one after the other, and yield a line about each.

    :param recipe: what the suite is made of
    :param plan: what is equal for all
    :param folder: of the studies; those that it holds are kept
    :param labels: of the algorithms; all by default
    :param overwrite: do studies again that the folder holds
    :raises BenchmarkError: no such algorithm
    """
    known = list(recipe.algorithms)
    where = f"the suite '{plan.suite}'"
    chosen = known if labels is None else [find_label(label, known, where) for label in labels]
    for label in chosen:
        path = study_path(folder, plan.suite, label)
        if path.exists() and not overwrite:
            yield f"{label}: kept, {path} is there"
            continue
        summary = tune(label, recipe.algorithms[label], plan)
        first, best = summary.trials[0], summary.best
        yield (
            f"{label}: {plan.told(first)} as in the suite, {plan.told(best)} with "
            f"{best.chosen or 'the same'}, {len(summary.trials)} trials of {plan.n_runs} runs; "
            f"{summary.write(folder)}"
        )


def study_path(folder: Path, suite: str, label: str) -> Path:
    """Return where an algorithm's study is kept.

    :param folder: of the studies
    :param suite: its name
    :param label: of the algorithm
    """
    return folder / suite / f"{slug(label)}.json"


def space_of(algorithm: Algorithm, plan: TuningPlan) -> SearchSpace:
    """Return what is tuned of an algorithm: more where it is shown demonstrations.

    :param algorithm: as the suite has it
    :param plan: what is equal for all
    """
    kind = algorithm.load()
    shown = plan.protocols != (OneContext(),)
    more = getattr(kind, "tunable_with_demonstrations", {}) if shown else {}
    return {**getattr(kind, "tunable", {}), **more}


def suggest(trial: "optuna.Trial", name: str, what: object) -> Value:
    """Let Optuna propose a value.

    :param trial: that is made up
    :param name: of what is tuned
    :param what: a `Range` or a `Choice`
    """
    if isinstance(what, Choice):
        return trial.suggest_categorical(name, what.values)
    bounds: Any = what
    if bounds.integer:
        return trial.suggest_int(name, int(bounds.low), int(bounds.high), log=bounds.log)
    return trial.suggest_float(name, bounds.low, bounds.high, log=bounds.log)


def with_settings(algorithm: Algorithm, chosen: dict[str, Value]) -> Algorithm:
    """Return an algorithm with chosen values, which go before those of its suite.

    :param algorithm: as the suite has it
    :param chosen: by the names of its search space
    """
    made = arguments_of(algorithm.load(), chosen, algorithm.settings)
    return replace(algorithm, settings={**algorithm.settings, **made})


def cost_of(label: str, algorithm: Algorithm, plan: TuningPlan) -> float | None:
    """Return what settings cost on the tuning seeds; None where a run fails.

    :param label: of the algorithm
    :param algorithm: with the settings
    :param plan: what is equal for all
    """
    costs = []
    for protocol in plan.protocols:
        for seed in plan.seeds:
            run = RunSpecification(
                label, algorithm, plan.task, seed, plan.budget, protocol, plan.task_settings
            )
            try:
                curve = execute(run).measured.curve
            except Exception:  # whatever an algorithm raises is this setting's result
                return None
            costs.append(plan.cost(curve))
    return float(np.mean(costs))
