"""ACNMP without one of its elements, or with the thesis's choice instead, pushing, 5 seeds."""

from dataclasses import replace

from torch import nn

from results.algorithms import ACNMP, TWINS, hand_tuned, twins
from results.harness.specification import Algorithm
from results.harness.suite import Recipe
from results.suites.push import ALGORITHMS as PUSH_ALGORITHMS
from results.suites.push import CHECKPOINTS, EXPLORATION, PROTOCOLS, PUBLISHED, TASKS
from sb3_nmp import ACNMPAdaptation, ACNMPCritic, ACNMPExploration, CNMPArchitecture


def acnmp(**settings: object) -> Algorithm:
    """Return ACNMP with other settings than its defaults.

    :param settings: constructor arguments
    """
    return replace(ACNMP, settings=settings)


def driven(population_size: int = 3, **settings: object) -> Algorithm:
    """Return ACNMP whose network drives the search, as in the thesis.

    :param population_size: rollouts per generation
    :param settings: further constructor arguments
    """
    chosen = {"exploration": EXPLORATION, "population_size": population_size, **settings}
    return acnmp(search="policy", **chosen)


ALGORITHMS = {
    "ACNMP": PUSH_ALGORITHMS["ACNMP"],
    "one network": acnmp(policy_kwargs={"cnmp": CNMPArchitecture(n_members=1)}),
    "no policy gradient": acnmp(adaptation=ACNMPAdaptation(n_training_steps=0)),
    "latents too": acnmp(exploration=ACNMPExploration(latent=0.5)),
    "latents only": acnmp(exploration=ACNMPExploration(latent=0.5, noise=0.0, n_latents=6)),
    "contexts too": acnmp(exploration=ACNMPExploration(context=0.5)),
    "noise not shaped": acnmp(exploration=ACNMPExploration(shaped=0.0)),
    "noise all shaped": acnmp(exploration=ACNMPExploration(shaped=0.99)),
    **hand_tuned(population_size=3, n_bases=4, shaped=0.99),
    "no pull": acnmp(critic=ACNMPCritic(pull=0.0)),
    **twins(*TWINS),
    "no linear trend": acnmp(policy_kwargs={"cnmp": CNMPArchitecture(linear_trend=False)}),
    "ReLU layers": acnmp(policy_kwargs={"cnmp": CNMPArchitecture(activation_fn=nn.ReLU)}),
    "trend not fitted": acnmp(policy_kwargs={"cnmp": CNMPArchitecture(fitted_trend=False)}),
    "context through latents": acnmp(policy_kwargs={"cnmp": CNMPArchitecture.preset("latent")}),
    "ACNMP, network drives": PUSH_ALGORITHMS["ACNMP, network drives"],
    "policy gradient, to go": driven(adaptation=ACNMPAdaptation.preset("to_go")),
    "policy gradient, steps": driven(adaptation=ACNMPAdaptation.preset("step")),
    "policy gradient, pairs": driven(2, adaptation=ACNMPAdaptation.preset("step")),
    "RL only": driven(
        adaptation=replace(ACNMPAdaptation.preset("to_go"), supervised=False),
        exploration=replace(EXPLORATION, shaped=0.0),
    ),
}
BEYOND = tuple(protocol for protocol in PROTOCOLS if protocol.extrapolation)
RECIPE = Recipe(ALGORITHMS, TASKS, 200, 5, BEYOND, CHECKPOINTS, PUBLISHED)
