"""``nmp-bench tune``."""

import argparse
from pathlib import Path

STUDIES = Path("results/tuning/studies")


def add_tune(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``nmp-bench tune``.

    :param parser: of the command
    """
    parser.description = (
        "Tune every algorithm of a suite with the same number of trials and of runs for each, on "
        "seeds that no reported run has. A study is written as JSON; one that is there is kept, "
        "and one that was ended goes on after its last trial."
    )
    parser.set_defaults(command=tune)
    parser.add_argument("--suite", default="rivals", help="which (default: %(default)s)")
    parser.add_argument("--algorithms", nargs="+", metavar="LABEL", help="only these")
    parser.add_argument("--trials", type=int, default=10, metavar="N", help="default: %(default)s")
    parser.add_argument("--seeds", default="1000-1002", help="of tuning (default: %(default)s)")
    parser.add_argument("--budget", type=int, help="rollouts per run (default: the suite's)")
    parser.add_argument(
        "--measure",
        choices=("rollouts", "reward", "failures"),
        help="what a trial costs: rollouts to success (the default), the reward at the end, or "
        "the share of unseen contexts that fail (the default of streams of contexts)",
    )
    parser.add_argument(
        "--variants", nargs="+", metavar="NAME", help="these of the suite's (default: all)"
    )
    parser.add_argument("--out", type=Path, default=STUDIES, metavar="DIR", help="of the studies")
    parser.add_argument("--overwrite", action="store_true", help="begin studies anew")


def tune(options: argparse.Namespace) -> int:
    """Do ``nmp-bench tune``.

    :param options: the parsed arguments
    """
    from results.harness.suite import parse_seeds
    from results.suites import find_recipe
    from results.tuning.plan import TuningPlan
    from results.tuning.study import tune_suite

    recipe = find_recipe(options.suite)
    seeds = parse_seeds(options.seeds)
    plan = TuningPlan.of(
        options.suite,
        recipe,
        seeds,
        options.trials,
        options.budget,
        options.measure,
        options.variants,
    )
    for line in tune_suite(recipe, plan, options.out, options.algorithms, options.overwrite):
        print(line, flush=True)
    return 0
