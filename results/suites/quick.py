"""RC-NMP and the methods without demonstrations on the bottles task, 5 seeds."""

from results.algorithms import DREPS, GA, JUDGED_GA, RCNMP, REPS
from results.harness.suite import Recipe
from results.one_context.protocol import OneContext

ALGORITHMS = {
    "RC-NMP": RCNMP,
    "GA": GA,
    "GA, judged": JUDGED_GA,
    "DREPS": DREPS,
    "REPS": REPS,
}
TASKS: dict[str, dict[str, object]] = {"nmp/Bottles-v0": {}}
RECIPE = Recipe(ALGORITHMS, TASKS, budget=400, n_seeds=5, protocols=(OneContext(),))
