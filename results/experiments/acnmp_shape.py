"""Whether adaptation keeps the character of the demonstrations (thesis Fig. 5.3 to 5.5).

``python -m results.experiments.acnmp_shape`` adapts to the two extrapolation targets of
``nmp/Push-v0`` with ACNMP and with ablations of it. As in the thesis's experiment the reward tells
only what is to be reached (``reward="goal"``, the final distance), and not how. It prints a
Markdown table of

- path error: of the cylinder from the expert's, which the reward does not tell, in m^2;
- shape: distance of the found trajectory from the demonstrations' shape space, the affine span of
  their principal components that hold 99 % of their variance, root mean square in rad;
- answer's shape: the same of the network's own answer after the adaptation;
- roughness: root mean square second difference of the found trajectory over that of the
  demonstrations;
- forgetting: error of the network's answers in the demonstrated contexts after the adaptation,
  root mean square in rad.
"""

from typing import Any

import numpy as np
import torch as th

from benchmark_envs import TrajectoryEnv, leave_one_out, make_task
from benchmark_envs.tasks.push import EXTRAPOLATION_TARGETS
from results.adaptation.shape import distance_from_shapes
from results.suites.push_ablations import ALGORITHMS
from sb3_nmp import ACNMP, Demonstrations

LABELS = ("ACNMP", "latents too", "policy gradient, to go", "RL only")
SEEDS = range(5)
BUDGET = 130


def roughness(trajectories: np.ndarray) -> float:
    """Return the root mean square second difference over time.

    :param trajectories: shape (..., T, D)
    """
    return float(np.sqrt(np.mean(np.diff(trajectories, 2, axis=-2) ** 2)))


def measure(label: str, target: int, seed: int) -> tuple[float, ...]:
    """Adapt once: solved, path error in m^2, shape, answer's shape, roughness and forgetting.

    :param label: of the suite push-ablations
    :param target: that is left out
    :param seed: of the run
    """
    task: Any = make_task("nmp/Push-v0", n_threads=1, reward="goal")
    path_task = make_task("nmp/Push-v0", n_threads=1)
    shown, held_out = leave_one_out("nmp/Push-v0", target)
    demonstrations = Demonstrations.from_task(task, shown)
    env = TrajectoryEnv(task, context=held_out)
    settings = dict(ALGORITHMS[label].settings)
    model = ACNMP("MlpPolicy", env, demonstrations=demonstrations, seed=seed, **settings)
    model.learn(BUDGET)
    found = model.predict(held_out.astype(np.float32), deterministic=True)[0]
    rollout = path_task.simulate(held_out, found)
    cnmp = model.policy.cnmp
    answer, answers = cnmp.trajectories(held_out[None])[0], cnmp.trajectories(shown)
    return (
        float(rollout.successes[0]),
        -float(rollout.rewards[0]),
        distance_from_shapes(found, demonstrations.trajectories),
        distance_from_shapes(answer, demonstrations.trajectories),
        roughness(found) / roughness(demonstrations.trajectories),
        float(np.sqrt(np.mean((answers - demonstrations.trajectories) ** 2))),
    )


def main() -> None:
    """Print the table: medians over targets and seeds."""
    th.set_num_threads(1)
    task = make_task("nmp/Push-v0", n_threads=1)
    experts = []
    for target in EXTRAPOLATION_TARGETS:
        shown, held_out = leave_one_out("nmp/Push-v0", target)
        demonstrated = np.stack([task.demonstrate(context) for context in shown])
        experts.append(distance_from_shapes(task.demonstrate(held_out), demonstrated))
    titles = "path error [m^2] | shape [rad] | answer's shape [rad] | roughness | forgetting [rad]"
    print(f"| | solved | {titles} |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    print(f"| expert at the left-out target | | | {np.median(experts):.3f} | | | |")
    for label in LABELS:
        rows = np.array(
            [measure(label, target, s) for target in EXTRAPOLATION_TARGETS for s in SEEDS]
        )
        error, shape, answer, rough, forgotten = np.median(rows[:, 1:], axis=0)
        print(
            f"| {label} | {int(rows[:, 0].sum())}/{len(rows)} | {error:.3f} | {shape:.3f} | "
            f"{answer:.3g} | {rough:.2f} | {forgotten:.4f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
