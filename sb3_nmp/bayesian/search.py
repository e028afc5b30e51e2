"""`CriticSearch`: Bayesian optimisation around a trajectory, in the directions of a `Subspace`.

Shape letters: N rollouts, n coordinates, T time points, D dimensions of the trajectory.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.bayesian.critic import Chosen, Critic, tells_misses
from sb3_nmp.bayesian.gaussian_process import Hypotheses
from sb3_nmp.bayesian.settings import ACNMPCritic
from sb3_nmp.common.context_search import ContextSearch
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.common.settings import saved_state

FloatArray = NDArray[np.float64]

#: what the critic's processes look at is chosen anew when there are so many times the rollouts
RECHOOSE = 1.1
#: a network learns from a search again when there are so many times the rollouts
TEACH = 1.15


@saved_state("subspace")
@dataclass(frozen=True)
class Subspace:
    """The trajectories ``origin + x @ directions``.

    >>> space = Subspace(np.zeros((2, 1)), np.array([[[1.0], [0.0]], [[0.0], [2.0]]]))
    >>> space.trajectories(np.array([[3.0, 4.0]])).tolist()
    [[[3.0], [8.0]]]
    >>> space.coordinates(np.array([[[3.0], [8.0]]])).round(6).tolist()
    [[3.0, 4.0]]

    :param origin: shape (T, D)
    :param directions: each of one standard deviation of the exploration, shape (n, T, D)
    """

    origin: FloatArray
    directions: FloatArray

    @property
    def size(self) -> int:
        """How many coordinates there are, n."""
        return len(self.directions)

    @cached_property
    def _projection(self) -> FloatArray:
        return np.asarray(np.linalg.pinv(self.directions.reshape(self.size, -1)), np.float64)

    def trajectories(self, points: FloatArray) -> FloatArray:
        """Return the trajectories of points, shape (N, T, D).

        :param points: shape (N, n)
        """
        return self.origin + np.tensordot(points, self.directions, axes=1)

    def coordinates(self, trajectories: NDArray[np.floating]) -> FloatArray:
        """Return the coordinates of trajectories by least squares, shape (N, n).

        :param trajectories: shape (N, T, D)
        """
        deviations = (trajectories - self.origin).reshape(len(trajectories), -1)
        return deviations @ self._projection


@saved_state("trust-region")
@dataclass
class TrustRegion:
    """How far from the best rollout is searched: farther after success, nearer without.

    Eriksson, Pearce, Gardner, Turner and Poloczek, "Scalable global optimization via local Bayesian
    optimization" (TuRBO), 2019. TuRBO waits for several successes or failures; here a generation is
    a few rollouts, and each one counts.

    :param radius: in standard deviations of the exploration
    :param growth: factor after a success
    :param shrinkage: factor without one
    :param limits: of the radius
    """

    radius: float
    growth: float
    shrinkage: float
    limits: tuple[float, float]

    def update(self, improved: bool) -> None:
        """Grow or shrink.

        :param improved: whether the last generation has a new best rollout
        """
        factor = self.growth if improved else self.shrinkage
        self.radius = float(np.clip(self.radius * factor, *self.limits))


@saved_state("critic-search")
@dataclass
class CriticSearch:
    """Bayesian optimisation around a trajectory, the policy's answer when it begins.

    The first trajectory is that answer; the rest of the first generation is drawn around it. Later
    ones are the points of largest random upper confidence bound (`Critic.draw_upper_bounds`) inside
    a trust region around the best rollout so far, chosen one after the other by the Kriging
    believer. The bound is less a penalty on the distance from where the search started
    (`ACNMPCritic.pull`): the demonstrations hold what a reward does not tell. Where rollouts tell
    what they achieved, the critic aims (`Critic`) until one succeeds; where the trust region had to
    begin anew twice, every other one goes by the reward; where it may never begin anew, one that
    can shrink no more does.

    :param space: with the policy's answer as origin
    :param radius: of the first generation, in standard deviations of the exploration
    :param settings: of the critic
    :param unit: of each entry of the context, shape (C,), in which it is told what was achieved
    :param elsewhere: trajectories of shape (T, D) that the search starts from when its region has
        shrunk without a success, one each time: a new search, which forgets the one before. When
        there are none left, the region begins anew where it is
    :param points: coordinates of the rollouts since the search started where it is, shape (N, n)
    :param rollouts: all of them, oldest generation first
    :param has_improved: whether the last generation has a new best rollout
    :param has_succeeded: whether any rollout has; until then a region that has shrunk begins anew,
        for a rollout can be the best around and yet touch what it must not
    :param n_restarts: how often the region began anew
    :param n_forgotten: how many rollouts were made before the search started where it is
    :param aims: whether the critic of the last generation aimed
    :param has_aimed: whether what rollouts achieved has changed anything
    :param n_taught: how many rollouts there were when a network last learned from them
    """

    space: Subspace
    radius: float
    settings: ACNMPCritic = field(default_factory=ACNMPCritic)
    unit: FloatArray | None = None
    elsewhere: list[FloatArray] = field(default_factory=list)
    points: FloatArray = field(init=False)
    rollouts: list[Generation] = field(default_factory=list)
    has_improved: bool = False
    has_succeeded: bool = False
    n_restarts: int = 0
    n_forgotten: int = 0
    aims: bool = False
    has_aimed: bool = False
    n_taught: int = 0

    def __post_init__(self) -> None:
        """Start without rollouts."""
        self.points = np.empty((0, self.space.size))
        s = self.settings
        self.region = TrustRegion(self.radius, s.growth, s.shrinkage, s.radius_limits)
        self._hypotheses = Hypotheses(
            views(self.space.directions, self.settings.n_moments),
            self.settings.lengths,
            self.settings.noises,
        )
        self._chosen: Chosen = {}
        self._n_when_chosen = 0

    @property
    def rewards(self) -> FloatArray:
        """Of the rollouts since the search started where it is, shape (N,)."""
        earned = np.concatenate([np.empty(0), *(part.rewards for part in self.rollouts)])
        return earned[self.n_forgotten :]

    def _seen(self, rollouts: Generation) -> Generation:
        """Return rollouts without what the critic is not to see."""
        hidden: dict[str, Any] = {}
        if not self.settings.terms:
            hidden["terms"] = {}
        if not self.settings.achieved or self.has_succeeded or self._goes_by_reward:
            hidden["achieved"] = None
        return replace(rollouts, **hidden)

    @property
    def _goes_by_reward(self) -> bool:
        """Whether this region is one of those that do not aim: every other one from the third.

        Where none can begin anew, a region that can shrink no more goes by the reward.
        """
        smallest = self.settings.radius_limits[0]
        if self.settings.restart_radius <= smallest:
            return self.region.radius <= smallest
        return self.n_restarts >= 2 and self.n_restarts % 2 == 0

    def ask(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return trajectories to try, shape (n, T, D).

        :param n: how many
        :param rng: the generator to draw from
        """
        if len(self.points) > 1:
            return self.space.trajectories(self._ask_critic(n, rng))
        points = self.region.radius * rng.standard_normal((n, self.space.size))
        asked = self.space.trajectories(points)
        if len(self.points) == 0:
            asked[0] = self.space.origin
        return asked

    def _ask_critic(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return the coordinates of some proposals, one row each."""
        critic = self._fit_critic()
        points: list[FloatArray] = []
        for _ in range(n):
            points.append(self._maximise(critic, rng))
            critic = critic.condition_on_mean(points[-1])
        return np.stack(points)

    def _fit_critic(self) -> Critic:
        """Fit a critic to the best and the newest rollouts."""
        rollouts, n = self._seen(Generation.concatenate(self.rollouts)), len(self.points)
        rollouts = rollouts[self.n_forgotten :]
        aims = tells_misses(rollouts, self.unit)
        if n >= RECHOOSE * self._n_when_chosen or aims != self.aims:
            self._chosen, self._n_when_chosen = {}, n
        self.aims, self.has_aimed = aims, self.has_aimed or aims
        rows = np.arange(n)
        if not aims:
            rows = best_and_newest(rollouts.rewards, self.settings.n_remembered)
        known = self._hypotheses, self._chosen, self.unit
        critic = Critic.fit(self.points[rows], rollouts[rows], *known)
        self._chosen = critic.chosen
        return critic

    def _maximise(self, critic: Critic, rng: np.random.Generator) -> FloatArray:
        """Return the best of many candidates around the best rollout, shape (n,)."""
        s, radius = self.settings, self.region.radius
        centre = self.points[self.rewards.argmax()]

        def worth(drawn: FloatArray) -> FloatArray:
            distance = np.mean(drawn**2, axis=1)
            return critic.draw_upper_bounds(drawn, rng) - s.pull * critic.to_gain * distance

        scales = radius * rng.choice(s.candidate_scales, (s.n_candidates, 1))
        drawn = centre + scales * rng.standard_normal((s.n_candidates, len(centre)))
        for _ in range(s.n_rounds):
            best = drawn[np.argsort(-worth(drawn))[: s.n_refined]]
            around = np.repeat(best, s.n_refinements, axis=0)
            step = s.refinement_scale * radius * rng.standard_normal(around.shape)
            drawn = np.concatenate([best, around + step])
        return drawn[worth(drawn).argmax()]

    def tell(self, rollouts: Generation) -> None:
        """Take in rollouts of this context.

        :param rollouts: their coordinates are read from their trajectories
        """
        before = self.rewards
        self.points = np.concatenate([self.points, self.space.coordinates(rollouts.trajectories)])
        self.rollouts.append(rollouts)
        self.has_improved = bool(rollouts.rewards.max() > before.max(initial=-np.inf))
        if rollouts.successes.any() and not self.has_succeeded:
            self.has_succeeded, self.n_taught = True, 0
        if len(before) > 1:
            self.region.update(self.has_improved)
        smallest = min(self.settings.restart_radius, self.radius * self.settings.shrinkage)
        if not self.has_succeeded and self.region.radius < smallest:
            self._begin_anew()

    def _begin_anew(self) -> None:
        """Search farther again, from another trajectory if there is one."""
        self.region.radius = self.radius
        self.n_restarts += 1
        if self.elsewhere:
            self.space = replace(self.space, origin=self.elsewhere.pop(0))
            self.n_forgotten += len(self.points)
            self.points = np.empty((0, self.space.size))
            self._chosen, self._n_when_chosen = {}, 0

    @property
    def is_to_be_taught(self) -> bool:
        """Whether a network is to learn from the rollouts now: at the first success, then seldom.

        Else the time that it takes would grow with the square of the rollouts.
        """
        return self.n_forgotten + len(self.points) >= TEACH * self.n_taught

    def was_taught(self) -> None:
        """Take note that a network has learned from all rollouts so far."""
        self.n_taught = self.n_forgotten + len(self.points)


def any_has_aimed(searched: list[ContextSearch]) -> bool:
    """Return whether what rollouts achieved has changed any search.

    :param searched: with a critic or without
    """
    return any(getattr(each.search, "has_aimed", False) for each in searched)


def best_and_newest(rewards: FloatArray, n: int) -> NDArray[np.intp]:
    """Return the rows of the best rollouts and, for the other half, of the newest, in order.

    >>> best_and_newest(np.array([5.0, 1.0, 9.0, 2.0, 3.0, 0.0]), 4).tolist()
    [0, 2, 4, 5]

    :param rewards: oldest first, shape (N,)
    :param n: how many at most
    """
    rows = np.arange(len(rewards))
    if len(rows) <= n:
        return rows
    best = np.argsort(-rewards, kind="stable")[: n - n // 2]
    newest = np.setdiff1d(rows, best)[-(n // 2) :]
    return np.sort(np.concatenate([best, newest]))


def views(directions: FloatArray, n_moments: int) -> tuple[FloatArray, ...]:
    """Return what a critic may look at: all coordinates, or the deviation at one moment.

    :param directions: shape (n, T, D)
    :param n_moments: evenly spaced over time
    :return: matrices of shape (n, n) and (n, D); see `Hypotheses`
    """
    times = np.linspace(0, directions.shape[1] - 1, n_moments).round().astype(int)
    moments = (directions[:, time] for time in times)
    scaled = (
        part / max(float(np.sqrt(np.mean(np.sum(part**2, axis=0)))), 1e-9) for part in moments
    )
    return (np.eye(len(directions)), *scaled)
