"""Search over varying contexts: explore around the answer in ever new ones, and learn from all.

A rollout is right in its own context if it succeeded there, and in the context that it achieved
wherever the environment tells one (`RolloutInfo.achieved_context`). No context is searched for
itself: each rollout tries the present answer to a new context, with noise, and the answer is
learned from what was right anywhere. Shape letters: N rollouts, C context, T x D trajectory, P
weights of a skill.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch as th
from numpy.typing import NDArray

from sb3_nmp.common.settings import (
    Rules,
    Settings,
    limits,
    saved_state,
    settings_name,
    whole,
)
from sb3_nmp.common.tuning import Choice, Range, SearchSpace

FloatArray = NDArray[np.float64]
#: what is tuned of an algorithm that explores in ever new contexts
TUNABLE_OVER_CONTEXTS: SearchSpace = {
    "population_size": Choice((20, 30, 40)),
    "contextual.largest": Range(2.0, 10.0, log=True),
    "contextual.after_success": Range(0.2, 0.8, log=True),
    "contextual.wanted_rate": Range(0.15, 0.6),
}
WIDEST = 1e4  # scale of exploration: beyond, all is clipped anyway


@dataclass(frozen=True)
class Experience:
    """What was demonstrated, then all rollouts so far, as a skill learns from them.

    :param contexts: shape (N, C)
    :param weights: of the trajectories, shape (N, P)
    :param rewards: NaN for a demonstration, which was not executed, shape (N,)
    :param successes: True for a demonstration, shape (N,)
    :param achieved: contexts in which rollouts would have been right, NaN where in none, shape
        (N, C); None where the environment tells none
    :param example: the row of the first success that counts; others before ``since`` do not
    :param since: the row from which on every success counts
    """

    contexts: FloatArray
    weights: FloatArray
    rewards: FloatArray
    successes: NDArray[np.bool_]
    achieved: FloatArray | None
    example: int | None = None
    since: int = 0

    @property
    def right(self) -> NDArray[np.intp]:
        """The rows that succeeded, those of the first ones that would mix ways to do it left out.

        Successes by chance, before there is any answer, may go different ways round; their mean
        would go none. So the best of the first ones is the example for all that follow.
        """
        counts = self.successes & (np.arange(len(self.successes)) >= self.since)
        if self.example is not None:
            counts[self.example] = True
        return np.flatnonzero(counts)

    @property
    def rated(self) -> NDArray[np.intp]:
        """The rows that have a reward: all but the demonstrations."""
        return np.flatnonzero(~np.isnan(self.rewards))

    def after(self, contexts: FloatArray, weights: FloatArray) -> "Experience":
        """Return this experience with demonstrations before it, right in their own contexts.

        After a demonstration no success is a first one, so all of them count.

        :param contexts: of the demonstrations, shape (M, C)
        :param weights: of the same, shape (M, P)
        """
        n = len(contexts)
        return Experience(
            np.concatenate([contexts, self.contexts]),
            np.concatenate([weights, self.weights]),
            np.concatenate([np.full(n, np.nan), self.rewards]),
            np.concatenate([np.ones(n, bool), self.successes]),
            None if self.achieved is None else np.concatenate([contexts, self.achieved]),
        )


class Space(Protocol):
    """Trajectories as weights of smooth bases around the initial trajectory of a context."""

    @property
    def n_weights(self) -> int:
        """P."""
        ...

    @property
    def has_begun(self) -> bool:
        """Whether `begin` has been called."""
        ...

    def begin(
        self, contexts: NDArray[np.floating], trajectories: FloatArray, scale: tuple[float, ...]
    ) -> None:
        """Take over initial trajectories (N, T, D) of contexts (N, C), and the scale of noise."""
        ...

    def weights(
        self, contexts: NDArray[np.floating], trajectories: NDArray[np.floating]
    ) -> FloatArray:
        """Return the weights of trajectories, shape (N, P)."""
        ...

    def trajectories(self, contexts: NDArray[np.floating], weights: FloatArray) -> FloatArray:
        """Return the trajectories of weights, shape (N, T, D)."""
        ...


class Skill(Protocol):
    """What answers a context with the weights of a trajectory; a policy holds one."""

    space: Any  # a `Space`

    @property
    def is_ready(self) -> bool:
        """Whether it has learned anything."""
        ...

    def answer(self, contexts: NDArray[np.floating]) -> FloatArray:
        """Return the weights that answer contexts, shape (N, P)."""
        ...

    def explore(self, contexts: NDArray[np.floating], members: NDArray[np.intp]) -> FloatArray:
        """Return the weights around which members of a generation explore, shape (n, P)."""
        ...

    def learn(self, experience: Experience, generator: th.Generator) -> None:
        """Learn from all rollouts so far."""
        ...


@settings_name("contextual-exploration")
@dataclass(frozen=True)
class ContextualExploration(Settings):
    """How far rollouts in new contexts explore around the answer, in units of the first scale.

    >>> ContextualExploration(wanted_rate=0.5).limits  # contextual=... of RC-NMP takes it
    (0.03, 1.0)

    :param largest: scale, as long as nothing was right: half of the rollouts explore at scales
        between 1 and this, evenly on a logarithmic scale, the others at 1
    :param widening: factor on both after a generation of which less than `least_share` achieved
        something, where rollouts tell what they achieved
    :param least_share: see there
    :param after_success: scale once there is an example to follow
    :param after_achievement: scale once there is an answer from what was achieved
    :param wanted_rate: share of successes at which the scale stays; more let it grow
    :param gain: of the scale's logarithm on the difference from that share
    :param limits: of the scale, where success alone tells what is right
    :param limits_achieved: of the scale, where rollouts tell what they achieved
    :param least_achieved: rollouts that achieved something before there is an answer
    :param patience: the skill is learned anew when the rollouts have grown by this share
    :param alike: a rollout that achieved what is asked is repeated as it was, if its circumstances
        differ by at most this, in standard deviations of contexts; None repeats none
    :param stride: how far from what was achieved a rollout aims, towards a goal farther away; in
        units of the distance at which rollouts still succeed
    :raises ConfigurationError: a value outside its range
    """

    largest: float = 5.0
    widening: float = 3.0
    least_share: float = 0.25
    after_success: float = 0.4
    after_achievement: float = 1.25
    wanted_rate: float = 0.3
    gain: float = 0.5
    limits: tuple[float, float] = (0.03, 1.0)
    limits_achieved: tuple[float, float] = (0.2, 2.5)
    least_achieved: int = 10
    patience: float = 0.05
    alike: float | None = 0.2
    stride: float = 3.0

    def rules(self) -> Rules:
        """Return the rules of the values."""
        return {
            "largest": (self.largest >= 1, ">= 1"),
            "widening": (self.widening >= 1, ">= 1"),
            "least_share": (0 <= self.least_share <= 1, "in [0, 1]"),
            "after_success": (self.after_success > 0, "> 0"),
            "after_achievement": (self.after_achievement > 0, "> 0"),
            "wanted_rate": (0 < self.wanted_rate < 1, "in (0, 1)"),
            "gain": (self.gain >= 0, ">= 0"),
            "limits": limits(*self.limits),
            "limits_achieved": limits(*self.limits_achieved),
            "least_achieved": whole(self.least_achieved, least=1),
            "patience": (self.patience >= 0, ">= 0"),
            "alike": (self.alike is None or self.alike >= 0, ">= 0, or None"),
            "stride": (self.stride > 0, "> 0"),
        }


@saved_state("contextual-search")
@dataclass
class ContextualSearch:
    """Where a search over varying contexts stands; it is saved with the model.

    :param exploration: its settings
    :param scale: of the noise at present
    :param example: row of the first success that counts, None before there is one
    :param since: row from which on every success counts
    :param learned_from: rollouts from which the skill was learned last
    :param shown: contexts and weights of demonstrations, which are right from the beginning, shapes
        (M, C) and (M, P)
    """

    exploration: ContextualExploration
    scale: float = 1.0
    example: int | None = None
    since: int = 0
    learned_from: int = 0
    shown: tuple[FloatArray, FloatArray] | None = None

    def scales(self, rng: np.random.Generator, n: int, is_ready: bool) -> FloatArray:
        """Return how far each rollout of a generation explores, shape (n,).

        :param rng: the generator to draw from
        :param n: how many
        :param is_ready: whether there is an answer to explore around
        """
        if is_ready:
            return np.full(n, self.scale)
        wide = np.exp(rng.uniform(0.0, np.log(self.exploration.largest), n))
        return self.scale * np.where(np.arange(n) % 2, wide, 1.0)

    def take(
        self, rewards: FloatArray, successes: NDArray[np.bool_], n_before: int, was_ready: bool
    ) -> None:
        """Remember the first success that counts.

        :param rewards: of a generation, shape (n,)
        :param successes: of the same, shape (n,)
        :param n_before: rollouts before that generation
        :param was_ready: whether the generation followed an answer
        """
        if self.example is None and not was_ready and successes.any():
            best = int(np.where(successes, rewards, -np.inf).argmax())
            self.example, self.since = n_before + best, n_before + len(rewards)

    def has_enough(self, told: int) -> bool:
        """Tell whether a skill can be learned.

        :param told: rollouts that told what they achieved
        """
        if self.shown is not None:
            return True
        return told >= self.exploration.least_achieved or (told == 0 and self.example is not None)

    def adapt(self, rate: float, was_ready: bool, is_ready: bool, by_achievement: bool) -> None:
        """Adapt the noise's scale after a generation.

        :param rate: share of successes
        :param was_ready: whether there was an answer before it
        :param is_ready: whether there is one now
        :param by_achievement: whether rollouts tell what they achieved
        """
        e = self.exploration
        low, high = e.limits_achieved if by_achievement else e.limits
        if was_ready:
            self.scale *= float(np.exp(e.gain * (rate - e.wanted_rate)))
            self.scale = float(np.clip(self.scale, low, high))
        elif is_ready:
            self.scale = e.after_achievement if by_achievement else e.after_success

    def widen(self, share: float) -> None:
        """Explore farther after a generation, as long as there is no answer.

        :param share: of the generation that achieved something
        """
        if share < self.exploration.least_share:
            self.scale = min(self.scale * self.exploration.widening, WIDEST)

    def is_due(self, n_rollouts: int) -> bool:
        """Tell whether enough has been rolled out since to learn anew.

        :param n_rollouts: so far
        """
        return n_rollouts >= (1.0 + self.exploration.patience) * self.learned_from
