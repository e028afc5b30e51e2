"""ACNMP with one of its elements exchanged on the stream of apertures, 5 seeds."""

from dataclasses import replace

from torch import nn

from results.algorithms import ACNMP
from results.harness.specification import Algorithm
from results.harness.suite import Recipe
from results.suites.aperture import RECIPE as APERTURE
from results.suites.aperture import SEARCH
from sb3_nmp import ACNMPExploration, CNMPArchitecture, CNMPPretraining


def acnmp(**settings: object) -> Algorithm:
    """Return ACNMP with other settings than the suite aperture.

    :param settings: constructor arguments
    """
    return replace(ACNMP, settings=SEARCH | settings)


def network(**settings: object) -> Algorithm:
    """Return ACNMP with another network.

    :param settings: of its architecture
    """
    return acnmp(policy_kwargs={"cnmp": replace(CNMPArchitecture(), **settings)})


ALGORITHMS = {
    "ACNMP": acnmp(),
    "no threshold": acnmp(reward_threshold=None, n_successes=5),
    "five successes": acnmp(n_successes=5),
    "20 contexts at once": acnmp(n_contexts=20, population_size=5),
    "longer pre-training": acnmp(pretraining=CNMPPretraining(n_steps=4000, batch_size=32)),
    "latents too": acnmp(exploration=ACNMPExploration(latent=0.5)),
    "one network": network(n_members=1),
    "context through latents": acnmp(policy_kwargs={"cnmp": CNMPArchitecture.preset("latent")}),
    "ReLU layers": network(activation_fn=nn.ReLU),
    "trend not fitted": network(fitted_trend=False),
    "no linear trend": network(linear_trend=False),
}
RECIPE: Recipe = replace(APERTURE, algorithms=ALGORITHMS)
