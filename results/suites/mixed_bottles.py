"""Bottles at random, shown both ways through, not told which is which; twins; 5 seeds."""

from dataclasses import replace

from results.algorithms import ACNMP, RCNMP, TWINS, twins
from results.harness.suite import Recipe
from results.stream.protocol import Stream
from results.suites.random_bottles import TASKS, twin
from sb3_nmp import ACNMPAdaptation, CNMPArchitecture
from sb3_nmp.rcnmp.settings import RCNMPSkill

#: contexts that ACNMP and its twins try at once
TOGETHER: dict[str, object] = {"n_contexts": 20}
ALGORITHMS = {
    "RC-NMP, two modes": replace(
        RCNMP,
        settings={"policy_kwargs": {"skill": RCNMPSkill(n_modes=2)}},
        description="a categorical latent tells two ways apart",
    ),
    "RC-NMP, one mode": replace(RCNMP, description="all that was right is taken for one way"),
    "twin, Gaussian process": twin("gaussian-process"),
    "twin, nearest": twin("nearest"),
    "twin, ridge": twin("ridge"),
    "ACNMP, two modes": replace(
        ACNMP,
        settings=TOGETHER
        | {
            "policy_kwargs": {"cnmp": CNMPArchitecture(n_modes=2)},
            "adaptation": ACNMPAdaptation(keep_answers=True),
        },
        description="a categorical latent tells two ways apart",
    ),
    "ACNMP, one mode": replace(ACNMP, settings=TOGETHER),
    **{f"ACNMP's {label}": each for label, each in twins(*TWINS, **TOGETHER).items()},
}
RECIPE = Recipe(ALGORITHMS, TASKS, 500, 5, (Stream(20, 10_000, 1000, modes="mixed"),))
