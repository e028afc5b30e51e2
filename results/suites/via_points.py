"""RC-NMP, its ablations and others, through 1 to 6 via-points (thesis 6.2.2), 10 seeds."""

from dataclasses import replace

from results.algorithms import ACNMP, CMAES, DREPS, GA, JUDGED_GA, RCNMP, REPS, TURBO, twin
from results.harness.specification import Algorithm
from results.harness.suite import Recipe
from results.one_context.protocol import OneContext
from sb3_nmp import (
    ACNMPAdaptation,
    ACNMPCritic,
    ACNMPExploration,
    RCNMPRewardModel,
    RCNMPTraining,
    ShapedExploration,
    SmoothNoise,
)

#: bases of smooth deviations: a curve through six points bends more often than other tasks' paths;
#: each method's number was chosen among a few (results/experiments/via_points.md)
NARROW = 20
#: of ACNMP and its twin
N_BASES, SHAPED, UNPULLED = 15, 0.5, ACNMPCritic(pull=0.0)
EXPLORATION = ACNMPExploration(n_bases=N_BASES, shaped=SHAPED)
SHOWN_A_LINE = "its one demonstration is the initial trajectory"


#: of RC-NMP and GA: no PD controller, as in the thesis, for no curve has a given end
OF_ALL: dict[str, object] = {
    "pd_controller": None,
    "mutation": SmoothNoise(n_bases=NARROW),
    "mutation_rate": 0.3,
}
OF_RCNMP = OF_ALL | {
    "population_size": 10,
    "n_crossover": 8,
    "n_explorers": 0,
    "elite_parents": 0.9,
    "mutation_decay": 0.9,
    "training": RCNMPTraining(n_steps=30),
    "reward_model": RCNMPRewardModel(n_steps=60),
}
OF_GA = OF_ALL | {"population_size": 5, "n_crossover": 4, "mutation_decay": 0.96}


def acnmp(description: str, **settings: object) -> Algorithm:
    """Return ACNMP, shown the initial trajectory, which all others know too.

    :param description: what sets it apart
    :param settings: further constructor arguments
    """
    shown = {"exploration": EXPLORATION, "population_size": 10, **settings}
    text = f"{description}; {SHOWN_A_LINE}"
    return replace(ACNMP, settings=shown, description=text, shown_initial=True)


#: With ``mutation=None`` all rollouts would be the initial trajectory: the first generation, which
#: has nothing to learn from yet, keeps its noise; no later one has any.
FIRST_NOISE_ONLY = OF_RCNMP | {"mutation_decay": 1e-9}
ALGORITHMS = {
    "RC-NMP": replace(RCNMP, settings=OF_RCNMP),
    "RC-NMP without crossover": replace(RCNMP, settings=OF_RCNMP | {"n_crossover": 0}),
    "RC-NMP without mutation": replace(RCNMP, settings=FIRST_NOISE_ONLY),
    "ACNMP": acnmp("Bayesian optimisation around the network", critic=UNPULLED),
    # no supervised learning between its steps: it would pull the answer back to the flat line; and
    # fewer and smaller steps than the preset has, for others leave the data (via_points.md)
    "ACNMP, policy gradient": acnmp(
        "policy gradient, Eq. 5.2",
        search="policy",
        learning_rate=2e-4,
        adaptation=replace(ACNMPAdaptation.preset("to_go"), supervised=False, n_training_steps=10),
    ),
    "ACNMP's twin, nearest": replace(
        twin(
            "nearest",
            exploration=ShapedExploration(n_bases=N_BASES, shaped=SHAPED),
            population_size=10,
            critic=UNPULLED,
        ),
        description=f"ACNMP's search around the nearest demonstration; {SHOWN_A_LINE}",
        shown_initial=True,
    ),
    "GA": replace(GA, settings=OF_GA),
    "GA, judged": replace(JUDGED_GA, settings=OF_GA | dict(JUDGED_GA.settings)),
    "CMA-ES": replace(CMAES, settings={"n_bases": 15}, description="CMA-ES over smooth deviations"),
    "REPS": replace(REPS, settings={"pd_controller": None, "n_bases": NARROW}),
    "DREPS": replace(DREPS, settings={"pd_controller": None, "n_bases": NARROW}),
    "TuRBO": replace(TURBO, settings={"pd_controller": None, "n_bases": 15}),
}
TASKS: dict[str, dict[str, object]] = {"nmp/ViaPoints-v0": {}}
VARIANTS: dict[str, dict[str, object]] = {
    f"{n} point{'s' if n > 1 else ''}": {"n_points": n} for n in range(1, 7)
}
RECIPE = Recipe(ALGORITHMS, TASKS, 300, 10, (OneContext(),), variants=VARIANTS)
