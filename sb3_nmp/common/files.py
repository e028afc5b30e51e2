"""Files that hold a model, a policy or statistics: a zip with JSON and safetensors, no pickles.

`CONTENT` holds what `sb3_nmp.common.codec` makes of the values, `TENSORS` their arrays. What cannot
be said like that, such as a function of the user's, stands in ``pickled``, as Stable-Baselines3
saves it, and is read only where the user says so.
"""

import base64
import json
import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BufferedIOBase, BytesIO
from os import PathLike, fspath, getpid
from pathlib import Path
from typing import Any, cast
from uuid import uuid4

import cloudpickle
import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as read_tensors
from safetensors.numpy import save as write_tensors
from stable_baselines3.common.save_util import open_path

from sb3_nmp.common.codec import Decoder, Encoder, UnknownKindError
from sb3_nmp.common.exceptions import (
    ConfigurationError,
    FileFormatError,
    PickleWarning,
    UnsafeFileError,
)

CONTENT, TENSORS = "sb3_nmp.json", "tensors.safetensors"
#: of the layout; a reader refuses newer ones
VERSION = 1
#: what this library, too, once saved as pickles
PICKLED_BEFORE = ("model", "policy")

AnyPath = str | PathLike[str] | BufferedIOBase
DAMAGE = (
    AttributeError, EOFError, IndexError, KeyError, NotImplementedError, OSError, RecursionError,
    RuntimeError, SafetensorError, TypeError, ValueError, zipfile.BadZipFile,
)  # fmt: skip


@contextmanager
def writing(path: AnyPath, suffix: str = "") -> Iterator[BufferedIOBase]:
    """Open a file for writing that appears whole or not at all; its folders are made.

    :param path: of the file, or a file that is open already
    :param suffix: that a path without one gets, such as ``"zip"``
    :raises ConfigurationError: it is neither
    """
    check_path(path)
    if not isinstance(path, str | PathLike):
        yield cast(BufferedIOBase, open_path(path, "w"))
        return
    target = Path(path)
    if suffix and not target.suffix:
        target = Path(f"{fspath(target)}.{suffix}")
    target.parent.mkdir(parents=True, exist_ok=True)
    partial = target.with_name(f".{target.name}.{getpid()}-{uuid4().hex[:8]}.partial")
    try:
        with partial.open("wb") as file:
            yield cast(BufferedIOBase, file)
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


def write(
    path: AnyPath, kind: str, parts: Mapping[str, Mapping[str, Any]], suffix: str = ""
) -> None:
    """Write values.

    :param path: of the file, or an open one
    :param kind: what it holds, such as ``"model"``
    :param parts: groups of named values; a value that has no form in a file is pickled, with a
        `PickleWarning`
    :param suffix: that a path without one gets
    """
    encoder, groups, pickled = Encoder(), {}, {}
    for group, values in parts.items():
        groups[group], pickled[group] = {}, {}
        for name, value in values.items():
            try:
                tried = Encoder()
                groups[group][name] = tried.encode(value, f"{group}.{name}")
                encoder.arrays |= tried.arrays
            except UnknownKindError as error:
                _warn(name, error)
                pickled[group][name] = base64.b64encode(cloudpickle.dumps(value)).decode()
    content = {
        "kind": kind,
        "version": VERSION,
        "parts": groups,
        "pickled": {group: held for group, held in pickled.items() if held},
    }
    with writing(path, suffix) as file, zipfile.ZipFile(file, "w") as archive:
        archive.writestr(CONTENT, json.dumps(content, allow_nan=False), zipfile.ZIP_DEFLATED)
        archive.writestr(TENSORS, write_tensors(encoder.arrays))


def _warn(name: str, error: UnknownKindError) -> None:
    warnings.warn(
        f"'{name}' holds {error}, which can be saved as a pickle only: to read the file, "
        f"load(..., allow_pickle=True) or custom_objects={{'{name}': ...}} will be needed. A "
        "schedule of stable_baselines3.common.utils instead of a function, and a class with "
        "@settings_name or @saved_state above it, do without.",
        PickleWarning,
        stacklevel=4,
    )


def read(
    path: AnyPath,
    kind: str,
    suffix: str = "",
    replaced: Mapping[str, Any] | None = None,
    allow_pickle: bool = False,
    only: Sequence[str] | None = None,
) -> dict[str, dict[str, Any]]:
    """Return the groups of values that `write` wrote.

    :param path: of the file, or an open one
    :param kind: what it must hold
    :param suffix: that is tried where a path without one does not exist
    :param replaced: values that stand for those of the file, which are not read
    :param allow_pickle: read pickles too, which can run any code
    :param only: the groups that are wanted; None reads all
    :raises FileFormatError: it is no such file, or damaged
    :raises UnsafeFileError: it holds pickles, and ``allow_pickle`` is False
    :raises FileNotFoundError: there is none
    """
    content, tensors = _members(path, kind, suffix)
    replaced, decoder = replaced or {}, Decoder(tensors)
    found: dict[str, dict[str, Any]] = {}
    try:
        for group in content["parts"] if only is None else only:
            held, pickled = content["parts"][group], content["pickled"].get(group, {})
            given = {name: replaced[name] for name in (*held, *pickled) if name in replaced}
            asked = [name for name in pickled if name not in given]
            if asked and not allow_pickle:
                raise _pickled(path, asked)
            found[group] = given | {
                name: decoder.decode(part) for name, part in held.items() if name not in given
            }
            for name in asked:
                found[group][name] = cloudpickle.loads(base64.b64decode(pickled[name]))
    except UnsafeFileError:
        raise
    except DAMAGE as error:
        raise FileFormatError(
            f"{_name(path)} cannot be read: {type(error).__name__}: {str(error).rstrip('.')}. It "
            "is damaged, or was written by another version."
        ) from error
    return found


def read_arrays(path: AnyPath, keys: Sequence[str]) -> list[NDArray[Any]]:
    """Return arrays of an .npz file without pickled objects.

    :param path: of the file, or an open one
    :param keys: of the arrays
    :raises FileFormatError: it is no such file, or lacks one of them
    :raises FileNotFoundError: there is none
    """
    try:
        with np.load(BytesIO(bytes_of(path)), allow_pickle=False) as file:
            return [file[key] for key in keys]
    except FileNotFoundError:
        raise
    except DAMAGE as error:
        raise FileFormatError(f"{type(error).__name__}: {error}") from error


def _name(path: AnyPath) -> str:
    return f"'{fspath(path)}'" if isinstance(path, str | PathLike) else "the open file"


def _pickled(path: AnyPath, names: list[str]) -> UnsafeFileError:
    return UnsafeFileError(
        f"{_name(path)} holds {', '.join(map(repr, names))} as a pickle, which can run any code "
        "when it is read. If you trust who wrote it, load it with allow_pickle=True; or replace "
        f"what is pickled: custom_objects={{{names[0]!r}: ...}}."
    )


def _members(
    path: AnyPath, kind: str, suffix: str
) -> tuple[dict[str, Any], dict[str, NDArray[np.generic]]]:
    """Return the JSON and the arrays of a file.

    :raises FileFormatError: it is no file of this library, or is one of another kind
    """
    name, raw = _name(path), bytes_of(path, suffix)
    try:
        with zipfile.ZipFile(BytesIO(raw)) as archive:
            if set(archive.namelist()) != {CONTENT, TENSORS}:
                raise _foreign(name, kind, archive.namelist())
            content = json.loads(archive.read(CONTENT))
            tensors = read_tensors(archive.read(TENSORS))
        version, found = content["version"], content["kind"]
    except FileFormatError:
        raise
    except DAMAGE as error:
        raise FileFormatError(
            f"{name} is no {kind} that this library saved, or is damaged: {type(error).__name__}: "
            f"{str(error).rstrip('.')}. Pickles and other foreign files are not read."
        ) from error
    if found != kind:
        raise FileFormatError(f"{name} holds a {found}; a {kind} is needed.")
    if version != VERSION:
        raise FileFormatError(
            f"{name} has version {version} of the file format, and this library reads {VERSION}: "
            "install the version of sb3-nmp that wrote it."
        )
    return content, tensors


def _foreign(name: str, kind: str, members: list[str]) -> FileFormatError:
    """Return the error for a zip without our content."""
    if "data" in members or any(member.endswith("data.pkl") for member in members):
        told = f"{name} is in the format of Stable-Baselines3 or torch.save, whose pickles can run "
        told += "any code when they are read"
        if kind not in PICKLED_BEFORE:
            return UnsafeFileError(f"{told}; it is no {kind} that this library saved.")
        return UnsafeFileError(
            f"{told} (this library saved a {kind} like that before it had a file format of its "
            "own). If you trust who wrote it, load it with allow_pickle=True, and save it again to "
            "be rid of the pickles."
        )
    return FileFormatError(
        f"{name} is no {kind} that this library saved: such a zip holds {CONTENT} and {TENSORS}, "
        f"and this one {', '.join(members) or 'nothing'}."
    )


def check_path(path: object) -> None:
    """Raise for what is neither a path nor a file that is open for bytes.

    :param path: any
    :raises ConfigurationError: it is neither
    """
    if not isinstance(path, str | PathLike | BufferedIOBase):
        raise ConfigurationError(
            f"path is {path!r}; it must be a path, or a file that is open for bytes, such as "
            "open(name, 'rb') or io.BytesIO()."
        )


def bytes_of(path: AnyPath, suffix: str = "") -> bytes:
    """Return a file's content; an open file is left where it was.

    :param path: of the file, or an open one
    :param suffix: that is tried where a path without one does not exist
    :raises ConfigurationError: it is neither
    :raises FileFormatError: it is a folder
    """
    check_path(path)
    if isinstance(path, str | PathLike):
        if Path(path).is_dir() and not (suffix and Path(f"{fspath(path)}.{suffix}").exists()):
            raise FileFormatError(f"'{fspath(path)}' is a folder; name a file in it.")
        lacking = suffix if Path(path).suffix != f".{suffix}" else ""
        with open_path(Path(path), "r", suffix=lacking or None) as file:
            return file.read()
    file = open_path(path, "r")
    start = file.tell()
    content = file.read()
    file.seek(start)
    return content
