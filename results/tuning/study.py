"""A tuning study: trials of an algorithm's settings by one plan, and what is kept of it.

The first trial are the settings that the suite has, so that tuning can only be a gain on the tuning
seeds. Trials are kept as they finish; a study that was ended goes on with them: its sampler is told
of them again, in their order, and then proposes what it would have proposed.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from results.exceptions import BenchmarkError
from results.harness.slugs import slug
from results.harness.specification import Algorithm, plain
from results.harness.suite import Recipe, find_label
from results.harness.whole_files import write_whole
from results.tuning.plan import Trial, TuningPlan
from results.tuning.trials import cost_of
from sb3_nmp.common.tuning import Choice, SearchSpace, Value, arguments_of, value_of

if TYPE_CHECKING:
    import optuna


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
        self._write(path)
        unfinished_path(path).unlink(missing_ok=True)
        return path

    def keep(self, folder: Path) -> Path:
        """Write what there is so far, for the study to go on with, and return its path.

        A finished one that is done anew is removed as soon as a trial has not failed.

        :param folder: of the studies
        """
        finished = study_path(folder, self.plan.suite, self.label)
        self._write(unfinished_path(finished))
        if self.best.cost is not None:
            finished.unlink(missing_ok=True)
        return unfinished_path(finished)

    def _write(self, path: Path) -> None:
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


def tune(
    label: str,
    algorithm: Algorithm,
    plan: TuningPlan,
    on_trial: Callable[[StudySummary], object] = lambda _: None,
    known: Sequence[Trial] = (),
) -> StudySummary:
    """Try settings of an algorithm, proposed by Optuna's sampler, and return what they cost.

    :param label: of the algorithm in its suite
    :param algorithm: as the suite has it
    :param plan: what is equal for all
    :param on_trial: told all trials so far after each one
    :param known: the first trials, of this very study, which are not done again
    :raises BenchmarkError: it declares nothing to tune, Optuna is not installed, or the known
        trials are not those that the sampler proposes
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
    kept = {name: plain(asdict(what)) for name, what in space.items()}
    summary = StudySummary(label, algorithm.name, plan, kept, ())
    for n_done in range(plan.n_trials):
        asked = study.ask() if n_done else None  # the first trial is none of the sampler's
        chosen = {name: suggest(asked, name, what) for name, what in space.items()} if asked else {}
        if n_done < len(known):
            trial = _same(label, n_done, known[n_done], chosen)
        else:
            trial = Trial(chosen, cost_of(label, with_settings(algorithm, chosen), plan))
        if asked:
            failed = optuna.trial.TrialState.FAIL if trial.cost is None else None
            study.tell(asked, trial.cost, state=failed)
        summary = replace(summary, trials=(*summary.trials, trial))
        if n_done >= len(known):
            on_trial(summary)
    return summary


def _same(label: str, number: int, known: Trial, chosen: dict[str, Value]) -> Trial:
    """Return a known trial, if the sampler proposes its settings now.

    :raises BenchmarkError: it proposes others
    """
    if plain(known.chosen) != plain(chosen):
        raise BenchmarkError(
            f"the study of {label} cannot go on: its trial {number} tried {known.chosen}, and "
            f"today's Optuna and search space give {chosen}. Do it with the versions it was begun "
            "with, or begin it anew (--overwrite)."
        )
    return known


def tune_suite(
    recipe: Recipe,
    plan: TuningPlan,
    folder: Path,
    labels: Sequence[str] | None = None,
    overwrite: bool = False,
) -> Iterator[str]:
    """Tune the algorithms of a suite one after the other, and yield lines about each.

    A study that was ended before its last trial goes on after the last one that is kept.

    :param recipe: what the suite is made of
    :param plan: what is equal for all
    :param folder: of the studies; those that it holds are kept
    :param labels: of the algorithms; all by default
    :param overwrite: do studies again that the folder holds
    :raises BenchmarkError: no such algorithm, all trials of one failed, the folder cannot be
        written, or it holds a study of another plan, beside which those of this one would not be
        tuned equally
    """
    known = list(recipe.algorithms)
    where = f"the suite '{plan.suite}'"
    chosen = known if labels is None else [find_label(label, known, where) for label in labels]
    for label in known:
        path = study_path(folder, plan.suite, label)
        held = path if path.exists() else unfinished_path(path)
        if held.exists() and not (overwrite and label in chosen):
            _check_same_plan(held, plan)
    try:
        (folder / plan.suite).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchmarkError(
            f"--out is '{folder}', where nothing can be written ({error.strerror})."
        ) from error
    for label in chosen:
        path = study_path(folder, plan.suite, label)
        if path.exists() and not overwrite:
            unfinished_path(path).unlink(missing_ok=True)
            yield f"{label}: kept, {path} is there"
            continue
        begun = () if overwrite else _begun(path)
        if begun:
            yield f"{label}: going on after {len(begun)} of {plan.n_trials} trials"
        keep = partial(StudySummary.keep, folder=folder)
        summary = tune(label, recipe.algorithms[label], plan, keep, begun)
        first, best = summary.trials[0], summary.best
        if best.cost is None:
            unfinished_path(path).unlink(missing_ok=True)
            raise BenchmarkError(
                f"all {plan.n_trials} trials of {label} failed, so there is no study of it: mend "
                "what the lines above tell, or name the other algorithms (--algorithms)."
            )
        yield (
            f"{label}: {plan.told(first)} as in the suite, {plan.told(best)} with "
            f"{best.chosen or 'the same'}, {len(summary.trials)} trials of {plan.n_runs} runs; "
            f"{summary.write(folder)}"
        )


def _begun(path: Path) -> tuple[Trial, ...]:
    """Return the trials of a study that was ended before its last one; none where there is none.

    :param path: of the study when it is finished
    :raises BenchmarkError: they cannot be read
    """
    unfinished = unfinished_path(path)
    if not unfinished.exists():
        return ()
    return tuple(Trial(each["chosen"], each["cost"]) for each in read_study(unfinished)["trials"])


def _check_same_plan(path: Path, plan: TuningPlan) -> None:
    """Raise where a study was made by another plan.

    :raises BenchmarkError: it was, or cannot be read
    """
    made = read_study(path)["plan"]
    told = "; ".join(
        f"{name} was {made.get(name)}, and {asked} is asked"
        for name, asked in plan.record.items()
        if made.get(name) != asked
    )
    if told:
        raise BenchmarkError(
            f"'{path}' is a study of another plan: {told}. Algorithms are tuned equally: ask for "
            "the same, write to another folder (--out), or do all studies again (--overwrite)."
        )


def read_study(path: Path) -> dict[str, Any]:
    """Return plan, trials and best of what `StudySummary.write` has written.

    :param path: of the file
    :raises BenchmarkError: it is none
    """
    try:
        study = json.loads(path.read_text(encoding="utf-8"))
        best = {name: study["best"][name] for name in ("chosen", "cost")}
        return {"plan": dict(study["plan"]), "trials": list(study["trials"]), "best": best}
    except (ValueError, KeyError, TypeError) as error:
        raise BenchmarkError(
            f"'{path}' is no study that can be read ({error!r}): restore it from the repository, "
            "or make it anew with nmp-bench tune --overwrite."
        ) from error


def study_path(folder: Path, suite: str, label: str) -> Path:
    """Return where an algorithm's study is kept.

    :param folder: of the studies
    :param suite: its name
    :param label: of the algorithm
    """
    return folder / suite / f"{slug(label)}.json"


def unfinished_path(path: Path) -> Path:
    """Return where the trials of a study are kept until it has all of them.

    :param path: of the study when it is finished
    """
    return path.with_suffix(".unfinished.json")


def space_of(algorithm: Algorithm, plan: TuningPlan) -> SearchSpace:
    """Return what is tuned of an algorithm.

    Over contexts that may be something else, and where demonstrations are shown it is more.

    What the suite has set lies in it: where an algorithm's own space does not reach so far, it is
    made to. Where the budget is too short for two generations of at least two of its populations,
    smaller ones stand in their place: two to six generations. Where the suite tries several
    rollouts in each context, populations are multiples of them.

    :param algorithm: as the suite has it
    :param plan: what is equal for all
    """
    kind = algorithm.load()
    space = dict(getattr(kind, "tunable", {}))
    if plan.over_contexts:
        space = dict(getattr(kind, "tunable_over_contexts", space))
    if plan.shows:
        space |= getattr(kind, "tunable_with_demonstrations", {})
    declared = space.get("population_size")
    if isinstance(declared, Choice):
        each = cast(int, algorithm.settings.get("rollouts_per_context", 1))
        space["population_size"] = _populations(declared, plan.budget, each)
    own = {name: value_of(kind, name, algorithm.settings) for name in space}
    return {
        name: what if own[name] is None else what.reaching(own[name])
        for name, what in space.items()
    }


def _populations(declared: Choice, budget: int, each: int) -> Choice:
    """Return the populations that are tried.

    :param declared: by the algorithm
    :param budget: rollouts of a run
    :param each: rollouts in each context, of which a population is a multiple
    """
    values = [n for n in declared.values if isinstance(n, int) and n % each == 0]
    smaller = sorted({max(2, budget // n) for n in (6, 4, 3, 2)})
    too_short = len([n for n in values if 2 * n <= budget]) < 2 <= len(smaller)
    return Choice(tuple(smaller if too_short and each == 1 else values or [each]))


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
