"""Where a latent space of two dimensions has what ACNMP found (thesis 5.2.1, Fig. 5.5), 5 seeds."""

from dataclasses import replace

from results.adaptation.assimilation import Assimilation
from results.algorithms import ACNMP
from results.harness.suite import Recipe
from results.suites.obstacles import OURS, PUBLISHED, TASKS
from sb3_nmp import CNMPArchitecture

TWO = replace(CNMPArchitecture.preset("latent"), representation_dim=2, n_members=1)
#: as in the thesis: what is linear does not extrapolate by itself
PLAIN = replace(TWO, linear_trend=False, n_frequencies=0)
ALGORITHMS = {
    "ACNMP, 2 latents": replace(ACNMP, settings=OURS | {"policy_kwargs": {"cnmp": TWO}}),
    "ACNMP, 2 latents, no linear trend": replace(
        ACNMP,
        settings=OURS | {"policy_kwargs": {"cnmp": PLAIN}},
        description="time as it is, as in the thesis",
    ),
}
#: the thesis's via-point beyond the demonstrations, and the demonstration of height 0.4 left out
PROTOCOLS = (Assimilation(1, between=False), Assimilation(4, between=True))
RECIPE = Recipe(ALGORITHMS, TASKS, PUBLISHED, 5, PROTOCOLS, (0, 10, PUBLISHED), PUBLISHED)
