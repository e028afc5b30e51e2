"""Bottles at random, shown both ways through, not told which is which; RC-NMP, twins; 5 seeds."""

from dataclasses import replace

from results.algorithms import RCNMP
from results.harness.suite import Recipe
from results.stream.protocol import Stream
from results.suites.random_bottles import TASKS, twin
from sb3_nmp.rcnmp.skill import RCNMPSkill

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
}
RECIPE = Recipe(ALGORITHMS, TASKS, 500, 5, (Stream(20, 10_000, 1000, modes="mixed"),))
