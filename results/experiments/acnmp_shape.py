"""Whether adaptation keeps the character of the demonstrations (thesis Fig. 5.3 to 5.5).

``python -m results.experiments.acnmp_shape FILE.jsonl`` adapts to the two extrapolation targets of
``nmp/Push-v0`` with ACNMP, with ablations of it and with its twins, appends a line for each seed,
skips those that are there, and prints a Markdown table. As in the thesis's experiment the reward
tells only what is to be reached (``reward="goal"``, the final distance), and not how. Measured are

- path error: of the cylinder from the expert's, which the reward does not tell, in m^2;
- shape: distance of the found trajectory from the demonstrations' shape space, the affine span of
  their principal components that hold 99 % of their variance, root mean square in rad;
- answer's shape: the same of the method's own answer after the adaptation, without any memory;
- roughness: root mean square second difference of the found trajectory over that of the
  demonstrations;
- forgetting: error of its own answers in the demonstrated contexts after the adaptation, root mean
  square in rad.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray

from benchmark_envs import TrajectoryEnv, leave_one_out, make_task
from benchmark_envs.tasks.push import EXTRAPOLATION_TARGETS
from results.adaptation.shape import distance_from_shapes
from results.experiments.json_lines import Line, append_missing, read_lines
from results.report.statistics import mean_interval
from results.suites.push_ablations import ALGORITHMS
from sb3_nmp import Demonstrations

LABELS = (
    "ACNMP",
    "ACNMP, network drives",
    "policy gradient, to go",
    "RL only",
    "twin, nearest",
    "twin, ridge",
    "twin, Gaussian process",
)
SEEDS = range(300, 310)
BUDGET = 130
COLUMNS = ("path error [m^2]", "shape [rad]", "answer's shape [rad]", "roughness", "forgetting")


def roughness(trajectories: NDArray[np.floating]) -> float:
    """Return the root mean square second difference over time.

    :param trajectories: shape (..., T, D)
    """
    return float(np.sqrt(np.mean(np.diff(trajectories, 2, axis=-2) ** 2)))


def adapt(label: str, target: int, seed: int) -> list[float]:
    """Adapt once, and return whether it was solved (1 or 0), and what `COLUMNS` names.

    :param label: of the suite push-ablations
    :param target: that is left out
    :param seed: of the run
    """
    task: Any = make_task("nmp/Push-v0", n_threads=1, reward="goal")
    path_task = make_task("nmp/Push-v0", n_threads=1)
    shown, held_out = leave_one_out("nmp/Push-v0", target)
    demonstrations = Demonstrations.from_task(task, shown)
    demonstrated = demonstrations.trajectories
    env = TrajectoryEnv(task, context=held_out)
    algorithm = ALGORITHMS[label]
    make: Any = algorithm.load()
    settings = dict(algorithm.settings)
    model = make("MlpPolicy", env, demonstrations=demonstrations, seed=seed, **settings)
    model.learn(BUDGET)
    found = model.predict(held_out.astype(np.float32), deterministic=True)[0]
    rollout = path_task.simulate(held_out, found)
    contexts = np.concatenate([held_out[None], shown])
    with th.no_grad():
        answer, *answers = model.policy.generalise(th.as_tensor(contexts)).cpu().numpy()
    return [
        float(rollout.successes[0]),
        -float(rollout.rewards[0]),
        distance_from_shapes(found, demonstrated),
        distance_from_shapes(answer, demonstrated),
        roughness(found) / roughness(demonstrated),
        float(np.sqrt(np.mean((np.array(answers) - demonstrated) ** 2))),
    ]


def measure(label: str, seed: int) -> Line:
    """Adapt to each of the targets.

    :param label: of the suite push-ablations
    :param seed: of the runs
    """
    th.set_num_threads(1)
    runs = [adapt(label, target, seed) for target in EXTRAPOLATION_TARGETS]
    return {"row": label, "seed": seed, "runs": [[round(x, 6) for x in run] for run in runs]}


def expert_shape() -> float:
    """Return the distance of the expert's trajectories to the targets, left out, in rad."""
    task = make_task("nmp/Push-v0", n_threads=1)
    found = []
    for target in EXTRAPOLATION_TARGETS:
        shown, held_out = leave_one_out("nmp/Push-v0", target)
        demonstrated = np.stack([task.demonstrate(context) for context in shown])
        found.append(distance_from_shapes(task.demonstrate(held_out), demonstrated))
    return float(np.mean(found))


def print_table(lines: list[Line]) -> None:
    """Print means over targets and seeds, with 95 % intervals over seeds.

    :param lines: of the file
    """
    print(f"| | solved | {' | '.join(COLUMNS)} |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    print(f"| expert at the left-out target | | | {expert_shape():.3f} | | | |")
    for label in LABELS:
        runs = np.array([each["runs"] for each in lines if each["row"] == label])
        if len(runs) == 0:
            continue
        seeds = runs.mean(axis=1)
        measures = np.stack([seeds.mean(axis=0), *mean_interval(seeds)], axis=-1)
        cells = [f"{mean:.3f} [{low:.3f}, {high:.3f}]" for mean, low, high in measures[1:]]
        solved = runs[..., 0]
        print(f"| {label} | {int(solved.sum())}/{solved.size} | {' | '.join(cells)} |")


def main() -> None:
    """Do the runs that the file does not hold yet, and print the table."""
    file = Path(sys.argv[1])
    append_missing(file, measure, [(label, seed) for seed in SEEDS for label in LABELS], "seed")
    print_table(read_lines(file))


if __name__ == "__main__":
    main()
