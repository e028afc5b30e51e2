"""A skill of one arm becomes another arm's (thesis 5.2.3); see ``transfer.md``.

``python -m results.experiments.transfer OUT [--seeds 5]`` writes one JSON file for each run.
"""

import argparse
import json
from pathlib import Path

import torch as th

from results.transfer.runs import TransferRun, measure

WAYS = ("translated", "moments", "regression", "nearest", "scratch")


def runs(n_seeds: int) -> list[TransferRun]:
    """Return the runs: 30 updates of 2 rollouts after a first trajectory, 1000 without one.

    :param n_seeds: of each way
    """
    return [
        TransferRun(way, seed, 1000, 20) if way == "scratch" else TransferRun(way, seed)
        for way in WAYS
        for seed in range(n_seeds)
    ]


def main() -> None:
    """Do the runs that the folder does not hold yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", type=int, default=5)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    th.set_num_threads(1)
    for run in runs(asked.seeds):
        path = asked.out / f"{run.way}-{run.seed}.json"
        if not path.exists():
            measured = measure(run)
            path.write_text(json.dumps(measured), encoding="utf-8")
            print(run, measured["zero_shot"], "solved by rollout", measured["first_solved"])


if __name__ == "__main__":
    main()
