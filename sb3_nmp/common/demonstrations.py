"""`Demonstrations`: what an expert showed, checked once and never changed."""

import hashlib
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from os import PathLike
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sb3_nmp.common.argument_types import is_whole
from sb3_nmp.common.csv_files import read_csv
from sb3_nmp.common.exceptions import ConfigurationError, FileFormatError, InvalidDataError
from sb3_nmp.common.files import AnyPath, read_arrays, writing
from sb3_nmp.common.finite_arrays import finite_array
from sb3_nmp.common.lerobot_files import read_lerobot
from sb3_nmp.common.minari_files import read_minari, write_minari
from sb3_nmp.common.resampling import resample
from sb3_nmp.common.settings import settings_name

FloatArray = NDArray[np.float64]

FILE_KEYS = ("contexts", "trajectories")


@runtime_checkable
class Expert(Protocol):
    """What `Demonstrations.from_task` needs of a task or an environment."""

    def demonstrate(self, context: ArrayLike, mode: str | None = None) -> FloatArray:
        """Solve the task in a context of shape (C,); returns shape (T, D)."""
        ...

    def sample_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw a context, shape (C,)."""
        ...


@settings_name("demonstrations")
@dataclass(frozen=True, eq=False)
class Demonstrations:
    """N expert trajectories, each with the context that it solves; the arrays are read-only.

    >>> shown = Demonstrations([[0.0], [1.0]], [[[0.0], [0.5]], [[1.0], [1.5]]])
    >>> shown
    Demonstrations(2: contexts (2, 1), trajectories (2, 2, 1))
    >>> len(shown), shown.context_dim, shown.trajectory_shape
    (2, 1, (2, 1))

    :param contexts: task parameters, shape (N, C)
    :param trajectories: shape (N, T, D): all of one length and dimension
    :raises InvalidDataError: an empty set, mixed lengths or dimensions, a wrong shape, or a value
        that is not finite
    """

    contexts: NDArray[Any]
    trajectories: NDArray[Any]

    def __post_init__(self) -> None:
        """Check the values and freeze copies of them."""
        trajectories = finite_array("trajectories", self.trajectories, "(N, T, D)", 3)
        contexts = finite_array("contexts", self.contexts, "(N, C)", 2)
        if len(trajectories) == 0:
            raise InvalidDataError("the set of demonstrations is empty; at least one is needed.")
        if len(contexts) != len(trajectories):
            raise InvalidDataError(
                f"{len(contexts)} contexts were given for {len(trajectories)} trajectories; each "
                "demonstration needs the context that it solves."
            )
        if trajectories.shape[1] < 2 or 0 in (trajectories.shape[2], contexts.shape[1]):
            raise InvalidDataError(
                f"trajectories have shape {trajectories.shape} and contexts {contexts.shape}: at "
                "least 2 time points, 1 dimension and 1 task parameter are needed."
            )
        object.__setattr__(self, "contexts", contexts)
        object.__setattr__(self, "trajectories", trajectories)

    def __len__(self) -> int:
        """Return the number of demonstrations, N."""
        return len(self.trajectories)

    def __repr__(self) -> str:
        """Return how many there are, and their shapes."""
        shapes = f"contexts {self.contexts.shape}, trajectories {self.trajectories.shape}"
        return f"Demonstrations({len(self)}: {shapes})"

    def __getitem__(self, rows: slice | Sequence[int] | NDArray[Any]) -> "Demonstrations":
        """Return some of the demonstrations.

        :param rows: a slice, or indices or booleans
        """
        return Demonstrations(self.contexts[rows], self.trajectories[rows])

    def __eq__(self, other: object) -> bool:
        """Tell whether two sets hold the same numbers."""
        return isinstance(other, Demonstrations) and self.digest == other.digest

    def __hash__(self) -> int:
        """Return a hash of the numbers."""
        return hash(self.digest)

    @property
    def context_dim(self) -> int:
        """C."""
        return self.contexts.shape[1]

    @property
    def trajectory_shape(self) -> tuple[int, int]:
        """(T, D)."""
        return self.trajectories.shape[1], self.trajectories.shape[2]

    @property
    def digest(self) -> str:
        """SHA-256 of shapes and numbers, in hexadecimal: it names the data in a saved model."""
        sha = hashlib.sha256()
        for array in (self.contexts, self.trajectories):
            sha.update(str(array.shape).encode())
            sha.update(np.ascontiguousarray(array, "<f8").tobytes())
        return sha.hexdigest()

    def joined_with(self, contexts: ArrayLike, trajectories: ArrayLike) -> "Demonstrations":
        """Return this set with further trajectories at its end.

        :param contexts: shape (M, C)
        :param trajectories: shape (M, T, D)
        :raises InvalidDataError: they do not fit
        """
        more = Demonstrations(np.asarray(contexts), np.asarray(trajectories))
        self._check_fit(more.context_dim, more.trajectory_shape, "the further demonstrations")
        return Demonstrations(
            np.concatenate([self.contexts, more.contexts]),
            np.concatenate([self.trajectories, more.trajectories]),
        )

    def resample(self, n_steps: int) -> "Demonstrations":
        """Return this set with trajectories of another length, by linear interpolation.

        :param n_steps: T of the result
        :raises InvalidDataError: it is less than 2
        """
        return Demonstrations(self.contexts, resample(list(self.trajectories), n_steps))

    def check_fits(self, context_dim: int, trajectory_shape: tuple[int, int]) -> None:
        """Raise unless the demonstrations fit an environment.

        :param context_dim: C
        :param trajectory_shape: (T, D)
        :raises InvalidDataError: they do not
        """
        self._check_fit(context_dim, trajectory_shape, "the environment")

    def _check_fit(self, context_dim: int, trajectory_shape: tuple[int, int], whose: str) -> None:
        if self.context_dim != context_dim:
            raise InvalidDataError(
                f"the demonstrations' contexts have {self.context_dim} entries, but {whose} "
                f"has contexts of {context_dim}."
            )
        if self.trajectory_shape != tuple(trajectory_shape):
            raise InvalidDataError(
                f"the demonstrations' trajectories have shape (T, D) = {self.trajectory_shape}, "
                f"but {whose} has {tuple(trajectory_shape)}; resample them."
            )

    # -- from experts --------------------------------------------------------------------------

    @classmethod
    def from_task(
        cls,
        task: str | gym.Env | Expert,
        contexts: ArrayLike | int,
        seed: int | np.random.Generator | None = None,
        modes: Sequence[str] | None = None,
    ) -> "Demonstrations":
        """Let a task's scripted expert demonstrate.

        :param task: a Gymnasium id such as ``"nmp/Push-v0"``, an environment, or a task: anything
            with ``demonstrate(context)`` and ``sample_context(rng)``
        :param contexts: shape (N, C), or how many the task is to draw
        :param seed: of the drawn contexts, or the generator itself
        :param modes: ways to solve the task that are shown in turn, such as ``("s", "reverse_s")``
            of bottles; None shows the expert's first one alone
        :raises ConfigurationError: the task has no expert, or the seed is none
        :raises InvalidDataError: no context, or no mode, at all
        """
        source: Any = gym.make(task).unwrapped if isinstance(task, str) else task
        source = source.unwrapped if isinstance(source, gym.Env) else source
        if not isinstance(source, Expert):
            raise ConfigurationError(
                f"{type(source).__name__} has no expert: it needs the methods demonstrate(context) "
                "and sample_context(rng). Give Demonstrations(contexts, trajectories) your own."
            )
        whole = is_whole(seed) and seed >= 0
        if seed is not None and not whole and not isinstance(seed, np.random.Generator):
            raise ConfigurationError(
                f"seed is {seed!r}; it must be a whole number from 0, a generator of NumPy, or "
                "None."
            )
        if isinstance(contexts, Integral):
            rng = np.random.default_rng(seed)
            chosen = [source.sample_context(rng) for _ in range(int(contexts))]
        elif np.ndim(contexts) == 0:
            raise InvalidDataError(
                f"contexts is {contexts!r}; give how many, a whole number, or an array (N, C)."
            )
        else:
            chosen = list(np.asarray(contexts, np.float64))
        if not chosen:
            raise InvalidDataError("no context was given: at least one demonstration is needed.")
        if modes is not None and (isinstance(modes, str) or not modes):
            raise InvalidDataError(f"modes is {modes!r}; it must name one or more, or be None.")
        shown = [
            source.demonstrate(c, modes[i % len(modes)]) if modes else source.demonstrate(c)
            for i, c in enumerate(chosen)
        ]
        return cls(np.stack(chosen), np.stack(shown))

    # -- files ---------------------------------------------------------------------------------

    def save(self, path: AnyPath) -> None:
        """Write the set as .npz, without pickled objects, in one atomic step.

        :param path: of the file, or an open one; its folder is made
        """
        with writing(path) as file:
            np.savez_compressed(file, contexts=self.contexts, trajectories=self.trajectories)

    @classmethod
    def load(cls, path: AnyPath) -> "Demonstrations":
        """Read a set that `save` wrote, or any .npz with ``contexts`` and ``trajectories``.

        :param path: of the file
        :raises FileFormatError: it is not such a file, or holds pickled objects
        :raises InvalidDataError: its arrays are no demonstrations
        """
        try:
            arrays = read_arrays(path, FILE_KEYS)
        except FileFormatError as error:
            is_zip = not isinstance(path, str | PathLike) or zipfile.is_zipfile(path)
            why = error if is_zip else "it is no .npz file"  # NumPy would speak of pickles
            raise FileFormatError(
                f"{path} does not hold demonstrations (.npz with the arrays "
                f"{' and '.join(FILE_KEYS)}; others are read by from_csv, from_minari and "
                f"from_lerobot): {why}."
            ) from error
        return cls(*arrays)

    @classmethod
    def from_csv(
        cls,
        path: str | PathLike[str],
        n_steps: int | None = None,
        contexts: ArrayLike | None = None,
    ) -> "Demonstrations":
        """Read comma-separated values, a row for each time point (`sb3_nmp.common.csv_files`).

        Columns: ``demonstration`` (which one), ``time``, some that begin with ``context``, and one
        for each dimension of the trajectory.

        :param path: of the file
        :param n_steps: T, to which all are resampled by their times; None takes them as they are
        :param contexts: shape (N, C), where the file has no columns for them
        :raises FileFormatError: what the file holds does not fit; the message names row and column
        :raises InvalidDataError: different lengths and no ``n_steps``, or no contexts
        """
        return cls(*read_csv(path, n_steps, contexts))

    @classmethod
    def from_lerobot(
        cls,
        folder: str | PathLike[str],
        n_steps: int | None = None,
        *,
        trajectory: str = "action",
        context: str = "observation.state",
        episodes: Sequence[int] | None = None,
    ) -> "Demonstrations":
        """Read a LeRobot dataset on this machine, an episode each (`sb3_nmp.common.lerobot_files`).

        :param folder: of the dataset, with ``meta`` and ``data`` in it
        :param n_steps: T, to which all are resampled by their time stamps; None: as they are
        :param trajectory: the feature whose values over time are the trajectory
        :param context: the feature whose value in the first frame is the context
        :param episodes: which ones; None reads all
        :raises ConfigurationError: pyarrow is not installed
        :raises FileFormatError: there is no such dataset, or it is damaged
        :raises InvalidDataError: an unknown feature or episode, or different lengths and no
            ``n_steps``
        """
        return cls(*read_lerobot(Path(folder), trajectory, context, n_steps, episodes))

    def to_minari(self, dataset_id: str, env: gym.Env | str, **metadata: Any) -> Any:  # noqa: ANN401
        """Write the set as a local Minari dataset: an episode of one step a demonstration.

        :param dataset_id: such as ``"push/expert-v0"``
        :param env: the environment that the demonstrations are for, or its id
        :param metadata: further arguments of ``minari.create_dataset_from_buffers``
        :return: the ``minari.MinariDataset``
        :raises ConfigurationError: Minari is not installed
        """
        return write_minari(self, dataset_id, env, metadata)

    @classmethod
    def from_minari(
        cls,
        dataset: Any,  # noqa: ANN401
        n_steps: int | None = None,
        context: str | None = None,
    ) -> "Demonstrations":
        """Read a Minari dataset, an episode each.

        :param dataset: a ``minari.MinariDataset`` or the id of a local one
        :param n_steps: T, to which the actions of episodes with many steps are resampled; None:
            every episode is one step, whose action is the whole trajectory
        :param context: the entry of the first observation that is the context, where observations
            are dictionaries
        :raises ConfigurationError: Minari is not installed
        :raises InvalidDataError: an episode has many steps, and ``n_steps`` is None
        """
        return cls(*read_minari(dataset, n_steps, context))


def check_type(demonstrations: Demonstrations | None) -> Demonstrations | None:
    """Return what was given, or raise if it is no set of demonstrations.

    :param demonstrations: a set, or None
    :raises ConfigurationError: it is something else
    """
    if demonstrations is not None and not isinstance(demonstrations, Demonstrations):
        raise ConfigurationError(
            f"demonstrations is a {type(demonstrations).__name__}; it must be Demonstrations: "
            "Demonstrations(contexts, trajectories) makes them from arrays."
        )
    return demonstrations
