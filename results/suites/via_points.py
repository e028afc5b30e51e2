"""RC-NMP, its ablations and others, through 1 to 6 via-points (thesis 6.2.2), 10 seeds."""

from dataclasses import replace

from results.algorithms import ACNMP, CMAES, DREPS, GA, RCNMP, REPS
from results.harness.specification import Algorithm
from results.harness.suite import Recipe
from results.one_context.protocol import OneContext
from sb3_nmp import ACNMPAdaptation, ACNMPCritic, ACNMPExploration, SmoothNoise

#: a curve through six points needs narrower bases than the paths of other tasks
#: (results/experiments/via_points.md)
N_BASES = 15
#: the only demonstration is a flat line: it has no latents, and no draw to its neighbourhood
EXPLORATION = ACNMPExploration(latent=0.0, n_bases=N_BASES)
SHOWN_A_LINE = "its one demonstration is the initial trajectory"


def rcnmp(**settings: object) -> Algorithm:
    """Return RC-NMP without a PD controller, as in the thesis: no curve has a given end.

    :param settings: further constructor arguments
    """
    return replace(RCNMP, settings={"pd_controller": None, **settings})


def acnmp(description: str, **settings: object) -> Algorithm:
    """Return ACNMP, shown the initial trajectory, which all others know too.

    :param description: what sets it apart
    :param settings: further constructor arguments
    """
    shown = {"exploration": EXPLORATION, "population_size": 10, **settings}
    text = f"{description}; {SHOWN_A_LINE}"
    return replace(ACNMP, settings=shown, description=text, shown_initial=True)


ALGORITHMS = {
    "RC-NMP": rcnmp(),
    "RC-NMP without crossover": rcnmp(n_crossover=0),
    "RC-NMP without mutation": rcnmp(mutation=None),
    "ACNMP": acnmp("Bayesian optimisation around the network", critic=ACNMPCritic(pull=0.0)),
    "ACNMP (thesis)": acnmp(
        "policy gradient", search="policy", adaptation=ACNMPAdaptation("to_go")
    ),
    "GA": replace(GA, settings={"pd_controller": None, "mutation": SmoothNoise(n_bases=20)}),
    "CMA-ES": replace(
        CMAES, settings={"n_bases": N_BASES}, description="CMA-ES over smooth deviations"
    ),
    "REPS": replace(REPS, settings={"pd_controller": None, "n_bases": N_BASES}),
    "DREPS": replace(DREPS, settings={"pd_controller": None, "n_bases": N_BASES}),
}
TASKS: dict[str, dict[str, object]] = {"nmp/ViaPoints-v0": {}}
VARIANTS: dict[str, dict[str, object]] = {
    f"{n} point{'s' if n > 1 else ''}": {"n_points": n} for n in range(1, 7)
}
RECIPE = Recipe(ALGORITHMS, TASKS, 300, 10, (OneContext(),), variants=VARIANTS)
