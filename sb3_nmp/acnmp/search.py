"""The search in one context: which trajectories to try next."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.acnmp.critic import RewardCritic
from sb3_nmp.common.algorithm import Generation

FloatArray = NDArray[np.float64]

N_CANDIDATES = 1500  # drawn around the best rollout for each trajectory to try
CANDIDATE_SCALES = (0.3, 0.6, 1.0, 1.5)  # of their distances, in units of the search's radius
N_REFINED = 20  # candidates that are refined
REFINEMENTS = 25  # draws around each of them
REFINEMENT_SCALE = 0.25
N_MOMENTS = 9  # at which the critic may look at a trajectory alone


@dataclass
class LatentSearch:
    """Tries trajectories ``mean + x @ directions``, and remembers how they did.

    With a critic, the first generation is drawn from N(0, radius^2 I) around the greedy
    trajectory; later ones are the points that an optimistic draw from the critic prefers, around
    the best rollout so far, within a radius that grows with success and shrinks without. Of points
    that promise alike the one nearest to the greedy trajectory is tried: the demonstrations hold
    what a reward does not tell. Without a critic, every generation is drawn around the current
    mean, which `ACNMP` sets to the policy's answer after each update, as the thesis does.

    :param mean: shape (T, D)
    :param directions: shape (n, T, D)
    :param radius: of the first generation, in standard deviations
    :param use_critic: whether a critic proposes
    :param pull: towards the greedy trajectory, see `Exploration`
    :param limits: smallest and largest radius
    :param coordinates: of the rollouts so far, shape (N, n)
    :param rollouts: what is known of them, oldest generation first
    """

    mean: FloatArray
    directions: FloatArray
    radius: float = 0.7
    use_critic: bool = True
    pull: float = 0.3
    limits: tuple[float, float] = (0.02, 1.5)
    coordinates: FloatArray = field(init=False)
    rollouts: list[Generation] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Start without rollouts."""
        self.coordinates = np.empty((0, len(self.directions)))
        self._views = views(self.directions)
        self._projection = np.linalg.pinv(self.directions.reshape(len(self.directions), -1))

    @property
    def rewards(self) -> FloatArray:
        """Of the rollouts so far, shape (N,)."""
        return np.concatenate([np.empty(0), *(part.rewards for part in self.rollouts)])

    def ask(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return trajectories to try, shape (n, T, D).

        :param n: how many
        :param rng: the generator to draw from
        """
        if self.use_critic and len(self.coordinates) > 1:
            points = self._ask_critic(n, rng)
        else:
            points = self.radius * rng.standard_normal((n, len(self.directions)))
            if not self.use_critic or len(self.coordinates) == 0:
                points[0] = 0.0  # the greedy trajectory
        return self.mean + np.tensordot(points, self.directions, axes=1)

    def _ask_critic(self, n: int, rng: np.random.Generator) -> FloatArray:
        centre = self.coordinates[self.rewards.argmax()]
        critic = RewardCritic.fit(
            self.coordinates, Generation.concatenate(self.rollouts), self._views
        )

        def worth(drawn: FloatArray) -> FloatArray:
            distance = np.mean(drawn**2, axis=1)
            return critic.optimistic(drawn, rng) - self.pull * critic.to_gain * distance

        points: list[FloatArray] = []
        for _ in range(n):
            scales = self.radius * rng.choice(CANDIDATE_SCALES, (N_CANDIDATES, 1))
            drawn = centre + scales * rng.standard_normal((N_CANDIDATES, len(centre)))
            for _ in range(2):
                best = drawn[np.argsort(-worth(drawn))[:N_REFINED]]
                around = np.repeat(best, REFINEMENTS, axis=0)
                step = REFINEMENT_SCALE * self.radius * rng.standard_normal(around.shape)
                drawn = np.concatenate([best, around + step])
            points.append(drawn[worth(drawn).argmax()])
            critic = critic.believing(points[-1][None])
        return np.stack(points)

    def tell(self, rollouts: Generation) -> None:
        """Take in rollouts of this context.

        :param rollouts: their coordinates are read from their trajectories, by least squares
        """
        before = self.rewards
        deviations = (rollouts.trajectories - self.mean).reshape(len(rollouts), -1)
        self.coordinates = np.concatenate([self.coordinates, deviations @ self._projection])
        self.rollouts.append(rollouts)
        if self.use_critic and len(before) > 1:
            better = rollouts.rewards.max() > before.max()
            self.radius = float(np.clip(self.radius * (1.25 if better else 0.75), *self.limits))


def views(directions: FloatArray) -> tuple[FloatArray, ...]:
    """Return what a critic may look at: all coordinates, or the deviation at one moment.

    :param directions: shape (n, T, D)
    :return: matrices of shape (n, n) and (n, D); see `Critic.fit`
    """
    times = np.linspace(0, directions.shape[1] - 1, N_MOMENTS).round().astype(int)
    moments = (directions[:, time] for time in times)
    scaled = (
        part / max(float(np.sqrt(np.mean(np.sum(part**2, axis=0)))), 1e-9) for part in moments
    )
    return (np.eye(len(directions)), *scaled)
