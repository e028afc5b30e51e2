"""`Generation`: what came of the rollouts of a generation, read from the environments' infos.

The keys of `RolloutInfo` are all that the algorithms read from an ``info`` dictionary. Every one of
them may be missing. Shape letters: N rollouts, T time points, D dimensions, C context.
"""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, TypedDict, cast

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.common.exceptions import InvalidDataError
from sb3_nmp.common.settings import saved_state

IS_SUCCESS = "is_success"
STEP_REWARDS = "step_rewards"
ACHIEVED_CONTEXT = "achieved_context"
#: each term of the reward stands under this prefix and its name, as in ``"reward_goal"``
TERM_PREFIX = "reward_"
#: the term that punishes a rollout which could not be simulated to its end; no cost of the task
DIVERGED = "diverged"


class Information(StrEnum):
    """What an algorithm may learn from, besides contexts and the trajectories it executed."""

    REWARD = "reward"
    SUCCESS = "success"
    TERMS = "terms"
    STEP_REWARDS = "step rewards"
    ACHIEVED_CONTEXTS = "achieved contexts"
    DEMONSTRATIONS = "demonstrations"


class RolloutInfo(TypedDict, total=False):
    """The keys of ``info`` that algorithms read, besides ``reward_<term>``: a float for each term.

    The terms add up to the reward. An environment gives the same terms in every episode.

    :param is_success: whether the rollout solved the task; False where it is missing
    :param step_rewards: the summands of the reward over time, shape (T,)
    :param achieved_context: in which context the rollout would have been right, shape (C,); missing
        where the environment cannot tell, or where it would have been right in none
    """

    is_success: bool
    step_rewards: NDArray[np.float64]
    achieved_context: NDArray[np.float64]


@saved_state("generation")
@dataclass(frozen=True)
class Generation:
    """The N rollouts of a generation, in the order of its members.

    >>> tried = np.zeros((2, 5, 1), np.float32)
    >>> infos = [
    ...     {"is_success": False, "reward_end": -2.0},
    ...     {"is_success": True, "reward_end": -0.1},
    ... ]
    >>> done = Generation.from_step(np.zeros((2, 3)), tried, np.array([-2.0, -0.1]), infos)
    >>> len(done), done.successes.tolist(), done.terms["end"].tolist(), done.step_rewards
    (2, [False, True], [-2.0, -0.1], None)

    :param contexts: shape (N, C)
    :param trajectories: as they were sent to the environment, shape (N, T, D)
    :param rewards: shape (N,)
    :param successes: the info's ``is_success``, False where it has none, shape (N,)
    :param terms: the reward's terms, from the info's ``reward_<name>``, each of shape (N,)
    :param step_rewards: the info's ``step_rewards``, shape (N, T); None where it has none
    :param achieved: the info's ``achieved_context``, NaN where a rollout has none, shape (N, C);
        None where no rollout has one
    """

    contexts: NDArray[np.float32]
    trajectories: NDArray[np.float32]
    rewards: NDArray[np.float64]
    successes: NDArray[np.bool_]
    terms: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    step_rewards: NDArray[np.float64] | None = None
    achieved: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        """Return the number of rollouts, N."""
        return len(self.rewards)

    @classmethod
    def from_step(
        cls,
        contexts: NDArray[np.floating],
        trajectories: NDArray[np.float32],
        rewards: NDArray[np.floating],
        infos: list[dict[str, Any]],
    ) -> "Generation":
        """Gather what one step of the environments gave.

        :param contexts: shape (N, C)
        :param trajectories: shape (N, T, D)
        :param rewards: shape (N,)
        :param infos: one for each environment, see `RolloutInfo`
        :raises InvalidDataError: a reward that is not finite, or an info that tells no such value
        """
        rewards = np.asarray(rewards, np.float64)
        check_rewards(rewards, contexts)
        keys = [key for key in infos[0] if key.startswith(TERM_PREFIX)]
        steps = [told_steps(info, trajectories.shape[1]) for info in infos]
        return cls(
            cast(NDArray[np.float32], contexts),
            trajectories,
            rewards,
            np.array([bool(told_number(info, IS_SUCCESS, 0.0)) for info in infos]),
            {
                key.removeprefix(TERM_PREFIX): np.array([told_number(i, key) for i in infos])
                for key in keys
            },
            None if any(step is None for step in steps) else np.array(steps, np.float64),
            achieved_contexts(infos, np.shape(contexts)[1]),
        )

    @classmethod
    def concatenate(cls, parts: list["Generation"]) -> "Generation":
        """Join parts in their order.

        :param parts: at least one
        :raises InvalidDataError: their rewards have different terms
        """
        steps, terms = [part.step_rewards for part in parts], parts[0].terms
        for part in parts:
            if part.terms.keys() != terms.keys():
                raise InvalidDataError(
                    f"the reward's terms were {sorted(terms)}, and then {sorted(part.terms)}: "
                    "info['reward_<term>'] must tell the same terms after every rollout."
                )
        return cls(
            np.concatenate([part.contexts for part in parts]),
            np.concatenate([part.trajectories for part in parts]),
            np.concatenate([part.rewards for part in parts]),
            np.concatenate([part.successes for part in parts]),
            {name: np.concatenate([part.terms[name] for part in parts]) for name in terms},
            None
            if any(step is None for step in steps)
            else np.concatenate(cast(list[NDArray[np.float64]], steps)),
            _join_achieved(parts),
        )

    def __getitem__(self, rows: slice | NDArray[Any]) -> "Generation":
        """Return some of the rollouts.

        :param rows: a slice, or an array of indices or booleans
        """
        return Generation(
            self.contexts[rows],
            self.trajectories[rows],
            self.rewards[rows],
            self.successes[rows],
            {name: term[rows] for name, term in self.terms.items()},
            None if self.step_rewards is None else self.step_rewards[rows],
            None if self.achieved is None else self.achieved[rows],
        )


def check_rewards(rewards: NDArray[np.float64], contexts: NDArray[np.floating]) -> None:
    """Raise for a reward that no other can be compared with.

    :param rewards: shape (N,)
    :param contexts: in which they were earned, shape (N, C)
    :raises InvalidDataError: one is not finite
    """
    for row in np.flatnonzero(~np.isfinite(rewards))[:1]:
        raise InvalidDataError(
            f"environment {row} returned the reward {rewards[row]} in the context "
            f"{np.asarray(contexts)[row].tolist()}; rewards must be finite. Where a rollout broke "
            "down, return the worst reward that can be earned. learn may be called again: what was "
            "learned before is kept."
        )


def told_number(info: dict[str, Any], key: str, default: float | None = None) -> float:
    """Return a number that an environment's info tells.

    :param info: of one rollout
    :param key: that is read
    :param default: where there is none
    :raises InvalidDataError: it is no single finite number, or missing where there is no default
    """
    value = np.asarray(info.get(key, default))
    if value.size != 1 or value.dtype.kind not in "bfiu" or not np.isfinite(value).all():
        raise InvalidDataError(
            f"info['{key}'] is {info.get(key)!r}; it must be one number or truth value for each "
            "rollout, and finite, or be left out of every info."
        )
    return float(value.item())


def told_steps(info: dict[str, Any], n_time_points: int) -> NDArray[np.float64] | None:
    """Return the summands of the reward over time, shape (T,); None where none are told.

    :param info: of one rollout
    :param n_time_points: T
    :raises InvalidDataError: another shape, or a value that is not finite
    """
    if info.get(STEP_REWARDS) is None:
        return None
    steps = np.asarray(info[STEP_REWARDS])
    if steps.shape != (n_time_points,) or steps.dtype.kind not in "fiu":
        told = f"has shape {steps.shape} and dtype {steps.dtype}"
    elif not np.isfinite(steps).all():
        told = f"is {steps[~np.isfinite(steps)][0]} at time point {np.isfinite(steps).argmin()}"
    else:
        return steps.astype(np.float64)
    raise InvalidDataError(
        f"info['{STEP_REWARDS}'] {told}; it must be {n_time_points} finite numbers, one for each "
        "time point, or be left out of every info."
    )


def achieved_contexts(infos: list[dict[str, Any]], context_dim: int) -> NDArray[np.float64] | None:
    """Return what each rollout achieved, NaN where it tells none, shape (N, C); None if none does.

    :param infos: one for each environment
    :param context_dim: C
    :raises InvalidDataError: one of a wrong shape, or no numbers
    """
    if not any(ACHIEVED_CONTEXT in info for info in infos):
        return None
    nothing = np.full(context_dim, np.nan)
    told = [np.asarray(info.get(ACHIEVED_CONTEXT, nothing)) for info in infos]
    for achieved in told:
        if achieved.shape != (context_dim,) or achieved.dtype.kind not in "fiu":
            raise InvalidDataError(
                f"info['{ACHIEVED_CONTEXT}'] has shape {achieved.shape} and dtype "
                f"{achieved.dtype}; it must be a context, numbers of shape ({context_dim},), or be "
                "left out where a rollout achieved nothing."
            )
    return np.stack(told).astype(np.float64)


def _join_achieved(parts: list[Generation]) -> NDArray[np.float64] | None:
    """Return the achieved contexts of all parts, NaN for those that tell none."""
    if all(part.achieved is None for part in parts):
        return None
    shape = parts[0].contexts.shape[1]
    none = [np.full((len(part), shape), np.nan) for part in parts]
    return np.concatenate(
        [
            nothing if part.achieved is None else part.achieved
            for part, nothing in zip(parts, none, strict=True)
        ]
    )
