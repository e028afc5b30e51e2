"""Whether two versions of a task's physics agree: on fixed trajectories, beside their own scatter.

``python -m results.experiments.physics_agreement record nmp/Pouring-v1 before.npz`` draws 500
trajectories (100 of the expert, 400 with noise of sizes that give about half successes, in contexts
over the whole space), simulates each as it is and, four more times (``--repeats``), with set-points
changed by a millionth, and writes what came of them. With ``--like before.npz``, run in
another version of the code, it simulates that file's trajectories instead of drawing its own.

``python -m results.experiments.physics_agreement compare before.npz after.npz`` prints a Markdown
table: how often success agrees between rollouts of one version and those of the other that are
changed by a millionth, and the same within the first version alone, which is the yardstick; the
same for rewards; means and shares of success, which tell whether there is a bias; and rollouts per
second of CPU time on one thread. The rates are only a ratio where both files were recorded on one
machine, one after the other.
"""

import argparse
import time
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark_envs import make_task
from benchmark_envs.task import Task
from benchmark_envs.tasks.pouring_expert import peak_tilt, plan
from sb3_nmp import SmoothNoise

N = 500
N_EXPERT = 100
REPEATS = 4  # more simulations of each trajectory, changed by a millionth
CHANGE = 1e-6
DEGREES = (0.3, 2.0)  # least and most noise of a joint of pick-and-place, standard deviation
PEAK, WOBBLE = 0.5, 0.5  # degrees; noise of the peak of a pouring plan, and of its way
LEAST_LEFT = 0.05  # share of the content; the expert cannot pour more than the rest


def draw_pick_and_place(task: Task, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
    """Draw contexts (N, 2) in m and trajectories (N, T, 6) in rad.

    :param task: pick-and-place
    :param rng: the generator to draw from
    """
    contexts = np.stack([task.sample_context(rng) for _ in range(N)])
    trajectories = np.stack([task.demonstrate(context) for context in contexts])
    noise = SmoothNoise(1.0, n_bases=4).sample(rng, N, trajectories.shape[1:])
    size = np.radians(rng.uniform(*DEGREES, N))
    size[:N_EXPERT] = 0.0
    return contexts, trajectories + size[:, None, None] * noise


def draw_pouring(task: Task, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
    """Draw contexts (N, 2) in g and trajectories (N, T, 1) in rad.

    :param task: pouring
    :param rng: the generator to draw from
    """
    low, high = task.context_space.low, task.context_space.high
    initial = rng.uniform(low[0], high[0], N)
    contexts = np.column_stack([initial, rng.uniform(low[1], (1 - LEAST_LEFT) * initial)])
    contexts = np.stack([task.check_context(context) for context in contexts])
    peaks = np.array([peak_tilt(*context) for context in contexts])
    peaks += np.radians(rng.normal(0.0, PEAK, N))
    wobble = SmoothNoise(np.radians(WOBBLE)).sample(rng, N, (len(task.times), 1))
    trajectories = np.stack([plan(peak, task.times) for peak in peaks]) + wobble
    for i in range(N_EXPERT):
        trajectories[i] = task.demonstrate(contexts[i])
    return contexts, trajectories


def record(task_id: str, path: Path, like: Path | None, repeats: int) -> None:
    """Simulate trajectories, as they are and changed by a millionth, and write what came of them.

    :param task_id: of pouring or pick-and-place
    :param path: of the file to write
    :param like: of a file whose trajectories are simulated
    :param repeats: simulations of changed trajectories
    """
    task, rng = make_task(task_id, n_threads=1), np.random.default_rng(0)
    if like is not None:
        with np.load(like) as given:
            contexts, trajectories = given["contexts"], given["trajectories"]
    elif "Pouring" in task_id:
        contexts, trajectories = draw_pouring(task, rng)
    else:
        contexts, trajectories = draw_pick_and_place(task, rng)
    found: dict[str, list[NDArray]] = {}
    task.simulate(contexts[:1], trajectories[:1])
    begin = time.process_time()
    for repeat in range(1 + repeats):
        factor = np.random.default_rng(repeat).normal(1.0, CHANGE, trajectories.shape)
        rollouts = task.simulate(contexts, trajectories * (factor if repeat else 1.0))
        columns = {"reward": rollouts.rewards, "success": rollouts.successes, **rollouts.outcomes}
        for name, values in columns.items():
            found.setdefault(name, []).append(values)
    rate = N * (1 + repeats) / (time.process_time() - begin)
    stacked: dict[str, Any] = {name: np.stack(values) for name, values in found.items()}
    np.savez_compressed(path, contexts=contexts, trajectories=trajectories, rate=rate, **stacked)
    print(f"{task_id}: {rate:.1f} rollouts/s, success {stacked['success'].mean():.3f}: {path}")


def pairs(one: NDArray, other: NDArray | None) -> tuple[NDArray, NDArray]:
    """Return all pairs of simulations of the same trajectories, each of shape (pairs, N).

    :param one: of a version, shape (simulations, N)
    :param other: of another, shape (simulations, N); None: pairs within the first
    """
    if other is None:
        index = list(combinations(range(len(one)), 2))
        return one[[i for i, _ in index]], one[[j for _, j in index]]
    index = list(product(range(len(one)), range(len(other))))
    return one[[i for i, _ in index]], other[[j for _, j in index]]


def compare(before: Path, after: Path) -> None:
    """Print the table.

    :param before: of `record`
    :param after: of `record`, of the same trajectories
    """
    with np.load(before) as a, np.load(after) as b:
        one, other = dict(a), dict(b)
    if not np.array_equal(one["trajectories"], other["trajectories"]):
        raise SystemExit(f"{after} is of other trajectories: record it with --like {before}.")
    print("| what | before, itself | after, itself | before, after |\n|---|--:|--:|--:|")
    columns = [(one, None), (other, None), (one, other)]
    for name in sorted(set(one) - {"contexts", "trajectories", "rate"}):
        cells: list[list[str]] = [[], [], []]
        for of, (first, second) in zip(cells, columns, strict=True):
            x, y = pairs(first[name], None if second is None else second[name])
            gap = np.abs(x.astype(float) - y)
            if set(np.unique(x)) <= {0.0, 1.0}:
                of.append(f"{100 * (1 - gap.mean()):.2f} %")
            else:
                of.extend(f"{value:.4g}" for value in (np.median(gap), gap.mean(), gap.std()))
        labels = ["agrees"] if len(cells[0]) == 1 else ["gap, median", "gap, mean", "gap, std"]
        for label, *row in zip(labels, *cells, strict=True):
            print(f"| {name}: {label} | {' | '.join(row)} |")
        mean = [set_[name].mean() for set_ in (one, other)]
        paired = other[name].mean(axis=0) - one[name].mean(axis=0)
        error = paired.std() / np.sqrt(len(paired))
        change = f"{paired.mean():+.2g} +- {error:.1g}"
        print(f"| {name}: mean | {mean[0]:.4g} | {mean[1]:.4g} | {change} |")
    ratio = other["rate"] / one["rate"]
    print(f"| rollouts/s | {one['rate']:.1f} | {other['rate']:.1f} | x {ratio:.2f} |")


def main() -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    commands = parser.add_subparsers(dest="command", required=True)
    recording = commands.add_parser("record")
    recording.add_argument("task")
    recording.add_argument("file", type=Path)
    recording.add_argument("--like", type=Path)
    recording.add_argument("--repeats", type=int, default=REPEATS)
    comparison = commands.add_parser("compare")
    comparison.add_argument("before", type=Path)
    comparison.add_argument("after", type=Path)
    options = parser.parse_args()
    if options.command == "record":
        record(options.task, options.file, options.like, options.repeats)
    else:
        compare(options.before, options.after)


if __name__ == "__main__":
    main()
