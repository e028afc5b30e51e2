"""Files that are written whole or not at all, at whatever moment the process is killed."""

import glob
import os
from collections.abc import Mapping
from pathlib import Path


def write_whole(contents: Mapping[Path, bytes]) -> None:
    """Write files that belong together; none is replaced before all of them are on the disk.

    What a killed process has left of the same files is removed, so that the same command again
    leaves no more than the files. A folder is written to by one process at a time (`alone_in`).

    :param contents: by path; the folders exist
    """
    temporary = {path: path.with_name(f".{path.name}.{os.getpid()}.tmp") for path in contents}
    try:
        for path, content in contents.items():
            for left in path.parent.glob(f".{glob.escape(path.name)}.*.tmp"):
                left.unlink(missing_ok=True)
            temporary[path].write_bytes(content)
        for path in contents:
            os.replace(temporary[path], path)
    finally:
        for path in temporary.values():
            path.unlink(missing_ok=True)
