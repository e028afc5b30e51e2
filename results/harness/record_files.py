"""The files of records: one per run, written in one go.

A finished run is ``<stem>.json``, a failed one ``<stem>.failed.json``.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from results.exceptions import RecordError, UnreadableRecordError
from results.harness.records import RunRecord
from results.harness.whole_files import write_whole

FORMAT = 2
FAILED = ".failed.json"


class _Versioned(msgspec.Struct):
    format: int


@dataclass(frozen=True)
class Folder:
    """The runs of a folder.

    :param records: those that can be read, in the order of their files' names
    :param unreadable: a sentence for each file that cannot
    """

    records: list[RunRecord]
    unreadable: dict[Path, str] = field(default_factory=dict)


def write_record(path: Path, record: RunRecord) -> None:
    """Write a record whole or not at all.

    :param path: of the file
    :param record: of the run
    :raises ValueError: it holds a number that is not finite
    """
    text = json.dumps({"format": FORMAT, **msgspec.to_builtins(record)}, allow_nan=False)
    write_whole({path: f"{text}\n".encode()})


def read_record(path: Path) -> RunRecord:
    """Read one run.

    :param path: of its file
    :raises UnreadableRecordError: it is damaged, or no run's file
    :raises RecordError: it is of another version
    """
    try:
        text = path.read_bytes()
        found = msgspec.json.decode(text, type=_Versioned).format
        if found == FORMAT:
            return msgspec.json.decode(text, type=RunRecord)
    except (OSError, ValueError, msgspec.MsgspecError) as error:
        raise UnreadableRecordError(
            f"'{path}' is no readable run ({error}): a folder of runs holds JSON files that "
            "'nmp-bench run' wrote. Remove the file; the same command then does its run again.",
            why=str(error),
        ) from error
    if found > FORMAT:
        raise RecordError(
            f"'{path}' is of format {found}, and this version reads format {FORMAT}: update "
            "sb3-nmp, or remove the file and do the run again."
        )
    raise RecordError(
        f"'{path}' is of format {found}, from before this format, which tells too little for "
        f"today's tables (format {FORMAT}): remove the file and do the run again, or read it with "
        "sb3-nmp 0.1."
    )


def read_records(folder: Path) -> Folder:
    """Read all runs of a folder, finished and failed.

    :param folder: of the runs; none are found where it does not exist
    """
    records: list[RunRecord] = []
    unreadable: dict[Path, str] = {}
    for path in sorted(folder.glob("*.json")):
        try:
            records.append(read_record(path))
        except RecordError as error:
            unreadable[path] = str(error)
    return Folder(records, unreadable)
