"""SB3's ``evaluations.npz`` as a record: what an `EvalCallback` saw of anyone's run."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import accumulate
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from results.exceptions import BenchmarkError
from results.harness.environments import RunTask
from results.harness.plugins import bring_in
from results.harness.record_files import read_records, write_record
from results.harness.records import (
    Measurements,
    ProtocolRecord,
    Provenance,
    Result,
    RunRecord,
    Seconds,
    SpecificationRecord,
)
from results.harness.slugs import slug

KEYS = ("timesteps", "results", "ep_lengths", "successes")
IMPORTED = "imported from SB3's evaluations.npz; 'best' is that of its evaluations"


@dataclass(frozen=True)
class Source:
    """What the file does not say of its run.

    :param path: of the file
    :param task: on which the run was made, its id
    :param label: the algorithm's name in tables
    :param seed: of the run
    :param budget: its rollouts; by default those of the last evaluation, later ones are left out
    :param steps: SB3 steps per rollout: 1 where an action is a whole trajectory
    :param imports: modules that register the task
    """

    path: Path
    task: str
    label: str
    seed: int = 0
    budget: int | None = None
    steps: int = 1
    imports: tuple[str, ...] = ()


def import_evaluations(source: Source, folder: Path, overwrite: bool = False) -> Path:
    """Write a run's evaluations as a record among the runs of a folder.

    The evaluations must have taken place in one pinned context: all episodes of one are alike.

    :param source: the file, and what it does not say
    :param folder: of the runs
    :param overwrite: replace a record of the same name
    :return: the record's file
    :raises BenchmarkError: no such file, or one that tells no run in one context; rewards above
        the task's best; a record of that name, or runs of another budget in the folder
    :raises UnknownTaskError: no such task
    """
    _check(source)
    bring_in(source.imports, source.task)
    curve = _curve(source, _read(source))
    asked = SpecificationRecord(
        source.label, IMPORTED, "imported", {}, source.task, {}, source.seed,
        source.budget or curve["rollouts"][-1], False, ProtocolRecord("one-context"),
    )  # fmt: skip
    path = folder / f"{asked.stem}.json"
    if path.exists() and not overwrite:
        raise BenchmarkError(
            f"'{path}' is there already; give another --label or --seed, or replace it "
            "(--overwrite)."
        )
    _check_budgets(asked, folder, path)
    run = RunTask(source.task, source.seed, asked.budget)
    _check_best(source, curve, run.task.reward_range[1])
    result = Result(run.task_record, Seconds(None, 0.0), Measurements(curve))
    folder.mkdir(parents=True, exist_ok=True)
    write_record(path, RunRecord(asked, _origin(source.path), "finished", result))
    return path


def _check(source: Source) -> None:
    """Raise for a name or a seed that no record can have."""
    if not slug(source.label):
        raise BenchmarkError(
            f"--label is '{source.label}'; it must hold a letter or a digit, as it names the run's "
            "file and row."
        )
    if not 0 <= source.seed < 2**32:
        raise BenchmarkError(f"--seed is {source.seed}; it must be in [0, {2**32 - 1}].")
    if source.budget is not None and source.budget < 1:
        raise BenchmarkError(f"--budget is {source.budget}; a run needs at least 1 rollout.")


def _read(source: Source) -> dict[str, NDArray[Any]]:
    """Return the file's arrays, one row per evaluation."""
    try:
        with source.path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            found = {key: file[key] for key in KEYS if key in file.files}
    except (OSError, ValueError, BadZipFile, EOFError) as error:
        raise BenchmarkError(
            f"'{source.path}' is no readable evaluations.npz ({error}): SB3's EvalCallback writes "
            "one into its log_path, with equally many episodes in each evaluation."
        ) from error
    missing = [key for key in KEYS if key not in found]
    if missing:
        raise BenchmarkError(
            f"'{source.path}' has no {' and no '.join(missing)}; an evaluations.npz has "
            "timesteps, results, ep_lengths and, where info tells 'is_success', successes, which "
            "the benchmark's tables count."
        )
    for key in KEYS:
        if found[key].dtype.kind not in "biuf":
            raise BenchmarkError(
                f"'{source.path}' holds {key} of dtype {found[key].dtype}; they must be numbers."
            )
    n = len(np.atleast_1d(found["timesteps"]))
    shapes = {key: found[key].shape for key in KEYS}
    fits = n > 0 and found["results"].ndim == 2 and found["results"].shape[1] > 0
    if not fits or any(found[key].shape != (n, *found["results"].shape[1:]) for key in KEYS[1:]):
        raise BenchmarkError(
            f"'{source.path}' holds arrays of shapes {shapes}; there must be a time step per "
            "evaluation, and a row per evaluation with its episodes."
        )
    return found


def _curve(source: Source, found: dict[str, NDArray[Any]]) -> dict[str, list[Any]]:
    """Return the curve of a run in one context."""
    told, results = found["timesteps"], found["results"].astype(np.float64)
    if not np.equal(np.mod(told, 1), 0).all():
        raise BenchmarkError(
            f"'{source.path}' holds time steps {told.tolist()[:9]}; each must be a whole number."
        )
    steps = told.astype(np.int64)
    if not np.isfinite(results).all() or steps[0] < 0 or (np.diff(steps) <= 0).any():
        raise BenchmarkError(
            f"'{source.path}' holds time steps {steps.tolist()[:9]} and results from "
            f"{results.min()} to {results.max()}; time steps must ascend and results be finite."
        )
    lengths = set(np.unique(found["ep_lengths"]).tolist())
    if lengths != {source.steps}:
        raise BenchmarkError(
            f"the episodes of '{source.path}' last {sorted(lengths)} steps, and a rollout is said "
            f"to last {source.steps}; costs are counted in rollouts, so all must last as long: "
            "name that number (--steps)."
        )
    told = np.unique(found["successes"])
    if not np.isin(told, (0, 1)).all():
        raise BenchmarkError(
            f"'{source.path}' holds successes of {told.tolist()[:5]}; each must be 0 or 1, of one "
            "episode. Leave means over episodes out: EvalCallback(..., n_eval_episodes=1)."
        )
    successes = found["successes"].astype(bool)
    if (np.ptp(results, axis=1) > 1e-5).any() or (successes != successes[:, :1]).any():
        row = int(np.argmax(np.ptp(results, axis=1)))
        raise BenchmarkError(
            f"the episodes of one evaluation of '{source.path}' have the rewards "
            f"{results[row].tolist()[:5]}: it took place in several contexts, or greedy answers "
            "differ. Evaluate in one: EvalCallback(gym.make(task, context=c), n_eval_episodes=1)."
        )
    if (steps % source.steps).any():
        raise BenchmarkError(
            f"'{source.path}' holds evaluations after {steps.tolist()[:9]} steps, and a rollout "
            f"lasts {source.steps}: each must follow a whole number of rollouts. Choose "
            "EvalCallback's eval_freq so."
        )
    rollouts = steps // source.steps
    within = rollouts <= (source.budget or rollouts[-1])
    if not within.any():
        raise BenchmarkError(
            f"'{source.path}' has its first evaluation after {rollouts[0]} rollouts, "
            f"beyond the budget of {source.budget}; give a larger --budget, or none."
        )
    return _columns(
        rollouts[within].tolist(),
        results[within, 0].tolist(),
        successes[within, 0].tolist(),
    )


def _columns(
    rollouts: Sequence[int], rewards: Sequence[float], successes: Sequence[bool]
) -> dict[str, list[Any]]:
    best = [rewards.index(value) for value in accumulate(rewards, max)]
    return {
        "rollouts": list(rollouts),
        "best_reward": [rewards[i] for i in best],
        "best_success": [successes[i] for i in best],
        "any_success": list(accumulate(successes, lambda one, two: one or two)),
        "greedy_reward": list(rewards),
        "greedy_success": list(successes),
    }


def _check_best(source: Source, curve: dict[str, list[Any]], best: float) -> None:
    """Raise for rewards above the task's best: tables would show an error below 0.

    What is below its worst gains nothing, and settings of the task may allow it.
    """
    largest = max(curve["greedy_reward"])
    if largest > best + 1e-5 * max(1.0, abs(best)):
        raise BenchmarkError(
            f"'{source.path}' holds the reward {largest:.6g}, and none of {source.task} is above "
            f"{best:.6g}: name the task of the run (--task), and evaluate its own rewards, as "
            "VecNormalize(env, training=False, norm_reward=False) leaves them."
        )


def _check_budgets(asked: SpecificationRecord, folder: Path, path: Path) -> None:
    """Raise where a folder holds runs of another budget on the task."""
    for record in read_records(folder).records:
        held = record.specification
        replaced = folder / f"{held.stem}.json" == path
        if held.task == asked.task and held.budget != asked.budget and not replaced:
            raise BenchmarkError(
                f"'{folder}' holds {held.name}, with a budget of {held.budget} rollouts, and this "
                f"run ends at {asked.budget}; runs of one table have one budget: cut it (--budget "
                f"{held.budget}), or name another folder (--out)."
            )


def _origin(path: Path) -> Provenance:
    """Return what is known of where a foreign run was made: the date of its file."""
    written = datetime.fromtimestamp(path.stat().st_mtime, UTC).isoformat(timespec="seconds")
    return Provenance(None, None, {}, "unknown", "unknown", written)
