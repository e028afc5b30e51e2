"""The settings of a search: where it explores, and how a critic chooses its rollouts."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from sb3_nmp.common.settings import Rules, Settings, limits, settings_name
from sb3_nmp.common.tuning import Choice, Range, SearchSpace

#: what is tuned of an algorithm that searches with `ShapedExploration`
SEARCH_SPACE: SearchSpace = {
    "population_size": Choice((1, 2, 3, 5)),
    "exploration.n_bases": Range(4, 12, integer=True),
    "exploration.shaped": Choice((0.3, 0.5, 0.8, 0.94, 0.99)),
    "exploration.radius": Range(0.3, 1.2, log=True),
}


@settings_name("shaped-exploration")
@dataclass(frozen=True)
class ShapedExploration(Settings):
    """Smooth noise that is shaped like the demonstrations, in units of ``exploration_scale``.

    The defaults are one setting for all tasks. The preset ``"push"`` is for demonstrations that
    span all that is to be found.

    >>> from sb3_nmp import ShapedExploration
    >>> ShapedExploration.preset("push").shaped
    0.99

    :param noise: of smooth noise: the root mean square over time
    :param n_bases: of the noise, per dimension
    :param shaped: share of the noise's variance that varies over time and couples the dimensions
        as the demonstrations do; the rest is alike everywhere. So less is explored where all
        demonstrations agree, such as at a common start. Near 1 is best where the demonstrations
        span what is to be found, less where they all lack it
    :param radius: of the first generation, in standard deviations of the exploration
    :param foretold: among drawn contexts, explore no farther than the demonstrations foretell each
        other wrongly (`nearer_scale`), where ``exploration_scale`` is the environment's own
    :raises ConfigurationError: a value outside its range
    """

    noise: float = 1.0
    n_bases: int = 8
    shaped: float = 0.8
    radius: float = 0.7
    foretold: bool = True

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"push": {"n_bases": 4, "shaped": 0.99}}

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {
            "noise": (self.noise >= 0, ">= 0"),
            "n_bases": (self.n_bases >= 2, ">= 2"),
            "shaped": (0 <= self.shaped <= 1, "in [0, 1]"),
            "radius": (self.radius > 0, "> 0"),
        }


@settings_name("acnmp-critic")
@dataclass(frozen=True)
class ACNMPCritic(Settings):
    """How the critic of ACNMP and of its twins chooses the rollouts of a search.

    The penalty, the moments and the noises were chosen by measurement on tuning contexts
    (``results/experiments/acnmp.md``), the other values by hand on the same contexts.

    >>> from sb3_nmp import ACNMPCritic
    >>> ACNMPCritic(pull=0.0).radius_limits
    (0.02, 1.5)

    :param pull: penalty on the distance from where the search started; 0 switches it off. At one
        typical draw's distance it is this share of the cost of the best rollout
    :param radius_limits: smallest and largest radius of the trust region, in standard deviations of
        the exploration. It begins at the exploration's radius
    :param growth: factor on the radius after a generation with a new best rollout
    :param shrinkage: factor on the radius after any other generation
    :param restart_radius: where nothing has succeeded yet, a smaller radius begins anew at the
        exploration's, as TuRBO restarts; a search that began with less than this may shrink once.
        0, or what is not above the smallest radius, never does:
        a search that aims then leaves that where its radius can shrink no more
    :param lengths: length scales of the Gaussian process to choose from by evidence, in units of
        the typical distance of two draws from the exploration. Over the longest it is as good as
        quadratic
    :param noises: variances of the noise to choose from by evidence, as shares of the kernel's:
        nearly equal trajectories can fare differently, as where grains fall by chance
    :param n_moments: moments of the trajectory at which a Gaussian process may look alone
    :param terms: predict the reward's terms (``info["reward_<term>"]``) one by one where they are
        costs that add up to it; False: the critic sees their sum alone
    :param achieved: predict, where the terms are no such costs, which context a rollout achieves
        (``info["achieved_context"]``), where the environment tells it: the search then aims at the
        context it is in until a rollout succeeds, and goes by the reward from there on. False: it
        goes by the reward from the beginning
    :param n_remembered: rollouts to which it is fitted at most: half of them the best, the others
        the newest
    :param n_candidates: drawn around the best rollout for each trajectory to try
    :param candidate_scales: of their distances, in units of the radius
    :param n_refined: best candidates that are refined
    :param n_refinements: draws around each of them
    :param refinement_scale: of these draws, in units of the radius
    :param n_rounds: of refinement
    :raises ConfigurationError: a value outside its range
    """

    pull: float = 0.3
    radius_limits: tuple[float, float] = (0.02, 1.5)
    growth: float = 1.25
    shrinkage: float = 0.75
    restart_radius: float = 0.2
    lengths: tuple[float, ...] = (0.4, 0.6, 0.9, 1.3, 2.0, 3.0, 5.0, 8.0)
    noises: tuple[float, ...] = (1e-4, 1e-2, 1e-1)
    n_moments: int = 9
    terms: bool = True
    achieved: bool = True
    n_remembered: int = 150
    n_candidates: int = 1500
    candidate_scales: tuple[float, ...] = (0.3, 0.6, 1.0, 1.5)
    n_refined: int = 20
    n_refinements: int = 25
    refinement_scale: float = 0.25
    n_rounds: int = 2

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {
            "pull": (0 <= self.pull < math.inf, ">= 0 and finite"),
            "radius_limits": limits(*self.radius_limits),
            "growth": (self.growth >= 1, ">= 1"),
            "shrinkage": (0 < self.shrinkage <= 1, "in (0, 1]"),
            "restart_radius": (self.restart_radius >= 0, ">= 0"),
            "lengths": (min(self.lengths, default=0) > 0, "at least one value, all > 0"),
            "noises": (min(self.noises, default=0) > 0, "at least one value, all > 0"),
            "n_moments": (self.n_moments >= 1, ">= 1"),
            "n_remembered": (self.n_remembered >= 2, ">= 2"),
            "n_refined": (self.n_refined >= 1, ">= 1"),
            "n_candidates": (
                self.n_candidates >= self.n_refined,
                f">= n_refined, which is {self.n_refined}",
            ),
            "candidate_scales": (
                min(self.candidate_scales, default=0) > 0,
                "at least one value, all > 0",
            ),
            "n_refinements": (self.n_refinements >= 1, ">= 1"),
            "refinement_scale": (self.refinement_scale > 0, "> 0"),
            "n_rounds": (self.n_rounds >= 0, ">= 0; 0 refines nothing"),
        }
