"""ACNMP without one of its elements on the stream of apertures, 5 seeds."""

from dataclasses import replace

from results.algorithms import ACNMP
from results.harness.specification import Algorithm
from results.harness.suite import Recipe
from results.suites.aperture import ALGORITHMS as APERTURE_ALGORITHMS
from results.suites.aperture import RECIPE as APERTURE
from results.suites.aperture import STREAM
from sb3_nmp import ACNMPExploration, CNMPArchitecture


def acnmp(**settings: object) -> Algorithm:
    """Return ACNMP with other settings than the suite aperture.

    :param settings: constructor arguments
    """
    return replace(ACNMP, settings=STREAM | settings)


ALGORITHMS = {
    "ACNMP": APERTURE_ALGORITHMS["ACNMP"],
    "no threshold": acnmp(reward_threshold=None),
    "one threshold": acnmp(reward_threshold=-0.1),
    "one network": acnmp(
        policy_kwargs={"cnmp": replace(CNMPArchitecture.preset("stream"), n_members=1)}
    ),
    "latents too": acnmp(exploration=replace(ACNMPExploration.preset("stream"), latent=0.5)),
    "context through latents": acnmp(policy_kwargs={}),
    "no linear trend": acnmp(
        policy_kwargs={"cnmp": CNMPArchitecture(context_in_decoder=True, linear_trend=False)}
    ),
}
RECIPE: Recipe = replace(APERTURE, algorithms=ALGORITHMS)
