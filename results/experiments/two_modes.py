"""Both ways through the bottles from one run: how often they are found, and how good they are.

``python -m results.experiments.two_modes 200 20`` does it for 20 seeds from 200 on, for RC-NMP,
for GA judged by Gaussian processes, its twin, and for CMA-ME, and prints a Markdown table; names of
rows may follow.
"""

import sys
from typing import Any, cast

import numpy as np
from joblib import Parallel, delayed
from stable_baselines3.common.env_util import make_vec_env

from baselines import CMAME, GA
from benchmark_envs import TrajectoryVecEnv, make_task
from benchmark_envs.tasks.bottles import BOTTLES
from sb3_nmp import RCNMP

ENV_ID, BUDGET = "nmp/Bottles-v0", 400
#: median of RC-NMP with a single mode, 50 seeds (rcnmp_bottles.md), and what counts as near it
SINGLE, NEAR = -0.1329, 0.005
ROWS: dict[str, tuple[Any, dict[str, Any]]] = {
    "RC-NMP": (RCNMP, {"n_modes": 2}),
    "GA, judged": (GA, {"n_modes": 2, "n_candidates": 10, "n_explorers": 1}),
    "CMA-ME": (CMAME, {}),
}


def rewards(algorithm: Any, settings: dict[str, Any], seed: int) -> dict[str, float]:  # noqa: ANN401
    """Return the reward of the best success that a run returns for each mode.

    :param algorithm: its class
    :param settings: of its constructor
    :param seed: of the run
    """
    env = make_vec_env(ENV_ID, n_envs=20, vec_env_cls=TrajectoryVecEnv)
    model = algorithm("MlpPolicy", env, seed=seed, **settings).learn(BUDGET)
    trajectories, _ = model.policy.modes(BOTTLES[None])
    task = make_task(ENV_ID, n_threads=1)
    rollouts, found = task.simulate(BOTTLES, trajectories[0]), {}
    for row in np.flatnonzero(rollouts.successes):
        mode = task.mode_of(BOTTLES, rollouts.executed[row])
        found[mode] = max(found.get(mode, -np.inf), float(rollouts.rewards[row]))
    return found


def main() -> None:
    """Print the table."""
    first, n = int(sys.argv[1]), int(sys.argv[2])
    print(f"| | both found | worse one: median | worst | within {NEAR} of {SINGLE} | better one |")
    print("|---|--:|--:|--:|--:|--:|")
    for name in sys.argv[3:] or ROWS:
        algorithm, settings = ROWS[name]
        seeds = range(first, first + n)
        done = Parallel(n_jobs=-1)(delayed(rewards)(algorithm, settings, seed) for seed in seeds)
        runs = cast(list[dict[str, float]], done)
        both = np.array([sorted(run.values()) for run in runs if len(run) == 2]).reshape(-1, 2)
        near = int((both[:, 0] >= SINGLE - NEAR).sum())
        print(
            f"| {name} | {len(both)}/{n} | {np.median(both[:, 0]):.4f} | {both[:, 0].min():.4f} | "
            f"{near}/{n} | {np.median(both[:, 1]):.4f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
