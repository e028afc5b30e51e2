"""Episodes of a LeRobot dataset on this machine, read from its parquet files by pyarrow.

Both layouts are read: a file for each episode (2.0, 2.1), and many episodes in a file (3.0). In all
of them a row is a frame, with ``episode_index``, ``frame_index`` and ``timestamp`` in seconds, and
``meta/info.json`` tells the features. See https://github.com/huggingface/lerobot.
"""

import json
from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sb3_nmp.common.argument_types import is_whole
from sb3_nmp.common.exceptions import ConfigurationError, FileFormatError, InvalidDataError
from sb3_nmp.common.resampling import of_one_length

FRAME = ("episode_index", "frame_index", "timestamp")
FloatArray = NDArray[np.float64]


def read_lerobot(
    folder: Path,
    trajectory: str,
    context: str,
    n_steps: int | None,
    episodes: Sequence[int] | None,
) -> tuple[FloatArray, FloatArray]:
    """Return contexts (N, C) and trajectories (N, T, D), an episode each.

    :param folder: of the dataset, with ``meta`` and ``data`` in it
    :param trajectory: the feature whose values over time are the trajectory
    :param context: the feature whose value in the first frame is the context
    :param n_steps: T, to which all are resampled by their time stamps; None: as they are
    :param episodes: which ones; None reads all
    :raises ConfigurationError: pyarrow is not installed
    :raises FileFormatError: no such dataset, or files that do not fit its metadata
    :raises InvalidDataError: an unknown feature or episode, or different lengths and no ``n_steps``
    """
    features = _features(folder)
    for name in (trajectory, context):
        if name not in features:
            numbers = [each for each, told in features.items() if "float" in str(told.get("dtype"))]
            raise InvalidDataError(
                f"{folder} has no feature '{name}'; those of numbers are {', '.join(numbers)}."
            )
    frames = _frames(folder, [*dict.fromkeys((trajectory, context))])
    indices = frames["episode_index"]
    known = np.unique(indices).tolist()
    wanted = known if episodes is None else _whole(episodes)
    missing = sorted(set(wanted) - set(known))
    if missing or not wanted:
        raise InvalidDataError(
            f"{folder} has no episode {missing or wanted}; it has {len(known)}: {known[:5]} ..."
        )
    contexts, rows, times = [], [], []
    for episode in wanted:
        own = np.flatnonzero(indices == episode)
        own = own[np.argsort(frames["frame_index"][own], kind="stable")]
        contexts.append(frames[context][own[0]])
        rows.append(frames[trajectory][own])
        times.append(frames["timestamp"][own])
    return np.stack(contexts), of_one_length(rows, times, n_steps, str(folder))


def _whole(episodes: Sequence[int]) -> list[int]:
    """Return the numbers of episodes as they are given, in a list."""
    numbers: list[Any] = list(episodes) if isinstance(episodes, Iterable) else [None]
    if not all(map(is_whole, numbers)):
        raise InvalidDataError(
            f"episodes is {episodes!r}; it must be a list of episodes' numbers, such as [0, 2]."
        )
    return [int(each) for each in numbers]


def _features(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the features that the metadata tell."""
    info = folder / "meta" / "info.json"
    try:
        return dict(json.loads(info.read_text(encoding="utf-8"))["features"])
    except FileNotFoundError as error:
        raise FileFormatError(
            f"{folder} is no LeRobot dataset: it lacks meta/info.json. Give the folder that holds "
            "meta and data."
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise FileFormatError(f"{info} tells no features: {error!r}") from error


def _frames(folder: Path, features: list[str]) -> dict[str, FloatArray]:
    """Return the columns of all frames: numbers of shape (F,), features of shape (F, n)."""
    if find_spec("pyarrow") is None:
        raise ConfigurationError(
            "LeRobot datasets are read by pyarrow, which is not installed: pip install "
            "'sb3-nmp[parquet]'."
        )
    from pyarrow import ArrowException
    from pyarrow.parquet import read_table

    files = sorted((folder / "data").rglob("*.parquet"))
    if not files:
        raise FileFormatError(f"{folder} has no parquet file in 'data'.")
    parts: dict[str, list[FloatArray]] = {name: [] for name in (*FRAME, *features)}
    for path in files:
        try:
            table = read_table(path, columns=[*parts])
            for name, found in parts.items():
                values = np.array(table[name].to_pylist(), np.float64)
                found.append(values[:, None] if name in features and values.ndim == 1 else values)
        except (ArrowException, KeyError, ValueError, TypeError, OSError) as error:
            raise FileFormatError(f"{path} does not hold {', '.join(parts)}: {error}") from error
    joined = {name: np.concatenate(found) for name, found in parts.items()}
    for name, values in joined.items():
        if not np.isfinite(values).all():
            raise InvalidDataError(f"{folder}: '{name}' holds a value that is not finite.")
    return joined
