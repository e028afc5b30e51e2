"""The files of rows: claims as JSON, trajectories as compressed .npz beside it, and a digest."""

import hashlib
import io
import json
from pathlib import Path
from zipfile import BadZipFile

import msgspec
import numpy as np

from results.exceptions import RecordError
from results.harness.slugs import slug
from results.harness.whole_files import write_whole
from results.leaderboard.rows import Evidence, Row

FORMAT = 1
#: which a row's provenance tells
VERSIONS = ("mujoco", "numpy", "torch", "stable-baselines3")
ARRAYS = ("contexts", "final", "solving")


class _Format(msgspec.Struct):
    format: int


class _File(_Format):
    digest: str
    row: Row


def row_path(data: Path, board: str, label: str) -> Path:
    """Return where a row's claims lie; its trajectories lie beside, ending in .npz.

    :param data: of all boards
    :param board: its name
    :param label: the algorithm's
    """
    return data / board / f"{slug(label)}.json"


def write_row(data: Path, row: Row, evidence: Evidence) -> Path:
    """Write a row, both of its files whole or, on a full disk, neither.

    :param data: of all boards
    :param row: what is claimed
    :param evidence: what earned it
    :return: of the claims' file
    """
    path = row_path(data, row.board, row.label)
    path.parent.mkdir(parents=True, exist_ok=True)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **{name: getattr(evidence, name) for name in ARRAYS})  # type: ignore[arg-type]
    content = {"format": FORMAT, "digest": digest(row, evidence), "row": msgspec.to_builtins(row)}
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    write_whole({path.with_suffix(".npz"): buffer.getvalue(), path: text.encode()})
    return path


def read_row(path: Path) -> tuple[Row, Evidence, str]:
    """Return a row, its trajectories, and the digest that it bears.

    :param path: of its claims
    :raises RecordError: a file is missing, damaged, of another version, or holds other arrays
    """
    try:
        text = path.read_bytes()
        _check_format(path, msgspec.json.decode(text, type=_Format).format)
        content = msgspec.json.decode(text, type=_File)
        with np.load(path.with_suffix(".npz"), allow_pickle=False) as arrays:
            found = {name: arrays[name] for name in arrays.files}
    except RecordError:
        raise
    except (OSError, ValueError, msgspec.MsgspecError, BadZipFile) as error:
        raise RecordError(
            f"'{path}' is no readable row of the leaderboard, with its .npz beside it ({error}): "
            "restore both from the repository, or make the row anew with 'nmp-bench leaderboard "
            "update'."
        ) from error
    if sorted(found) != sorted(ARRAYS) or any(a.dtype != np.float32 for a in found.values()):
        raise RecordError(
            f"'{path.with_suffix('.npz')}' holds {sorted(found)}; a row has {', '.join(ARRAYS)}, "
            "all in single precision."
        )
    _check_row(path, content.row)
    return content.row, Evidence(**found), content.digest


def _check_format(path: Path, found: int) -> None:
    """Raise for a row of another version, whose fields may be others, too.

    :raises RecordError: it is one
    """
    if found != FORMAT:
        raise RecordError(
            f"'{path}' is of format {found}, and this version reads format {FORMAT}: use the "
            "version of sb3-nmp that wrote it."
        )


def _check_row(path: Path, row: Row) -> None:
    """Raise for a row of which neither a table nor a comparison can be made.

    :raises RecordError: it is one
    """
    missing = [name for name in VERSIONS if name not in row.provenance.packages]
    why = f"tells no version of {', '.join(missing)}" if missing else ""
    why = why or ("" if row.claims else "has no claims, one for each run")
    if why:
        raise RecordError(
            f"'{path}' is no whole row of the leaderboard: it {why}. Restore it from the "
            "repository, or make it anew with 'nmp-bench leaderboard update'."
        )


def row_paths(data: Path, board: str | None = None) -> list[Path]:
    """Return the files of all rows' claims.

    :param data: of all boards
    :param board: of this one alone
    """
    return sorted(data.glob(f"{board or '*'}/*.json"))


def digest(row: Row, evidence: Evidence) -> str:
    """Return what changes with any claim or trajectory: a guard against edits, not against liars.

    :param row: what is claimed
    :param evidence: what earned it
    """
    told = msgspec.to_builtins(row)
    if row.n_trials is None:  # which rows did not tell at first
        told.pop("n_trials", None)
    found = hashlib.sha256(json.dumps(told, sort_keys=True).encode())
    for name in ARRAYS:
        array = np.ascontiguousarray(getattr(evidence, name))
        found.update(f"{name}{array.dtype}{array.shape}".encode() + array.tobytes())
    return found.hexdigest()
