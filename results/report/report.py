"""`Report`: what is told about the runs of one protocol."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from results.exceptions import BenchmarkError
from results.harness.records import RunRecord
from results.report.text_table import Page

if TYPE_CHECKING:  # drawing is imported where it is asked for
    from matplotlib.figure import Figure

Figures = Mapping[str, "Figure"]


@dataclass(frozen=True)
class Report:
    """What is told about the runs of one protocol; each part is a pure function of records.

    :param package: that holds its parts; its module ``figures`` draws
    :param frame: one row per run, from records of finished and failed runs
    :param summarise: the numbers of the tables, from the frame and the algorithms' labels in the
        order of the rows
    :param tables: tables and notes, from the same
    """

    package: str
    frame: Callable[[Sequence[RunRecord]], pd.DataFrame]
    summarise: Callable[[pd.DataFrame, Sequence[str]], pd.DataFrame]
    tables: Callable[[pd.DataFrame, Sequence[str]], Page]


def refuse_references(protocol: str, references: Sequence[Path]) -> None:
    """Raise where published curves are given that no figure can show.

    :param protocol: of the runs
    :param references: .npy files
    :raises BenchmarkError: there are some
    """
    if references:
        raise BenchmarkError(
            f"--reference has no meaning for {protocol} runs; it is for those of leave-one-out "
            "suites, such as push."
        )
