"""`cost_of`: the runs of one trial."""

import sys
from itertools import product

import numpy as np

from results.harness.memory import return_memory
from results.harness.runner import execute
from results.harness.specification import Algorithm, RunSpecification
from results.tuning.plan import TuningPlan


def cost_of(label: str, algorithm: Algorithm, plan: TuningPlan) -> float | None:
    """Return what settings cost on the tuning seeds; None where a run fails, which is told.

    :param label: of the algorithm
    :param algorithm: with the settings
    :param plan: what is equal for all
    """
    costs = []
    for protocol in plan.protocols:
        for settings, seed in product(plan.variants.values(), plan.seeds):
            where = {**plan.task_settings, **settings}
            run = RunSpecification(label, algorithm, plan.task, seed, plan.budget, protocol, where)
            try:
                curve = execute(run).measured.curve
            except Exception as error:  # whatever an algorithm raises is this setting's result
                why = f"{type(error).__name__}: {' '.join(str(error).split())}"
                print(f"nmp-bench: a trial of {label} failed, {why}", file=sys.stderr)
                return None
            finally:
                return_memory()
            costs.append(plan.cost(curve))
    mean = float(np.mean(costs))
    return mean if np.isfinite(mean) else None
