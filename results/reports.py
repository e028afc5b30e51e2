"""Which report fits which protocol."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from results import adaptation, one_context, stream
from results.adaptation import summary as adaptation_summary
from results.adaptation import tables as adaptation_tables
from results.exceptions import BenchmarkError
from results.harness.records import RunRecord
from results.one_context import summary as one_context_summary
from results.one_context import tables as one_context_tables
from results.report.report import Figures, Report
from results.stream import summary as stream_summary
from results.stream import tables as stream_tables

ONE_CONTEXT = Report(
    one_context.__name__,
    one_context_summary.frame,
    one_context_summary.summarise,
    one_context_tables.tables,
)
ADAPTATION = Report(
    adaptation.__name__,
    adaptation_summary.frame,
    adaptation_summary.summarise,
    adaptation_tables.tables,
)
STREAM = Report(
    stream.__name__, stream_summary.frame, stream_summary.summarise, stream_tables.tables
)
REPORTS = {
    "one-context": ONE_CONTEXT,
    "leave-one-out": ADAPTATION,
    "extrapolation": ADAPTATION,
    "assimilation": ADAPTATION,
    "stream": STREAM,
}


def report_for(records: Sequence[RunRecord]) -> Report:
    """Return the report that fits the runs of a folder.

    :param records: at least one
    :raises BenchmarkError: runs of several protocols, or of one that is not known
    """
    names = sorted({record.specification.protocol.name for record in records})
    if len(names) == 1 and names[0] in REPORTS:
        return REPORTS[names[0]]
    raise BenchmarkError(
        f"the runs are of the protocol {' and '.join(names)}; a folder holds runs of one of "
        f"{', '.join(REPORTS)}."
    )


def figures(
    records: Sequence[RunRecord], labels: Sequence[str], references: Sequence[Path] = ()
) -> Figures:
    """Draw the figures of a folder's runs.

    :param records: with at least one finished run
    :param labels: the algorithms in the order of the legend
    :param references: files of published curves, where such are known
    :raises BenchmarkError: references that no figure can show
    """
    drawing = import_module(f"{report_for(records).package}.figures")  # matplotlib is slow to load
    return drawing.figures(records, labels, references)
