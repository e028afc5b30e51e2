"""How steadily methods progress (thesis 6.2.2): how much of what was gained is lost on the way.

``python -m results.experiments.steadiness FILE.jsonl`` does a run for each problem of four
via-points, 20 of them, and each row, appends a line for each, skipping those that are there, and
prints a Markdown table. Rollouts are cut into windows of 20, two or four generations; a window's
error is the mean over all of its rollouts, as exploration has it. *Lost* is which part of
its way up and down goes up: 0 is steady, and at 0.5 nothing is gained in all.
"""

import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from results.experiments.json_lines import append_missing, read_lines
from results.harness.greedy import GreedyEvaluation
from results.harness.runner import setting_of
from results.harness.specification import RunSpecification
from results.one_context.protocol import OneContext
from results.report.statistics import mean_interval
from results.suites import via_points

TASK, VARIANT, BUDGET, WINDOW, FIRST_SEED, N_SEEDS = "nmp/ViaPoints-v0", 4, 300, 20, 500, 20
ROWS = ("RC-NMP", "ACNMP, policy gradient", "ACNMP", "GA", "REPS", "CMA-ES")


def lost(errors: NDArray[np.floating]) -> float:
    """Return which part of a curve's way up and down goes up.

    >>> lost(np.array([3.0, 2.0, 1.0])), lost(np.array([3.0, 1.0, 2.0, 1.0]))
    (0.0, 0.25)

    :param errors: shape (W,)
    """
    steps = np.diff(errors)
    return float(steps[steps > 0].sum() / max(np.abs(steps).sum(), 1e-12))


def window_errors(label: str, seed: int) -> list[float]:
    """Return the mean error of each window of a run's rollouts.

    :param label: of the row in the suite via-points
    :param seed: of the run and its problem
    """
    algorithm = via_points.ALGORITHMS[label]
    options = {"n_points": VARIANT}
    run = RunSpecification(label, algorithm, TASK, seed, BUDGET, OneContext(), options)
    prepared = run.protocol.prepare(setting_of(run), None)
    arguments = algorithm.arguments(prepared.demonstrations)
    model = algorithm.load()("MlpPolicy", prepared.env, seed=seed, **arguments)
    model.learn(BUDGET, callback=prepared.evaluation)
    rewards = np.array(cast(GreedyEvaluation, prepared.evaluation).rewards)
    return (-rewards.reshape(-1, WINDOW).mean(axis=1)).tolist()


def measure(label: str, seed: int) -> dict[str, Any]:
    """Return the line of a run.

    :param label: of the row
    :param seed: of the run
    """
    return {"row": label, "seed": seed, "errors": window_errors(label, seed)}


def show(file: Path) -> None:
    """Print the table, with 95 % intervals over problems.

    :param file: one JSON object a line
    """
    found: dict[str, dict[int, NDArray[np.float64]]] = {}
    for each in read_lines(file):
        found.setdefault(each["row"], {})[each["seed"]] = np.array(each["errors"])
    print("| | first window [m] | last | lost | more than RC-NMP |")
    print("|---|--:|--:|--:|--:|")
    for row in (row for row in ROWS if row in found):
        curves = found[row]
        share = np.array([lost(curve) for curve in curves.values()])
        more = [lost(curves[seed]) - lost(found[ROWS[0]][seed]) for seed in curves]
        first, last = (np.mean([curve[i] for curve in curves.values()]) for i in (0, -1))
        print(
            f"| {row} | {first:.3f} | {last:.3f} | {told(share)} | "
            f"{'–' if row == ROWS[0] else told(np.array(more))} |"
        )


def told(values: NDArray[np.float64]) -> str:
    """Return a mean with its interval.

    :param values: one for each problem
    """
    low, high = map(float, mean_interval(values))
    return f"{values.mean():.2f} [{low:.2f}, {high:.2f}]"


def main() -> None:
    """Do the runs that a file does not hold, and print the table."""
    file = Path(sys.argv[1])
    seeds = range(FIRST_SEED, FIRST_SEED + N_SEEDS)
    append_missing(file, measure, [(row, seed) for seed in seeds for row in ROWS], "seed")
    show(file)


if __name__ == "__main__":
    main()
