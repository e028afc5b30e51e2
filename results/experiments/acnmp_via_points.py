"""How well ACNMP's answers pass via-points, beside a ProMP that is conditioned on them.

``python -m results.experiments.acnmp_via_points`` trains the CNMP on an expert's demonstrations
of four tasks, asks it for trajectories through 1, 2 and 3 points, prints a Markdown table and draws
``results/experiments/figures/via_points_met.png``. The points are, by kind,

- own: of the expert's trajectory in the context that is asked for, which was not demonstrated;
- other: of the expert's trajectory in another context, so that context and points disagree;
- any: drawn alone in each dimension between the lowest and the highest demonstrated value;
- outside: beyond the highest, or the lowest, by 30 % of the demonstrated range at that time.

The ProMP is given the points and not the context. Misses are in % of the dimension's demonstrated
range; the worst dimension of the worst point counts. Shape is the distance from the demonstrations'
principal subspace (99 % of their variance), root mean square, in % of the demonstrations' deviation
from their mean; error is the distance from the expert's trajectory, in the same unit.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import torch as th

from baselines.primitives import ProMP
from benchmark_envs import make_task
from results.adaptation.shape import distance_from_shapes
from sb3_nmp import CNMPPretraining, Demonstrations
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.cnmp_training import pretrain

FIGURE = Path(__file__).parent / "figures" / "via_points_met.png"
#: number of demonstrations and settings, by task
TASKS: dict[str, tuple[int, dict[str, Any]]] = {
    "nmp/Push-v0": (10, {}),
    "nmp/Aperture-v0": (30, {}),
    "nmp/Pouring-v1": (10, {}),
    "nmp/Bottles-v0": (10, {"random_bottles": True}),
}
KINDS = ("own", "other", "any", "outside")
METHODS = ("network alone", "ACNMP", "ProMP")
N_QUESTIONS = 20  # of each kind and number of points
BEYOND = 0.3  # of the range
SPACING = 0.1  # least time between two points


@dataclass(frozen=True)
class Question:
    """What is asked for.

    :param context: shape (C,)
    :param rows: time steps of the points, shape (O,)
    :param values: shape (O, D)
    :param truth: the expert's trajectory through the points, shape (T, D), where there is one
    """

    context: np.ndarray
    rows: np.ndarray
    values: np.ndarray
    truth: np.ndarray | None


class Learned:
    """The CNMP and the ProMP of one task and seed.

    :param task: name of the environment
    :param seed: of demonstrations and network; the unseen ones are those of ``seed + 500``
    :param n_bases: of the ProMP
    """

    def __init__(self, task: str, seed: int, n_bases: int) -> None:
        n, settings = TASKS[task]
        made = make_task(task, n_threads=1, **settings)
        self.shown = Demonstrations.from_task(made, n, seed=seed)
        self.unseen = Demonstrations.from_task(made, 30, seed=seed + 500)
        self.range = np.ptp(self.shown.trajectories, axis=(0, 1))
        deviations = self.shown.trajectories - self.shown.trajectories.mean(axis=0)
        self.spread = float(np.sqrt(np.mean(deviations**2)))
        th.manual_seed(seed)
        cnmp = CNMP(self.shown.context_dim, self.shown.trajectory_shape)
        self.cnmp = pretrain(self.shown, CNMPPretraining(), np.random.default_rng(seed), cnmp)
        self.promp = ProMP(n_bases, self.shown.trajectory_shape[0])
        self.weights = self.promp.distribution(self.shown.trajectories)

    def questions(self, kind: str, n_points: int, rng: np.random.Generator) -> Iterator[Question]:
        """Yield questions of one kind.

        :param kind: one of `KINDS`
        :param n_points: O
        :param rng: draws them
        """
        low, high = self.shown.trajectories.min(axis=0), self.shown.trajectories.max(axis=0)
        for _ in range(N_QUESTIONS):
            asked, other = rng.choice(len(self.unseen), 2, replace=False)
            rows = _draw_rows(len(low), n_points, rng)
            truth = None
            if kind in ("own", "other"):
                truth = self.unseen.trajectories[asked if kind == "own" else other]
                values = truth[rows]
            elif kind == "any":
                values = rng.uniform(low[rows], high[rows])
            else:
                beyond = BEYOND * (high - low)[rows]
                values = high[rows] + beyond if rng.uniform() < 0.5 else low[rows] - beyond
            yield Question(self.unseen.contexts[asked], rows, values, truth)

    def answer(self, method: str, asked: Question) -> np.ndarray:
        """Return a trajectory, shape (T, D).

        :param method: one of `METHODS`
        :param asked: context and points
        """
        times = asked.rows / (len(self.cnmp.times) - 1)
        if method == "ProMP":
            given = self.promp.condition(self.weights, times, asked.values)
            return self.promp.bases(self.cnmp.times.numpy()) @ given.mean
        if method == "ACNMP":
            return self.cnmp.trajectories(asked.context[None], (times, asked.values))[0]
        with th.no_grad():
            condition = self.cnmp.condition(self.cnmp.times.new_tensor(asked.context[None]))
            points = self.cnmp.through((times, asked.values)).points
            representation = self.cnmp.representation(condition, points)
            return self.cnmp.mean(condition, representation)[0].numpy()

    def judge(self, found: np.ndarray, asked: Question) -> tuple[float, float, float]:
        """Return miss, shape and error, in %.

        :param found: trajectory, shape (T, D)
        :param asked: what was asked for
        """
        miss = np.max(np.abs(found[asked.rows] - asked.values) / self.range)
        shape = distance_from_shapes(found, self.shown.trajectories) / self.spread
        error = np.nan
        if asked.truth is not None:
            error = np.sqrt(np.mean((found - asked.truth) ** 2)) / self.spread
        return 100 * float(miss), 100 * shape, 100 * float(error)


def _draw_rows(n_time_points: int, n_points: int, rng: np.random.Generator) -> np.ndarray:
    while True:
        rows = np.sort(rng.integers(int(0.2 * n_time_points), n_time_points, n_points))
        if n_points == 1 or np.diff(rows).min() >= SPACING * n_time_points:
            return rows


def measure(task: str, seeds: list[int], n_bases: int) -> list[str]:
    """Return a task's rows of the table.

    :param task: name of the environment
    :param seeds: of demonstrations, network and questions
    :param n_bases: of the ProMP
    """
    found: dict[tuple[str, int, str], list[tuple[float, float, float]]] = {}
    for seed in seeds:
        learned, rng = Learned(task, seed, n_bases), np.random.default_rng(seed)
        for kind in KINDS:
            for n_points in (1, 2, 3):
                for asked in learned.questions(kind, n_points, rng):
                    for method in METHODS:
                        judged = learned.judge(learned.answer(method, asked), asked)
                        found.setdefault((kind, n_points, method), []).append(judged)
    rows = []
    for (kind, n_points, method), judged in found.items():
        misses, shapes, errors = np.array(judged).T
        error = "" if np.isnan(errors).any() else f"{np.median(errors):.1f}"
        rows.append(
            f"| {task[4:-3]} | {kind} | {n_points} | {method} | {np.median(misses):.2g} | "
            f"{misses.max():.2g} | {np.median(shapes):.1f} | {shapes.max():.0f} | {error} |"
        )
    return rows


def draw(seed: int, n_bases: int) -> None:
    """Draw answers through two points, inside and outside, one column for each task.

    :param seed: of demonstrations, network and questions
    :param n_bases: of the ProMP
    """
    figure, axes = plt.subplots(2, len(TASKS), figsize=(14, 6.5), sharex=True)
    styles = {"network alone": ":", "ACNMP": "-", "ProMP": "--"}
    colours = {"network alone": "tab:grey", "ACNMP": "tab:blue", "ProMP": "tab:orange"}
    for column, task in enumerate(TASKS):
        learned, rng = Learned(task, seed, n_bases), np.random.default_rng(seed)
        dimension = int(np.argmax(learned.shown.trajectories.std(axis=0).mean(axis=0)))
        for row, kind in enumerate(("other", "outside")):
            panel, asked = axes[row, column], next(learned.questions(kind, 2, rng))
            times = learned.cnmp.times.numpy()
            panel.plot(times, learned.shown.trajectories[:, :, dimension].T, color="0.85", lw=1)
            for method in METHODS:
                found = learned.answer(method, asked)[:, dimension]
                panel.plot(times, found, styles[method], color=colours[method], label=method)
            panel.plot(times[asked.rows], asked.values[:, dimension], "ko", label="via-points")
            panel.set_title(f"{task[4:-3]}, dimension {dimension}: {kind}", fontsize=10)
    axes[0, 0].legend(fontsize=8)
    for panel in axes[1]:
        panel.set_xlabel("time")
    figure.tight_layout()
    figure.savefig(FIGURE, dpi=80)


def main() -> None:
    """Print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--bases", type=int, default=20, help="of the ProMP")
    options = parser.parse_args()
    th.set_num_threads(1)
    print("| task | points | number | method | miss | worst | shape | worst | error |")
    print("|---|---|--:|---|--:|--:|--:|--:|--:|")
    for task in TASKS:
        print("\n".join(measure(task, options.seeds, options.bases)), flush=True)
    draw(options.seeds[0], options.bases)


if __name__ == "__main__":
    main()
