"""The thesis's Table 5.1 beside our numbers, from the runs of the suites push and aperture."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from results.adaptation import adaptation_frame, adaptation_tables, summarise_adaptation
from results.exceptions import BenchmarkError
from results.notes import failures, origins, rollouts_text
from results.protocols import LeaveOneOut, Stream
from results.records import Record, read_records
from results.streams import failure_text, stream_frame, summarise_stream
from results.suites import make_suite
from results.text_table import NOT_APPLICABLE, Cell, Section, TextTable

OURS = "ACNMP"
THEIRS = {"push": "ProMP+RL (Stark)", "aperture": "ProMP+RL (Ewerton)"}
NOT_RUN, FAILED = "not run", "failed"  # as the summaries have them
HEADER = ("", "ACNMP\nthesis", "ProMP+RL\nthesis", "ACNMP\nhere", "ProMP+RL\nhere")
PUBLISHED: dict[str, tuple[Cell, Cell]] = {
    "pushing: rollouts to adapt to a new target": (("130", ""), ("1200", "[Stark et al.]")),
    "aperture: rollouts in a single environment": (("1.4K", ""), ("20K", "[Ewerton et al.]")),
    "aperture: rollouts in all": (("0.7M", ""), ("10M", "[Ewerton et al.]")),
    "aperture: unseen environments that fail": (
        ("9.06 %", "(stored run)"),
        (NOT_APPLICABLE, ""),
    ),
}
NOTES = (
    "pushing, here: rollouts from which on the greedy policy succeeds at held-out extrapolation "
    "targets, median over targets and seeds, and the worst run. Thesis: ACNMP's 130 are for "
    "extrapolation; the 1200 of Stark et al. are for targets of which 80 % are interpolation.",
    "aperture, here: the most rollouts that any run spent in one environment, the rollouts in all "
    "(median over seeds; evaluations not counted), and the failure rate that they gave, mean with "
    "its 95 % bootstrap interval over seeds. Thesis: upper bounds; the run that the original "
    "code's author stored took about 35,000 rollouts, and 9.06 % is its network's failure rate.",
    "ProMP+RL, here: our implementations of Stark et al. for pushing and of Ewerton et al. for "
    "the aperture, on our simulations of the tasks and with our budgets, so columns 'here' "
    "compare with each other and not number by number with the thesis.",
)


def table_5_1(folder: Path) -> tuple[list[TextTable], list[Section]]:
    """Return the table, the table of the suite push by algorithm, and notes.

    A cell without runs tells why, and a note which command makes them.

    :param folder: that holds the suites' folders ``push`` and ``aperture``
    :raises BenchmarkError: neither holds any run
    """
    push = _frame(folder, "push", LeaveOneOut.name)
    aperture = _frame(folder, "aperture", Stream.name)
    if push is None and aperture is None:
        raise BenchmarkError(
            f"'{folder}' holds no runs of the suites push and aperture; make them with "
            f"'{command(folder, 'push')}' and '{command(folder, 'aperture')}'."
        )
    cells = _push_cells(push) | _aperture_cells(aperture)
    rows = tuple(((name, ""), *published, *cells[name]) for name, published in PUBLISHED.items())
    tables = [TextTable("Table 5.1 of the thesis, and here", HEADER, rows)]
    sections: list[Section] = [
        ("Missing runs", _missing(folder, cells), "red"),
        ("Notes on Table 5.1", NOTES, "dim"),
    ]
    if aperture is not None:
        lines = [*failures(aperture), *origins(aperture)]
        sections.append(("Runs of the suite aperture", lines, "dim"))
    if push is not None:
        by_label, more = adaptation_tables(push, make_suite("push").labels)
        tables += by_label
        sections += [(f"{title} of the suite push", lines, style) for title, lines, style in more]
    return tables, sections


def _frame(folder: Path, suite: str, protocol: str) -> pd.DataFrame | None:
    """Return the runs of a suite, one row each; None where there are none.

    :raises BenchmarkError: runs of another protocol
    """
    records = records_of(folder, suite, protocol, "Table 5.1")
    if not records:
        return None
    return adaptation_frame(records) if suite == "push" else stream_frame(records)


def records_of(folder: Path, suite: str, protocol: str, table: str) -> list[Record]:
    """Return the runs of a suite, none where its folder holds none.

    :param folder: that holds the suites' folders
    :param suite: its name
    :param protocol: the name of the protocol that they must have
    :param table: for the message
    :raises BenchmarkError: runs of another protocol
    """
    records = read_records(folder / suite)
    others = {record["specification"]["protocol"]["name"] for record in records} - {protocol}
    if others:
        raise BenchmarkError(
            f"'{folder / suite}' holds runs of the protocol {', '.join(sorted(others))}; "
            f"{table} needs {protocol} runs of the suite {suite}."
        )
    return records


def _push_cells(runs: pd.DataFrame | None) -> dict[str, tuple[Cell, ...]]:
    """Return ours and the baseline's cells of the row about pushing."""
    labels = (OURS, THEIRS["push"])
    name = next(iter(PUBLISHED))
    if runs is None:
        return {name: tuple((NOT_RUN, "") for _ in labels)}
    summary = summarise_adaptation(runs, labels)
    extrapolation = summary.loc[summary["kind"] == "extrapolation"]
    by_label = {str(row["label"]): row for row in extrapolation.to_dict("records")}
    missing = {"reason": NOT_RUN}
    return {name: tuple(_push_cell(by_label.get(label, missing)) for label in labels)}


def _push_cell(row: Mapping[Any, Any]) -> Cell:
    if row["reason"]:
        return row["reason"], ""
    median = rollouts_text(row["greedy_rollouts_median"], row["budget"])
    return median, f"(worst {rollouts_text(row['rollouts_worst'], row['budget'])})"


def _aperture_cells(runs: pd.DataFrame | None) -> dict[str, tuple[Cell, ...]]:
    """Return ours and the baseline's cells of the rows about the aperture."""
    names = list(PUBLISHED)[1:]
    labels = (OURS, THEIRS["aperture"])
    if runs is None:
        return {name: tuple((NOT_RUN, "") for _ in labels) for name in names}
    by_label = {str(row["label"]): row for row in summarise_stream(runs, labels).to_dict("records")}
    columns = [_aperture_column(by_label[label]) for label in labels]
    return dict(zip(names, zip(*columns, strict=True), strict=True))


def _aperture_column(row: Mapping[Any, Any]) -> tuple[Cell, ...]:
    if row["reason"]:
        return ((row["reason"], ""),) * 3
    return (
        (f"{row['most_rollouts']:.0f}", ""),
        (f"{row['rollouts']:.0f}", f"(in {row['contexts']:.0f})"),
        failure_text(row, "failure_rate"),
    )


def _missing(folder: Path, cells: Mapping[str, Sequence[Cell]]) -> list[str]:
    """Return a line for each suite that leaves a cell empty: how to fill it."""
    empty = {
        name.partition(":")[0]
        for name, row in cells.items()
        if any(cell[0] in (NOT_RUN, FAILED) for cell in row)
    }
    suites = {"pushing": "push", "aperture": "aperture"}
    return [f"{what}: {command(folder, suites[what])}" for what in suites if what in empty]


def command(folder: Path, suite: str) -> str:
    """Return the command that makes a suite's runs.

    :param folder: that holds the suites' folders
    :param suite: its name
    """
    default = folder == Path("results/runs")
    return f"nmp-bench run --suite {suite}" + ("" if default else f" --out {folder / suite}")
