"""ACNMP without one of its elements, or with the thesis's choice instead, pushing, 5 seeds."""

from dataclasses import replace

from results.algorithms import ACNMP, TWINS, twins
from results.harness.specification import Algorithm
from results.harness.suite import Recipe
from results.suites.push import ALGORITHMS as PUSH_ALGORITHMS
from results.suites.push import CHECKPOINTS, EXPLORATION, PROTOCOLS, PUBLISHED, TASKS
from sb3_nmp import ACNMPAdaptation, ACNMPCritic, CNMPArchitecture, ShapedExploration


def acnmp(**settings: object) -> Algorithm:
    """Return ACNMP with other settings than the suite push.

    :param settings: constructor arguments
    """
    return replace(ACNMP, settings={"exploration": EXPLORATION, **settings})


# In the last five the network drives the search, as in the thesis.
ALGORITHMS = {
    "ACNMP": PUSH_ALGORITHMS["ACNMP"],
    "one network": acnmp(policy_kwargs={"cnmp": CNMPArchitecture(n_members=1)}),
    "no policy gradient": acnmp(adaptation=ACNMPAdaptation(n_training_steps=0)),
    "latents too": acnmp(exploration=replace(EXPLORATION, latent=0.5)),
    "latents only": acnmp(exploration=replace(EXPLORATION, latent=0.5, noise=0.0, n_latents=6)),
    "contexts too": acnmp(exploration=replace(EXPLORATION, context=0.5)),
    "noise not shaped": acnmp(exploration=replace(EXPLORATION, shaped=0.0)),
    "noise half shaped": acnmp(exploration=replace(EXPLORATION, shaped=0.5)),
    "no pull": acnmp(critic=ACNMPCritic(pull=0.0)),
    **twins(*TWINS, exploration=ShapedExploration.preset("push")),
    "thesis's decoder": acnmp(
        policy_kwargs={"cnmp": CNMPArchitecture(context_in_decoder=True, linear_trend=False)}
    ),
    "ACNMP, network drives": PUSH_ALGORITHMS["ACNMP, network drives"],
    "policy gradient, to go": acnmp(search="policy", adaptation=ACNMPAdaptation.preset("to_go")),
    "policy gradient, steps": acnmp(search="policy", adaptation=ACNMPAdaptation.preset("step")),
    "policy gradient, pairs": acnmp(
        search="policy", adaptation=ACNMPAdaptation.preset("step"), population_size=2
    ),
    "RL only": acnmp(
        search="policy",
        adaptation=replace(ACNMPAdaptation.preset("to_go"), supervised=False),
        exploration=replace(EXPLORATION, shaped=0.0),
    ),
}
BEYOND = tuple(protocol for protocol in PROTOCOLS if protocol.extrapolation)
RECIPE = Recipe(ALGORITHMS, TASKS, 200, 5, BEYOND, CHECKPOINTS, PUBLISHED)
