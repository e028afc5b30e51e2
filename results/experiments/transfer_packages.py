"""Skills of Fetch become the pusher's, two arms that pip packages ship; see ``transfer.md``.

``python -m results.experiments.transfer_packages OUT [--seeds 5]`` writes a JSON file per seed.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch as th

from results.transfer.package_arms import PackageRun, fetch, measure, pusher, tasks_of

#: ahead of either arm, in its own file
FORWARD = np.array([1.0, 0.0, 0.0])


def main() -> None:
    """Do the runs that the folder does not hold yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", type=int, default=5)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    th.set_num_threads(1)
    arms = {
        robot: tasks_of(arm, FORWARD) for robot, arm in (("source", fetch()), ("target", pusher()))
    }
    for seed in range(asked.seeds):
        path = asked.out / f"seed-{seed}.json"
        if not path.exists():
            start = time.perf_counter()
            measured = measure(PackageRun(seed), arms)
            path.write_text(json.dumps(measured), encoding="utf-8")
            print(seed, f"{time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
