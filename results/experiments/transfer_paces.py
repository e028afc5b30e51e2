"""A skill told to another arm where each demonstration has a pace of its own; see ``transfer.md``.

``python -m results.experiments.transfer_paces FILE.jsonl`` does a run for each of the paces and
seeds, appends a line for each, and skips those that are there.
"""

import sys
from pathlib import Path

import numpy as np
import torch as th
from numpy.typing import NDArray

from baselines import MomentRegression
from results.experiments.json_lines import Line, append_missing
from results.transfer.runs import ARCHITECTURE, TRAINING, by_moments, nearest_skill
from results.transfer.skills import SOURCE, TARGET, button, proxy_contexts, shown
from sb3_nmp import Demonstrations, SkillTransfer

FloatArray = NDArray[np.float64]
#: standard deviations of the logarithm of a demonstration's speed, for each of three waves
PACES, N_WAVES = (0.25, 0.5), 3
FIRST_SEED, SEEDS = 77, range(2, 12)


def at_own_pace(trajectories: FloatArray, strength: float, rng: np.random.Generator) -> FloatArray:
    """Return trajectories at random, smooth paces; their ends stay, shape (N, T, D).

    >>> line = np.linspace(0, 1, 5)[None, :, None]
    >>> at_own_pace(line, 0.0, np.random.default_rng(0))[0, :, 0].tolist()
    [0.0, 0.25, 0.5, 0.75, 1.0]

    :param trajectories: shape (N, T, D)
    :param strength: of the pace, one of `PACES`
    :param rng: the generator to draw from
    """
    time = np.linspace(0.0, 1.0, trajectories.shape[1])
    waves = np.sin(np.pi * np.arange(1, N_WAVES + 1)[:, None] * time)
    found = []
    for each in trajectories:
        speed = np.exp(strength * rng.normal(size=N_WAVES) @ waves)
        passed = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2)])
        found.append([np.interp(passed / passed[-1], time, joint) for joint in each.T])
    return np.array(found).transpose(0, 2, 1)


def measure(row: str, seed: int) -> Line:
    """Return what each way makes of the button press, without any refinement.

    :param row: the strength of the paces
    :param seed: of proxies, paces and networks
    """
    th.set_num_threads(1)
    strength = float(row)
    contexts, rng = proxy_contexts(seed), np.random.default_rng([FIRST_SEED, seed])
    source, target = (
        Demonstrations(contexts, at_own_pace(shown(arm, contexts).trajectories, strength, rng))
        for arm in (SOURCE, TARGET)
    )
    told = at_own_pace(button(SOURCE)[2][None], strength, rng)[0]
    skills = SkillTransfer(
        source, target, architecture=ARCHITECTURE, training=TRAINING, seed=seed
    ).fit()
    answers = {
        "skills": skills.translate(told),
        "moments": by_moments(source, target, seed).translate(told),
        "regression": MomentRegression(source, target).fit().translate(told),
        "nearest": target.trajectories[nearest_skill(told, source.trajectories)],
    }
    task, context, _ = button(TARGET)
    low, high = task.trajectory_space.low, task.trajectory_space.high
    tried = {
        way: task.simulate(context, np.clip(answer, low, high)) for way, answer in answers.items()
    }
    return {"row": row, "seed": seed} | {
        way: {
            "touched": bool(rollout.outcomes["touched"][0]),
            "solved": bool(rollout.successes[0]),
            "error": round(-float(rollout.rewards[0]), 4),
        }
        for way, rollout in tried.items()
    }


def main() -> None:
    """Do the runs that the file does not hold yet."""
    runs = [(str(strength), seed) for strength in PACES for seed in SEEDS]
    append_missing(Path(sys.argv[1]), measure, runs, "seed")


if __name__ == "__main__":
    main()
