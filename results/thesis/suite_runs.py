"""Runs of the suites that a table of the thesis is made from."""

from collections.abc import Sequence
from pathlib import Path

from results.adaptation import summary, tables
from results.exceptions import BenchmarkError
from results.harness.record_files import read_records
from results.harness.records import RunRecord, labels_of
from results.report.text_table import Page, Section

OURS = "ACNMP"


def records_of(folder: Path, suite: str, protocol: str, table: str) -> list[RunRecord]:
    """Return the runs of a suite, none where its folder holds none.

    :param folder: that holds the suites' folders
    :param suite: its name
    :param protocol: the name of the protocol that they must have
    :param table: for the message
    :raises BenchmarkError: runs of another protocol
    """
    records = read_records(folder / suite).records
    others = {record.specification.protocol.name for record in records} - {protocol}
    if others:
        raise BenchmarkError(
            f"'{folder / suite}' holds runs of the protocol {', '.join(sorted(others))}; "
            f"{table} needs {protocol} runs of the suite {suite}."
        )
    return records


def command(folder: Path, suite: str) -> str:
    """Return the command that makes a suite's runs.

    :param folder: that holds the suites' folders
    :param suite: its name
    """
    default = folder == Path("results/runs")
    return f"nmp-bench run --suite {suite}" + ("" if default else f" --out {folder / suite}")


def missing_runs(folder: Path, suites: tuple[str, str], found: set[str], table: str) -> list[str]:
    """Return the commands that make the runs of suites without any.

    :param folder: that holds the suites' folders
    :param suites: that the table is made from
    :param found: those with runs
    :param table: for the message
    :raises BenchmarkError: none of the suites has any run
    """
    commands = [command(folder, suite) for suite in suites if suite not in found]
    if len(commands) == len(suites):
        raise BenchmarkError(
            f"'{folder}' holds no runs of the suites {' and '.join(suites)} for {table}; make them "
            f"with '{commands[0]}' and '{commands[1]}'."
        )
    return commands


def by_algorithm(suite: str, records: Sequence[RunRecord]) -> Page:
    """Return the tables of a suite of adaptation, their notes named after it.

    :param suite: its name
    :param records: of its runs; without any, nothing is told
    """
    if not records:
        return Page([], [])
    page = tables.tables(summary.frame(records), labels_of(records))
    sections = [Section(f"{s.title} of the suite {suite}", s.lines, s.style) for s in page.sections]
    return Page(page.tables, sections)
