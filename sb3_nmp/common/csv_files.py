"""Demonstrations as comma-separated values, a row for each time point.

    demonstration,time,context_x,context_y,shoulder,elbow
    1,0.00,0.30,0.10,0.000,0.000
    1,0.02,0.30,0.10,0.012,0.007
    ...
    2,0.00,0.25,0.40,0.000,0.000

``demonstration`` names the demonstration, by a number or a word; where the column is missing, the
file holds one. ``time`` is in any unit, and may be missing where points have equal distances; by
another name, such as ``t``, it is refused, since it would count as a dimension.
Columns that begin with ``context`` are the task parameters, constant within a demonstration. All
others are the trajectory's dimensions, in their order.
"""

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sb3_nmp.common.exceptions import FileFormatError, InvalidDataError
from sb3_nmp.common.files import writing
from sb3_nmp.common.finite_arrays import numbers
from sb3_nmp.common.resampling import of_one_length

NUMBER, TIME, CONTEXT = "demonstration", "time", "context"
OTHER_DELIMITERS = (";", "\t", "|")
#: names of columns that can mean nothing but time, with a unit or without
MEANS_TIME = re.compile(
    r"(t|times?|(time_?)?stamps?|time_?steps?|secs?|seconds?|msecs?|milliseconds?)"
    r"([ _]*[\[(]?(s|ms|us|µs|ns|(m|milli|micro|nano)?sec(ond)?s?)[\])]?)?",
    re.IGNORECASE,
)
#: names that can mean nothing but which demonstration, or which point of it, a row is of
MEANS_NUMBER = re.compile(
    r"((demonstrations?|demos?|episodes?|trajector(y|ies)|trajs?|rollouts?|runs?)"
    r"([ _]?(ids?|index|indices|numbers?|nr|idx))?"
    r"|(frame|step|row)s?[ _]?(index|idx|number|nr|id)?"
    r"|index|idx|id|level_\d+|unnamed: \d+)",
    re.IGNORECASE,
)
FloatArray = NDArray[np.float64]


@dataclass
class _Recorded:
    """The rows of one demonstration."""

    context: list[float]
    times: list[float] = field(default_factory=list)
    points: list[list[float]] = field(default_factory=list)


def read_csv(
    path: str | PathLike[str], n_steps: int | None = None, contexts: ArrayLike | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return contexts (N, C) and trajectories (N, T, D) of a file, demonstrations in their order.

    :param path: of the file
    :param n_steps: T, to which all are resampled; None takes them as they are
    :param contexts: shape (N, C), where the file has no columns for them
    :raises FileFormatError: a cell that holds no finite number, a context that changes within a
        demonstration, times that do not increase; the message names row and column
    :raises InvalidDataError: different lengths, and no ``n_steps``; or no contexts
    """
    columns, recorded = _read_rows(path)
    shown = list(recorded.values())
    if contexts is None and not columns.contexts:
        raise InvalidDataError(
            f"{path} has no column that begins with '{CONTEXT}'; add some, or give contexts= with "
            f"a row for each of its {len(shown)} demonstrations."
        )
    if contexts is not None and columns.contexts:
        raise InvalidDataError(
            f"{path} has the column '{columns.header[columns.contexts[0]]}', and contexts= are "
            "given: leave out one of them."
        )
    told = [each.context for each in shown] if contexts is None else contexts
    times = [np.array(each.times) for each in shown] if columns.time is not None else None
    points = [np.array(each.points) for each in shown]
    parameters = numbers("contexts", told, "(N, C), a row for each demonstration")
    return parameters, of_one_length(points, times, n_steps, str(path))


def _read_rows(path: str | PathLike[str]) -> tuple["_Columns", dict[str, _Recorded]]:
    """Return what the columns of a file mean, and its rows by demonstration."""
    if not isinstance(path, str | PathLike):
        raise FileFormatError(
            f"path is a {type(path).__name__}; it must be the path of a file, with a row for each "
            "time point."
        )
    recorded: dict[str, _Recorded] = {}
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as file:
            rows = csv.reader(file, strict=True)
            header = [name.strip() for name in next(rows, [])]
            columns = _Columns(str(path), header)
            for row in rows:
                if any(cell.strip() for cell in row):
                    columns.take(row, rows.line_num, recorded)
    except OSError as error:
        raise FileFormatError(
            f"{path} cannot be read ({error.strerror}); give the path of a file of comma-separated "
            "values."
        ) from error
    except (csv.Error, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path} is no comma-separated text: {error}") from error
    if not recorded:
        raise FileFormatError(f"{path} has no rows of numbers below its header.")
    return columns, recorded


def _check_header(path: str, header: list[str]) -> None:
    """Raise where there is none, and for names that would count as dimensions and are none."""
    found = [each for each in OTHER_DELIMITERS if len(header) == 1 and each in header[0]]
    if found:
        raise FileFormatError(
            f"{path} has the header '{header[0]}', whose names are separated by {found[0]!r}; "
            "names and values must be separated by commas: write the file with that delimiter."
        )
    times = [name for name in header if MEANS_TIME.fullmatch(name) and name != TIME]
    if times:
        raise FileFormatError(
            f"{path} has the column '{times[0]}', which would be a dimension of the trajectory; "
            f"times stand in a column '{TIME}': rename it, or leave it out where points have equal "
            "distances."
        )
    if header and all(math.isfinite(_number(name)) for name in header):
        raise FileFormatError(
            f"{path} has the first row {', '.join(header)}; it must be the header, with a name for "
            "each column: add one."
        )
    capital = [
        name for name in header if name.lower().startswith(CONTEXT) and not name.startswith(CONTEXT)
    ]
    if capital:
        raise FileFormatError(
            f"{path} has the column '{capital[0]}', which would be a dimension of the trajectory; "
            f"columns of the context begin with '{CONTEXT}' in small letters: rename it."
        )
    counts = [name for name in header if MEANS_NUMBER.fullmatch(name) and name != NUMBER]
    if counts:
        raise FileFormatError(
            f"{path} has the column '{counts[0]}', which would be a dimension of the trajectory; "
            f"which demonstration a row is of stands in a column '{NUMBER}', and rows are in the "
            "order of time: rename it, or leave it out."
        )


def _number(cell: str) -> float:
    """Return a cell's number; NaN where it holds none."""
    try:
        return float(cell)
    except ValueError:
        return math.nan


class _Columns:
    """Which column means what, and how a row is read.

    :param path: of the file, for messages
    :param header: its first row
    """

    def __init__(self, path: str, header: list[str]) -> None:
        repeated = sorted({name for name in header if header.count(name) > 1})
        if repeated or "" in header:
            raise FileFormatError(
                f"{path}: the header names {repeated or 'a column without a name'}; each column "
                "needs a name of its own."
            )
        _check_header(path, header)
        self.path, self.header = path, header
        self.number = header.index(NUMBER) if NUMBER in header else None
        self.time = header.index(TIME) if TIME in header else None
        self.contexts = [i for i, name in enumerate(header) if name.startswith(CONTEXT)]
        told = {self.number, self.time, *self.contexts}
        self.dimensions = [i for i in range(len(header)) if i not in told]
        if not self.dimensions:
            raise FileFormatError(
                f"{path} has the columns {', '.join(header) or '(none)'}, none of which is a "
                f"dimension of the trajectory: besides '{NUMBER}', '{TIME}' and those that begin "
                f"with '{CONTEXT}', a column for each joint or coordinate is needed."
            )

    def take(self, row: list[str], line: int, recorded: dict[str, _Recorded]) -> None:
        """Add a row to its demonstration.

        :param row: its cells
        :param line: of the file
        :param recorded: by the demonstration's name
        """
        if len(row) != len(self.header):
            raise FileFormatError(
                f"{self.path}, row {line} has {len(row)} cells; the header names "
                f"{len(self.header)} columns."
            )
        name = "" if self.number is None else row[self.number].strip()
        context = [self._value(row, i, line) for i in self.contexts]
        known = recorded.setdefault(name, _Recorded(context))
        for i, before, now in zip(self.contexts, known.context, context, strict=True):
            if before != now:
                raise FileFormatError(
                    f"{self.path}, row {line}, column '{self.header[i]}': the context changes from "
                    f"{before} to {now} within demonstration '{name}'; it must stay."
                )
        if self.time is not None:
            now = self._value(row, self.time, line)
            if known.times and now <= known.times[-1]:
                raise FileFormatError(
                    f"{self.path}, row {line}, column '{TIME}': {now} follows {known.times[-1]} in "
                    f"demonstration '{name}'; times must increase."
                )
            known.times.append(now)
        known.points.append([self._value(row, i, line) for i in self.dimensions])

    def _value(self, row: list[str], column: int, line: int) -> float:
        value = _number(row[column])
        if not math.isfinite(value):
            raise FileFormatError(
                f"{self.path}, row {line}, column '{self.header[column]}': '{row[column]}' is no "
                "finite number."
            )
        return value


def _check_names(path: str, header: list[str], n_entries: int, n_dimensions: int) -> None:
    """Raise unless a header's columns would be read as context entries and dimensions."""
    bent = [name for name in header if name != name.strip() or set(name) & set(',"\r\n')]
    if bent:
        raise InvalidDataError(
            f"{bent[0]!r} cannot name a column of {path}; a name has no comma, no quotation mark "
            "and no line break, and no space at its ends."
        )
    read = _Columns(path, header)
    if (len(read.contexts), len(read.dimensions)) != (n_entries, n_dimensions):
        raise InvalidDataError(
            f"the columns {', '.join(header)} of {path} would be read as {len(read.contexts)} "
            f"entries of the context and {len(read.dimensions)} dimensions; the data have "
            f"{n_entries} and {n_dimensions}. Give a name for each, and let no dimension's begin "
            f"with '{CONTEXT}'."
        )


def write_csv(
    path: str | PathLike[str],
    contexts: ArrayLike,
    trajectories: ArrayLike,
    times: ArrayLike,
    names: Sequence[str] | None = None,
    context_names: Sequence[str] | None = None,
) -> None:
    """Write trajectories such that `read_csv` returns them bit for bit.

    :param path: of the file
    :param contexts: shape (N, C)
    :param trajectories: shape (N, T, D)
    :param times: of the time points, shape (T,)
    :param names: of the dimensions; ``q1`` and so on by default
    :param context_names: of the task parameters; ``1`` and so on by default
    :raises InvalidDataError: names of another number, or that would not be read as they are
    :raises FileFormatError: names that `read_csv` would refuse
    """
    told, shown = np.asarray(contexts), np.asarray(trajectories)
    dimensions = list(names or (f"q{i + 1}" for i in range(shown.shape[2])))
    entries = list(context_names or (str(i + 1) for i in range(told.shape[1])))
    header = [NUMBER, TIME, *(f"{CONTEXT}_{name}" for name in entries), *dimensions]
    _check_names(str(path), header, told.shape[1], shown.shape[2])
    lines = [header]
    for number, (context, trajectory) in enumerate(zip(told, shown, strict=True), start=1):
        for time, point in zip(np.asarray(times), trajectory, strict=True):
            values = [float(time), *map(float, context), *map(float, point)]
            lines.append([str(number), *map(repr, values)])
    text = "".join(",".join(line) + "\n" for line in lines)
    with writing(path) as file:
        file.write(text.encode())
