"""Runs of an experiment, a JSON object a line; those that a file holds are not done again."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

Line = dict[str, Any]


def read_lines(file: Path) -> list[Line]:
    """Return what a file holds; nothing where there is none.

    :param file: one JSON object a line
    """
    if not file.exists():
        return []
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]


def append_missing(
    file: Path, measure: Callable[[str, int], Line], runs: Iterable[tuple[str, int]], number: str
) -> None:
    """Do the runs that a file does not hold, in parallel processes, and append each when it ends.

    :param file: one JSON object a line
    :param measure: of a row and a number: the line of that run, which holds both
    :param runs: rows and numbers
    :param number: under which name a line has its number; its row is ``"row"``
    """
    known = {(each["row"], each[number]) for each in read_lines(file)}
    todo = [run for run in runs if run not in known]
    done = Parallel(n_jobs=-1, return_as="generator_unordered")(
        delayed(measure)(*run) for run in todo
    )
    for line in done:
        with file.open("a", encoding="utf-8") as lines:
            lines.write(f"{json.dumps(line)}\n")
