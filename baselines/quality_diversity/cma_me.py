"""`CMAME`: covariance matrix adaptation MAP-Elites over a movement primitive's weights (pyribs)."""

import warnings
from typing import ClassVar, Unpack, cast

import numpy as np
from stable_baselines3.common.type_aliases import GymEnv

from baselines.primitive_search import PrimitiveSearch, StartPolicy
from baselines.primitive_search.algorithm import Controller
from baselines.quality_diversity.archive_search import ArchiveSearch, check_ribs
from sb3_nmp.bayesian.search import Subspace
from sb3_nmp.common.adaptive import AdaptiveArguments
from sb3_nmp.common.exceptions import ConfigurationError, ResumeWarning
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import Rules
from sb3_nmp.common.tuning import Choice, Range, SearchSpace


class CMAMEArguments(AdaptiveArguments, total=False):
    """Those of `PrimitiveSearch` but the population, whose default is another here."""

    max_generations: int
    n_bases: int
    shaped: float
    pd_controller: Controller


class CMAME(PrimitiveSearch):
    """CMA-ME: evolution strategies that fill an archive of different solutions.

    The archive's measures are a trajectory's mean deviations, in each dimension, over equal parts
    of the time: on which side of things it passes. ``policy.modes`` returns the best success of
    every cell, for a context that was pinned; ``predict`` the best of all. Needs the extra ``qd``.

    Fontaine, Togelius, Nikolaidis and Hoover, "Covariance matrix adaptation for the rapid
    illumination of behavior space", 2020; the implementation is pyribs'.

    >>> import benchmark_envs
    >>> CMAME("MlpPolicy", "nmp/Bottles-v0", seed=0).learn(20).num_timesteps
    20

    :param population_size: rollouts per generation in each context that is searched
    :param n_emitters: evolution strategies side by side, among which a generation is shared out
    :param n_cells: of the archive
    :param n_parts: of the time; there are so many measures for each dimension
    :param sigma: of the strategies at first, in standard deviations of the exploration
    """

    tunable: ClassVar[SearchSpace] = {
        "n_emitters": Choice((1, 2, 5)),
        "n_cells": Choice((10, 30, 100)),
        "sigma": Range(0.2, 0.8),
        "n_bases": Range(4, 15, integer=True),
    }

    def __init__(
        self,
        policy: str | type[StartPolicy],
        env: GymEnv | str,
        *,
        population_size: int = 20,
        n_emitters: int = 5,
        n_cells: int = 30,
        n_parts: int = 2,
        sigma: float = 0.3,
        **shared: Unpack[CMAMEArguments],
    ) -> None:
        self.n_emitters, self.n_cells, self.n_parts = n_emitters, n_cells, n_parts
        self.sigma = sigma
        super().__init__(policy, env, population_size=population_size, **shared)

    def _rules(self) -> Rules:
        return {
            "n_emitters": (
                1 <= self.n_emitters <= self.population_size // 3,
                f">= 1, and the population of {self.population_size} must give each at least 3 "
                "rollouts to rank",
            ),
            "n_cells": (self.n_cells >= 2, ">= 2"),
            "n_parts": (self.n_parts >= 1, ">= 1"),
            "sigma": (0 < self.sigma < float("inf"), "finite and > 0"),
            **super()._rules(),
        }

    def _setup_model(self) -> None:
        check_ribs(type(self).__name__)
        super()._setup_model()
        n_time_points = self.policy.trajectory_shape[0]
        if self.n_parts > n_time_points:
            raise ConfigurationError(
                f"n_parts is {self.n_parts}; trajectories have {n_time_points} time points, and no "
                "part may be empty. Usual values are 1 to 4."
            )

    def _begin_generation(self) -> None:
        if self.searches:
            search = cast(ArchiveSearch, self.searches[0].search)
            if search.population_size != self.population_size:
                warnings.warn(
                    f"the strategies share out {search.population_size} rollouts, and generations "
                    f"have {self.population_size} now: they begin anew, with an empty archive.",
                    ResumeWarning,
                    stacklevel=4,
                )
                self.searches = []
        before = self.searches
        super()._begin_generation()
        if self._pinned and self.searches is not before:
            self.policy.ways.forget()  # they are of another archive

    def _search_in(self, space: Subspace) -> ArchiveSearch:
        return ArchiveSearch(
            space,
            self.n_emitters,
            self.population_size,
            self.n_cells,
            self.n_parts,
            self.sigma,
        )

    def _end_generation(self, generation: Generation) -> None:
        super()._end_generation(generation)
        if self._pinned:
            self._remember_ways(generation)

    def _remember_ways(self, generation: Generation) -> None:
        """Remember the best success of each cell.

        :param generation: the newest rollouts
        """
        search = cast(ArchiveSearch, self.searches[0].search)
        rows = np.flatnonzero(generation.successes)
        cells = search.cells(search.points[-len(generation) :][rows])
        self.policy.ways.update(
            cells[:, None].astype(np.float64),
            generation.trajectories[rows],
            generation.rewards[rows],
        )
        self.logger.record("train/modes", len(self.policy.ways.rewards))
