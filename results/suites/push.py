"""Adaptation to each of ten held-out pushing targets (thesis 5.2.2, first experiment), 5 seeds."""

from dataclasses import replace

from benchmark_envs.tasks.push import EXTRAPOLATION_TARGETS, TARGETS
from results.adaptation.protocol import LeaveOneOut
from results.algorithms import (
    ACNMP,
    CMAES,
    EWERTON,
    NETWORK_DRIVES,
    RCNMP,
    REPS,
    STARK,
    SUM_ALONE,
    TWINS,
    hand_tuned,
    thesis_acnmp,
    twin,
    twins,
    without_network,
)
from results.harness.suite import Recipe
from results.tuning.contexts import tuning_contexts
from sb3_nmp import ACNMPExploration

#: of the network's own search: nearly all of the noise is like the demonstrations
EXPLORATION = ACNMPExploration.preset("push")
#: the PD controller would pull every trajectory to the demonstrations' mean end
FREE: dict[str, object] = {"pd_controller": None}
RCNMP_FREE = replace(RCNMP, settings=FREE, pretrained=False)
CMAES_CONTEXT = replace(CMAES, settings={"n_bases": 4, "context_std": 0.3, "shaped": 0.99})
ALGORITHMS = {
    "ACNMP": ACNMP,
    "ACNMP, network drives": replace(ACNMP, settings=NETWORK_DRIVES | {"exploration": EXPLORATION}),
    "ACNMP, sum alone": replace(ACNMP, settings=SUM_ALONE),
    **twins(*TWINS),
    "twin, nearest, sum alone": twin("nearest", **SUM_ALONE),
    **hand_tuned(population_size=3, n_bases=4, shaped=0.99),
    "ACNMP (thesis)": thesis_acnmp(),
    "CMA-ES residual": replace(
        CMAES,
        settings={"n_bases": 5},
        description="CMA-ES over smooth changes of the CNMP's answer",
    ),
    "CMA-ES context": CMAES_CONTEXT,
    "ProMP+RL (Stark)": replace(STARK, budget=400),
    "ProMP+RL (Ewerton)": replace(EWERTON, budget=400),
    "REPS": replace(REPS, budget=400),
    "RC-NMP": RCNMP_FREE,
    **without_network(**FREE),
}
TASKS: dict[str, dict[str, object]] = {"nmp/Push-v0": {}}
PROTOCOLS = tuple(LeaveOneOut(t, t in EXTRAPOLATION_TARGETS) for t in range(len(TARGETS)))
#: rollouts of Table 5.1; 130 is what the thesis tells of ACNMP
CHECKPOINTS, PUBLISHED = (0, 40, 80, 200), 130
TUNING = tuning_contexts("nmp/Push-v0")
RECIPE = Recipe(ALGORITHMS, TASKS, 200, 5, PROTOCOLS, CHECKPOINTS, PUBLISHED, tuning=TUNING)
