"""Whether a change of structure left the runs as they were, bit for bit.

``python -m results.experiments.same_runs record before.json`` does some 70 short runs, of each
algorithm, protocol and task, and writes what they gave;
``python -m results.experiments.same_runs compare before.json after.json`` names the runs that
differ. Record both on one machine: the last bits depend on the processor.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from results.harness.runner import execute
from results.harness.specification import RunSpecification
from results.harness.suite import make_suite
from results.suites import find_recipe

SEED = 1000
#: by suite: the rollouts of a run, and the numbered contexts that are run
SUITE_RUNS = {
    "quick": (100, (0,)),
    "ablations": (60, (0,)),
    "push": (30, (9,)),
    "push-ablations": (24, (2,)),
    "aperture": (200, (0,)),
    "pouring": (18, (0,)),
    "pick-and-place": (30, (1,)),
}
#: of the suites of ablations, only these
LABELS = {
    "ablations": ("no PD controller", "standardised rewards", "last generation only"),
    "push-ablations": ("context through latents", "policy gradient, pairs", "RL only"),
}


def specifications() -> Iterator[RunSpecification]:
    """Yield the runs."""
    for suite, (budget, numbers) in SUITE_RUNS.items():
        recipe = find_recipe(suite)
        protocols = [recipe.protocols[number % len(recipe.protocols)] for number in numbers]
        runs = make_suite(suite, recipe, [SEED], budget, LABELS.get(suite)).specifications
        yield from (run for run in runs if run.protocol in protocols)
    for run in make_suite("quick", find_recipe("quick"), [SEED + 1], 60).specifications:
        yield replace(run, task_settings={"random_bottles": True})


def outcome(run: RunSpecification) -> dict[str, Any]:
    """Do a run and return its curve, the policy's trajectories, and whatever else was measured.

    :param run: what to run
    """
    measured = execute(run).measured
    found: dict[str, Any] = {"curve": measured.curve, **measured.more}
    if measured.context is not None:
        greedy = measured.rollouts["greedy"]
        found["greedy"] = {
            "context": list(measured.context.values),
            "trajectory": greedy.trajectory,
            "executed": greedy.executed,
        }
    if "untrained" in measured.rollouts:
        found["untrained"] = {"trajectory": measured.rollouts["untrained"].trajectory}
    return found


def record(path: Path) -> None:
    """Do the runs and write what they gave.

    :param path: of the JSON file
    """
    runs = list(specifications())
    names = [f"{number:02d} {run.name}" for number, run in enumerate(runs)]
    found = Parallel(n_jobs=-1, verbose=5)(delayed(outcome)(run) for run in runs)
    path.write_text(json.dumps(dict(zip(names, found, strict=True))), encoding="utf-8")
    print(f"{len(runs)} runs: {path}")


def differences(before: Path, after: Path) -> list[str]:
    """Return the names of the runs that differ, and of those that only one file holds.

    :param before: of `record`
    :param after: of `record`
    """
    one, other = (json.loads(path.read_text(encoding="utf-8")) for path in (before, after))
    return sorted(name for name in {*one, *other} if one.get(name) != other.get(name))


def main() -> int:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("record").add_argument("file", type=Path)
    comparison = commands.add_parser("compare")
    comparison.add_argument("before", type=Path)
    comparison.add_argument("after", type=Path)
    options = parser.parse_args()
    if options.command == "record":
        record(options.file)
        return 0
    unlike = differences(options.before, options.after)
    print("\n".join(unlike) if unlike else "All runs are equal, bit for bit.")
    return 1 if unlike else 0


if __name__ == "__main__":
    sys.exit(main())
