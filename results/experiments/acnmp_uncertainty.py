"""Whether an ensemble of CNMPs answers better than one, and knows where it does not know.

``python -m results.experiments.acnmp_uncertainty --seeds 1000 1001 1002 --members 1 3 5`` trains
on an expert's demonstrations of three tasks and prints a row for each task, seed and number of
members:

- time of pre-training, in seconds of processor time;
- error of the answers in unseen contexts from the expert's, root mean square and median over
  contexts, in the trajectory's unit;
- what the answers cost: share of the apertures that fail, median path error of the push in m^2;
- epistemic standard deviation, averaged over time and dimensions: median and largest in these
  contexts ("inside"), median and smallest "far", which is 1.5 to 2 times the demonstrated
  contexts' range from their centre, in a random direction.
"""

import argparse
import time
from typing import Any

import numpy as np
import torch as th

from benchmark_envs import TrajectoryEnv, make_task
from sb3_nmp import ACNMP, CNMPArchitecture, Demonstrations

#: numbers of demonstrations and of unseen contexts, by task
TASKS = {"nmp/Aperture-v0": (30, 200), "nmp/Push-v0": (10, 30), "nmp/Pouring-v1": (10, 30)}
N_FAR = 100


def far_contexts(shown: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return contexts far from the demonstrated ones, shape (N_FAR, C).

    :param shown: demonstrated contexts, shape (N, C)
    :param rng: draws directions and distances
    """
    low, high = shown.min(axis=0), shown.max(axis=0)
    directions = rng.normal(size=(N_FAR, len(low)))
    directions /= np.abs(directions).max(axis=1, keepdims=True)
    return (low + high) / 2 + directions * (high - low) * rng.uniform(1.5, 2, size=(N_FAR, 1))


def cost(task: Any, name: str, contexts: np.ndarray, answers: np.ndarray) -> str:  # noqa: ANN401
    """Return what answers cost, or nothing of a task whose rewards say little about them.

    :param task: that executes them
    :param name: of the task
    :param contexts: shape (N, C)
    :param answers: shape (N, T, D)
    """
    if "Pouring" in name:
        return ""
    done = [task.simulate(context, way) for context, way in zip(contexts, answers, strict=True)]
    if "Aperture" in name:
        return f"{1 - np.mean([rollout.successes[0] for rollout in done]):.3f} fail"
    return f"{np.median([-rollout.rewards[0] for rollout in done]):.3f}"


def measure(name: str, seed: int, n_members: int) -> str:
    """Return a row of the table.

    :param name: of the task
    :param seed: of demonstrations and networks; the unseen contexts are those of ``seed + 500``
    :param n_members: of the ensemble
    """
    n_shown, n_unseen = TASKS[name]
    task = make_task(name, n_threads=1)
    shown = Demonstrations.from_task(task, n_shown, seed=seed)
    unseen = Demonstrations.from_task(task, n_unseen, seed=seed + 500)
    settings = {"cnmp": CNMPArchitecture(n_members=n_members)}
    env = TrajectoryEnv(task)
    model = ACNMP("MlpPolicy", env, demonstrations=shown, seed=seed, policy_kwargs=settings)
    begin = time.process_time()
    model.pretrain()
    seconds = time.process_time() - begin
    found = model.predict_distribution(unseen.contexts)
    errors = np.sqrt(np.mean((found.mean - unseen.trajectories) ** 2, axis=(1, 2)))
    error = np.sqrt(np.mean(errors**2))
    row = (
        f"| {name[4:-3]} | {seed} | {n_members} | {seconds:.1f} | {error:.3g} "
        f"| {np.median(errors):.3g} | {cost(task, name, unseen.contexts, found.mean)} |"
    )
    if n_members == 1:
        return row + " | | |"
    inside = found.epistemic_std.mean(axis=(1, 2))
    with th.no_grad():
        contexts = th.as_tensor(far_contexts(shown.contexts, np.random.default_rng(seed)))
        far = model.policy.distribution(contexts, None).epistemic_std.mean(axis=(1, 2))
    return (
        f"{row} {np.median(inside):.3g} ({inside.max():.3g}) | {np.median(far):.3g} "
        f"({far.min():.3g}) | {np.median(far) / np.median(inside):.1f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--members", type=int, nargs="+", default=[5])
    options = parser.parse_args()
    th.set_num_threads(1)
    print(
        "| task | seed | members | time [s] | error | median | cost | inside (largest) | "
        "far (smallest) | times |"
    )
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|")
    for name in TASKS:
        for seed in options.seeds:
            for n_members in options.members:
                print(measure(name, seed, n_members), flush=True)


if __name__ == "__main__":
    main()
