"""RC-NMP without one of its elements, or with the original code's choice instead, 20 seeds."""

import math
from dataclasses import replace

from results.algorithms import GA, RCNMP
from results.harness.specification import Algorithm
from results.harness.suite import Recipe
from results.one_context.protocol import OneContext
from results.suites.quick import TASKS
from sb3_nmp import SmoothNoise


def rcnmp(**settings: object) -> Algorithm:
    """Return RC-NMP with other settings.

    :param settings: constructor arguments
    """
    return replace(RCNMP, settings=settings)


ALGORITHMS = {
    "RC-NMP": RCNMP,
    "no explorer": rcnmp(n_explorers=0),
    "no reward model": rcnmp(n_candidates=1),
    "no network (GA)": GA,
    "no crossover": rcnmp(n_crossover=0),
    "latent parents only": rcnmp(elite_parents=0.0),
    "no mutation": rcnmp(mutation=None),
    "dense mutation": rcnmp(mutation_rate=1.0),
    "rough mutation": rcnmp(mutation=SmoothNoise(n_bases=20)),
    "isotropic mutation": rcnmp(exploration_scale=0.15),
    "no PD controller": rcnmp(pd_controller=None),
    "no reward condition": rcnmp(reward_conditioning=False),
    "no KL term": rcnmp(beta=0.0),
    "latents from N(0, I)": rcnmp(latent_std=1.0),
    "standardised rewards": rcnmp(reward_scaling="standardize"),
    "greedy draws": rcnmp(temperature=1.0),
    "uniform draws": rcnmp(temperature=math.inf),
    "last generation only": rcnmp(buffer_size=20, n_elites=0),
    "time as it is": rcnmp(policy_kwargs={"n_frequencies": 0}),
}
RECIPE = Recipe(ALGORITHMS, TASKS, budget=400, n_seeds=20, protocols=(OneContext(),))
