"""What is told about runs, by protocol: data frame, summary, tables and figures."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import pandas as pd
from rich.console import Group

from results.adaptation import adaptation_frame, adaptation_tables, summarise_adaptation
from results.aggregate import summarise
from results.exceptions import BenchmarkError
from results.protocols import Extrapolation, LeaveOneOut, OneContext, Protocol, Stream
from results.records import Record, curves_frame, runs_frame
from results.streams import stream_frame, stream_tables, summarise_stream
from results.table import markdown_table, terminal_table
from results.text_table import Section, TextTable, markdown_page, terminal_page

if TYPE_CHECKING:  # drawing is imported where it is asked for
    from matplotlib.figure import Figure

Figures = dict[str, "Figure"]


class Report(ABC):
    """What is told about the runs of one protocol."""

    #: whose runs
    protocol: ClassVar[type[Protocol]]

    @abstractmethod
    def frame(self, records: Sequence[Record]) -> pd.DataFrame:
        """Return one row a run.

        :param records: of finished and failed runs
        """

    @abstractmethod
    def summary(self, runs: pd.DataFrame, labels: Sequence[str]) -> pd.DataFrame:
        """Return the numbers of the tables.

        :param runs: of `frame`
        :param labels: the algorithms in the order of the rows
        """

    @abstractmethod
    def terminal(self, runs: pd.DataFrame, labels: Sequence[str], width: int) -> Group:
        """Return the tables for a terminal.

        :param runs: of `frame`
        :param labels: the algorithms in the order of the rows
        :param width: of the terminal, in characters
        """

    @abstractmethod
    def markdown(self, runs: pd.DataFrame, labels: Sequence[str]) -> str:
        """Return the tables as Markdown.

        :param runs: of `frame`
        :param labels: the algorithms in the order of the rows
        """

    @abstractmethod
    def figures(self, records: Sequence[Record], labels: Sequence[str]) -> Figures:
        """Return figures by the name of their file.

        :param records: of at least one finished run
        :param labels: the algorithms in the order of the legend
        """

    def with_references(self, files: Sequence[Path]) -> "Report":
        """Return a report whose figures show published curves too.

        :param files: .npy files
        :raises BenchmarkError: none can be shown
        """
        raise BenchmarkError(
            f"--reference has no meaning for {self.protocol.name} runs; it is for those of "
            f"{LeaveOneOut.name} suites, such as push."
        )


class OneContextReport(Report):
    """Greedy policy and best rollout, from `results.aggregate` and `results.table`."""

    protocol = OneContext

    def frame(self, records: Sequence[Record]) -> pd.DataFrame:
        """See `Report.frame`."""
        return runs_frame(records)

    def summary(self, runs: pd.DataFrame, labels: Sequence[str]) -> pd.DataFrame:
        """See `Report.summary`."""
        return summarise(runs, labels)

    def terminal(self, runs: pd.DataFrame, labels: Sequence[str], width: int) -> Group:
        """See `Report.terminal`."""
        return terminal_table(runs, labels, width)

    def markdown(self, runs: pd.DataFrame, labels: Sequence[str]) -> str:
        """See `Report.markdown`."""
        return markdown_table(runs, labels)

    def figures(self, records: Sequence[Record], labels: Sequence[str]) -> Figures:
        """See `Report.figures`."""
        from results.plot import figures

        return figures(curves_frame(records), records, labels)


class TextReport(Report):
    """A report whose tables are `TextTable`s."""

    @abstractmethod
    def tables(
        self, runs: pd.DataFrame, labels: Sequence[str]
    ) -> tuple[list[TextTable], list[Section]]:
        """Return the tables, and the notes below them.

        :param runs: of `frame`
        :param labels: the algorithms in the order of the rows
        """

    def terminal(self, runs: pd.DataFrame, labels: Sequence[str], width: int) -> Group:
        """See `Report.terminal`."""
        return terminal_page(*self.tables(runs, labels), width)

    def markdown(self, runs: pd.DataFrame, labels: Sequence[str]) -> str:
        """See `Report.markdown`."""
        return markdown_page(*self.tables(runs, labels))


class AdaptationReport(TextReport):
    """Adaptation to held-out contexts.

    :param references: .npy files of published curves
    """

    def __init__(self, references: Sequence[Path] = ()) -> None:
        self.references = tuple(references)

    def frame(self, records: Sequence[Record]) -> pd.DataFrame:
        """See `Report.frame`."""
        return adaptation_frame(records)

    def summary(self, runs: pd.DataFrame, labels: Sequence[str]) -> pd.DataFrame:
        """See `Report.summary`."""
        return summarise_adaptation(runs, labels)

    def tables(
        self, runs: pd.DataFrame, labels: Sequence[str]
    ) -> tuple[list[TextTable], list[Section]]:
        """See `TextReport.tables`."""
        return adaptation_tables(runs, labels)

    def figures(self, records: Sequence[Record], labels: Sequence[str]) -> Figures:
        """See `Report.figures`."""
        from results.plot_adaptation import adaptation_figures, read_reference

        references = dict(read_reference(path) for path in self.references)
        return adaptation_figures(curves_frame(records), labels, references)


class LeaveOneOutReport(AdaptationReport):
    """Adaptation to targets between and beyond the demonstrated ones."""

    protocol = LeaveOneOut

    def with_references(self, files: Sequence[Path]) -> "LeaveOneOutReport":
        """See `Report.with_references`."""
        return LeaveOneOutReport(files)


class ExtrapolationReport(AdaptationReport):
    """Adaptation to contexts far from a set of demonstrations."""

    protocol = Extrapolation


class StreamReport(TextReport):
    """Learning on a stream of contexts."""

    protocol = Stream

    def frame(self, records: Sequence[Record]) -> pd.DataFrame:
        """See `Report.frame`."""
        return stream_frame(records)

    def summary(self, runs: pd.DataFrame, labels: Sequence[str]) -> pd.DataFrame:
        """See `Report.summary`."""
        return summarise_stream(runs, labels)

    def tables(
        self, runs: pd.DataFrame, labels: Sequence[str]
    ) -> tuple[list[TextTable], list[Section]]:
        """See `TextReport.tables`."""
        return stream_tables(runs, labels)

    def figures(self, records: Sequence[Record], labels: Sequence[str]) -> Figures:
        """See `Report.figures`."""
        from results.plot_streams import stream_figures

        return stream_figures(curves_frame(records), labels)


REPORTS: tuple[Report, ...] = (
    OneContextReport(),
    LeaveOneOutReport(),
    ExtrapolationReport(),
    StreamReport(),
)


def report_for(records: Sequence[Record]) -> Report:
    """Return the report that fits the runs of a folder.

    :param records: at least one
    :raises BenchmarkError: runs of several protocols, or of one that is not known
    """
    names = sorted({record["specification"]["protocol"]["name"] for record in records})
    by_name = {report.protocol.name: report for report in REPORTS}
    if len(names) == 1 and names[0] in by_name:
        return by_name[names[0]]
    raise BenchmarkError(
        f"the runs are of the protocol {' and '.join(names)}; a folder holds runs of one of "
        f"{', '.join(by_name)}."
    )
