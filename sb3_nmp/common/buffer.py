"""The buffer of all rollouts that an algorithm has seen, and how rewards rank them."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from sb3_nmp.common.exceptions import ConfigurationError, FileFormatError, InvalidDataError
from sb3_nmp.common.files import AnyPath, read_arrays, writing
from sb3_nmp.common.settings import saved_state

FILE_KEYS = ("contexts", "trajectories", "rewards", "successes", "achieved")
#: how a network sees rewards: by place in [-1, 1], or with mean 0 and standard deviation 1
RewardScaling = Literal["rank", "standardize"]


@saved_state("trajectory-buffer")
class TrajectoryBuffer:
    """Contexts, trajectories and rewards of past rollouts, oldest first.

    >>> buffer = TrajectoryBuffer(context_dim=1, trajectory_shape=(5, 2), capacity=2)
    >>> buffer.add(np.zeros((3, 1)), np.zeros((3, 5, 2)), np.array([1.0, 2.0, 3.0]))
    >>> buffer.rewards.tolist()
    [2.0, 3.0]

    :param context_dim: C
    :param trajectory_shape: (T, D)
    :param capacity: at most so many rollouts, the oldest are dropped; None keeps every rollout
    :param n_elites: so many of the best rollouts are never dropped
    :raises ConfigurationError: fewer places than elites, or none at all
    """

    def __init__(
        self,
        context_dim: int,
        trajectory_shape: tuple[int, ...],
        capacity: int | None = None,
        n_elites: int = 0,
    ) -> None:
        if n_elites < 0 or (capacity is not None and capacity < max(1, n_elites)):
            raise ConfigurationError(
                f"a buffer of {capacity} rollouts cannot keep {n_elites} elites: the capacity must "
                "be None or at least 1 and the number of elites, which must be >= 0."
            )
        self.capacity = capacity
        self.n_elites = n_elites
        self._contexts: NDArray[np.float32] = np.empty((0, context_dim), np.float32)
        self._trajectories: NDArray[np.float32] = np.empty((0, *trajectory_shape), np.float32)
        self._rewards: NDArray[np.float64] = np.empty(0, np.float64)
        self._successes: NDArray[np.bool_] = np.empty(0, bool)
        self._achieved: NDArray[np.float64] = np.empty((0, context_dim))

    def __len__(self) -> int:
        """Return the number of rollouts kept."""
        return len(self._rewards)

    @property
    def contexts(self) -> NDArray[np.float32]:
        """Task parameters, shape (N, C)."""
        return self._contexts

    @property
    def trajectories(self) -> NDArray[np.float32]:
        """The trajectories as they were executed, shape (N, T, D)."""
        return self._trajectories

    @property
    def rewards(self) -> NDArray[np.float64]:
        """Their rewards, shape (N,)."""
        return self._rewards

    @property
    def successes(self) -> NDArray[np.bool_]:
        """Whether they solved the task, shape (N,)."""
        return self._successes

    @property
    def achieved(self) -> NDArray[np.float64]:
        """Contexts in which they would have been right, NaN where not known, shape (N, C)."""
        return self._achieved

    def add(
        self,
        contexts: NDArray[np.floating],
        trajectories: NDArray[np.floating],
        rewards: NDArray[np.floating],
        successes: NDArray[np.bool_] | None = None,
        achieved: NDArray[np.floating] | None = None,
    ) -> None:
        """Append rollouts.

        :param contexts: shape (N, C)
        :param trajectories: shape (N, T, D)
        :param rewards: shape (N,)
        :param successes: shape (N,); None: not known, taken for failures
        :param achieved: shape (N, C), NaN where a rollout achieved nothing; None: not known
        :raises InvalidDataError: shapes that do not fit, or non-finite values
        """
        n = len(rewards)
        successes = np.zeros(n, bool) if successes is None else successes
        achieved = np.full(np.shape(contexts), np.nan) if achieved is None else achieved
        shapes = {
            "contexts": (np.shape(contexts), (len(rewards), *self._contexts.shape[1:])),
            "trajectories": (np.shape(trajectories), (len(rewards), *self._trajectories.shape[1:])),
            "rewards": (np.shape(rewards), (len(rewards),)),
            "successes": (np.shape(successes), (len(rewards),)),
            "achieved": (np.shape(achieved), (len(rewards), *self._contexts.shape[1:])),
        }
        for name, (shape, expected) in shapes.items():
            if shape != expected:
                raise InvalidDataError(f"{name} have shape {shape}; the buffer needs {expected}.")
        for name, values in zip(FILE_KEYS, (contexts, trajectories, rewards), strict=False):
            if not np.isfinite(values).all():
                raise InvalidDataError(f"{name} hold a value that is not finite (NaN or infinity).")
        self._contexts = np.concatenate([self._contexts, contexts]).astype(np.float32)
        self._trajectories = np.concatenate([self._trajectories, trajectories]).astype(np.float32)
        self._rewards = np.concatenate([self._rewards, rewards]).astype(np.float64)
        self._successes = np.concatenate([self._successes, successes]).astype(bool)
        self._achieved = np.concatenate([self._achieved, achieved]).astype(np.float64)
        self._drop_oldest()

    def _drop_oldest(self) -> None:
        """Go down to the capacity, keeping the elites and, of the others, the newest."""
        if self.capacity is None or len(self) <= self.capacity:
            return
        best_first = np.argsort(-self._rewards, kind="stable")
        others = np.sort(best_first[self.n_elites :])
        n_others = self.capacity - self.n_elites
        newest = others[len(others) - n_others :]
        self._keep(np.sort(np.concatenate([best_first[: self.n_elites], newest])))

    def drop(self, context: NDArray[np.floating], tolerance: float) -> None:
        """Forget the rollouts of a context.

        :param context: shape (C,)
        :param tolerance: largest difference in an entry at which two contexts are the same
        """
        same = np.abs(self._contexts - context).max(axis=1, initial=0.0) <= tolerance
        self._keep(np.flatnonzero(~same))

    def _keep(self, keep: NDArray[np.intp]) -> None:
        """Forget all rows but some."""
        self._contexts = self._contexts[keep]
        self._trajectories = self._trajectories[keep]
        self._rewards = self._rewards[keep]
        self._successes, self._achieved = self._successes[keep], self._achieved[keep]

    def save(self, path: AnyPath) -> None:
        """Write the buffer as .npz, without pickled objects, in one atomic step.

        :param path: of the file, or an open one; its folder is made
        """
        with writing(path) as file:
            np.savez_compressed(
                file,
                contexts=self._contexts,
                trajectories=self._trajectories,
                rewards=self._rewards,
                successes=self._successes,
                achieved=self._achieved,
            )

    def load(self, path: AnyPath) -> None:
        """Replace the content by that of a file.

        :param path: of a file that `save` wrote
        :raises FileFormatError: the file is not such a file, or holds pickled objects
        :raises InvalidDataError: its arrays do not fit this buffer
        """
        try:
            arrays = read_arrays(path, FILE_KEYS)
        except FileFormatError as error:
            raise FileFormatError(
                f"{path} is not a trajectory buffer (.npz with {', '.join(FILE_KEYS)}, written by "
                f"save_replay_buffer; pickles are not read): {error}".rstrip(".")
                + "."
            ) from error
        loaded = TrajectoryBuffer(
            self._contexts.shape[1], self._trajectories.shape[1:], self.capacity, self.n_elites
        )
        loaded.add(*arrays)
        self.__dict__.update(loaded.__dict__)


def places(rewards: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the place of each reward: 0 for the best; equal rewards share their mean place.

    :param rewards: shape (N,)
    :return: shape (N,)
    """
    return rankdata(-rewards, method="average") - 1.0


def scale_rewards(rewards: NDArray[np.floating], scaling: RewardScaling) -> NDArray[np.float64]:
    """Return rewards on a scale that a network can be fed with, shape (N,).

    :param rewards: shape (N,)
    :param scaling: ``"rank"``: by place, from 1 for the best to -1 for the worst; or
        ``"standardize"``: mean 0, standard deviation 1
    """
    if scaling == "rank":
        place = places(rewards)
        spread = float(np.ptp(place))
        return 1.0 - 2.0 * (place - place.min()) / spread if spread else np.ones(len(rewards))
    spread = float(rewards.std())
    is_flat = spread <= 1e-12 * float(np.abs(rewards).max())  # but for rounding
    return (rewards - rewards.mean()) / (1.0 if is_flat else spread)


def selection_weights(rewards: NDArray[np.floating], temperature: float) -> NDArray[np.float64]:
    """Return the probabilities exp(-place / temperature), normalised, shape (N,).

    :param rewards: shape (N,)
    :param temperature: in places: about so many of the best rollouts share most of the
        probability; infinity draws all alike
    """
    place = places(rewards)
    weights = np.exp((place.min() - place) / temperature)
    return weights / weights.sum()
