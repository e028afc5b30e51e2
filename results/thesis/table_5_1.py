"""Table 5.1: rollouts of ACNMP and of two ProMP+RL methods, pushing and through apertures."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from results.adaptation import summary as adaptation_summary
from results.harness.records import RunRecord, labels_of
from results.report.footnotes import failures, origins, rollouts_text
from results.report.text_table import NOT_APPLICABLE, Cell, Page, Section, TextTable
from results.stream import summary as stream_summary
from results.stream.tables import failure_text
from results.thesis.interface import Finding, Records, ThesisFigure
from results.thesis.push_and_aperture import FULL, QUICK
from results.thesis.suite_runs import OURS, by_algorithm, command, missing_runs, records_of

HEADER = ("", "ACNMP\nthesis", "ProMP+RL\nthesis", "ACNMP\nhere", "ProMP+RL\nhere")
SUITES = ("push", "aperture")
PROTOCOLS = {"push": "leave-one-out", "aperture": "stream"}
#: the baseline of the thesis in each suite
BASELINES = {"push": "ProMP+RL (Stark)", "aperture": "ProMP+RL (Ewerton)"}
NOT_RUN = "not run"
#: what is an order of magnitude, and the price of the thesis's stored network's failure rate
TENFOLD, PRICE = 10.0, "rollouts_to_0.0906_median"

Suite = Literal["push", "aperture"]
Row = Mapping[Hashable, Any]


@dataclass(frozen=True)
class Line:
    """One row of the table.

    :param name: what it is about
    :param suite: whose runs give our numbers
    :param acnmp: the thesis's number of ACNMP
    :param promp: the thesis's number of ProMP+RL
    """

    name: str
    suite: Suite
    acnmp: Cell
    promp: Cell

    def here(self, row: Row | None) -> Cell:
        """Return our cell.

        :param row: of an algorithm's summary; None where it has no runs
        """
        if row is None:
            return NOT_RUN, ""
        return (row["reason"], "") if row["reason"] else CELLS[self.name](row)


def _adaptation(row: Row) -> Cell:
    median = rollouts_text(row["greedy_rollouts_median"], row["budget"])
    return median, f"(worst {rollouts_text(row['rollouts_worst'], row['budget'])})"


PUSHING = "pushing: rollouts to adapt to a new target"
IN_ONE = "aperture: rollouts in a single environment"
IN_ALL = "aperture: rollouts in all"
FAILING = "aperture: unseen environments that fail"
CELLS = {
    PUSHING: _adaptation,
    IN_ONE: lambda row: (f"{row['most_rollouts']:.0f}", ""),
    IN_ALL: lambda row: (f"{row['rollouts']:.0f}", f"(in {row['contexts']:.0f})"),
    FAILING: lambda row: failure_text(row, "failure_rate"),
}
LINES = (
    Line(PUSHING, "push", ("130", ""), ("1200", "[Stark et al.]")),
    Line(IN_ONE, "aperture", ("1.4K", ""), ("20K", "[Ewerton et al.]")),
    Line(IN_ALL, "aperture", ("0.7M", ""), ("10M", "[Ewerton et al.]")),
    Line(FAILING, "aperture", ("9.06 %", "(stored run)"), (NOT_APPLICABLE, "")),
)
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


def table(folder: Path) -> Page:
    """Return the table, the tables of the suite push, and notes.

    A cell without runs tells why, and a note which command makes them.

    :param folder: that holds the suites' folders ``push`` and ``aperture``
    :raises BenchmarkError: neither holds any run, or one holds runs of another protocol
    """
    records = {s: records_of(folder, s, PROTOCOLS[s], "Table 5.1") for s in SUITES}
    missing_runs(folder, SUITES, {suite for suite in SUITES if records[suite]}, "Table 5.1")
    cells, made = _cells_and_table(records)
    empty = [suite for suite in SUITES if _has_gap(suite, cells)]
    sections = [
        Section("Missing runs", [f"{suite}: {command(folder, suite)}" for suite in empty], "red"),
        Section("Notes on Table 5.1", NOTES, "dim"),
    ]
    if records["aperture"]:
        runs = stream_summary.frame(records["aperture"])
        lines = [*failures(runs), *origins(runs)]
        sections.append(Section("Runs of the suite aperture", lines, "dim"))
    more = by_algorithm("push", records["push"])
    return Page([made, *more.tables], [*sections, *more.sections])


def _cells_and_table(records: Records) -> tuple[list[list[Cell]], TextTable]:
    """Return our cells, line by line, and the table of theirs and ours."""
    rows = _rows(records)
    cells = [
        [line.here(rows[line.suite].get(label)) for label in (OURS, BASELINES[line.suite])]
        for line in LINES
    ]
    text = tuple(
        ((line.name, ""), line.acnmp, line.promp, *here)
        for line, here in zip(LINES, cells, strict=True)
    )
    return cells, TextTable("Table 5.1 of the thesis, and here", HEADER, text)


def _rows(records: Records) -> dict[str, dict[str, Row]]:
    """Return the algorithms' summaries by suite and label."""
    return {"push": _push_rows(records["push"]), "aperture": _aperture_rows(records["aperture"])}


def _push_rows(records: Sequence[RunRecord]) -> dict[str, Row]:
    """Return the summary beyond the demonstrations by label."""
    if not records:
        return {}
    summary = adaptation_summary.summarise(adaptation_summary.frame(records), labels_of(records))
    beyond = summary.loc[summary["kind"] == "extrapolation"]
    return {str(row["label"]): row for row in beyond.to_dict("records")}


def _aperture_rows(records: Sequence[RunRecord]) -> dict[str, Row]:
    """Return the summary by label."""
    if not records:
        return {}
    summary = stream_summary.summarise(stream_summary.frame(records), labels_of(records))
    return {str(row["label"]): row for row in summary.to_dict("records")}


def _has_gap(suite: str, cells: Sequence[Sequence[Cell]]) -> bool:
    """Tell whether a cell of a suite's lines has no number."""
    of_suite = (here for line, here in zip(LINES, cells, strict=True) if line.suite == suite)
    return any(cell[0] in (NOT_RUN, "failed") for here in of_suite for cell in here)


def findings(records: Records) -> list[Finding]:
    """Return whether ACNMP needs fewer rollouts, and whether ten times fewer, line by line.

    :param records: of the suites push and aperture
    """
    rows = _rows(records)
    numbers = (
        (PUSHING, "push", "greedy_rollouts_median", "130 and 1200"),
        (IN_ONE, "aperture", "most_rollouts", "1.4K and 20K"),
        (f"{IN_ALL} until 9.06 % fail", "aperture", PRICE, "0.7M and 10M"),
    )
    found = []
    for name, suite, key, thesis in numbers:
        ours, theirs = (float(rows[suite][label][key]) for label in (OURS, BASELINES[suite]))
        here = f"{ours:g} and {theirs:g}"
        found += [
            Finding(f"fewer rollouts than ProMP+RL; {name}", thesis, here, ours < theirs),
            Finding(
                f"an order of magnitude fewer; {name}", thesis, here,
                bool(np.isfinite(ours)) and TENFOLD * max(ours, 1.0) <= theirs,
            ),
        ]  # fmt: skip
    return found


FIGURE = ThesisFigure(
    "table-5.1",
    " ".join(NOTES),
    full=FULL,
    quick=QUICK,
    findings=findings,
    tables=lambda records: [_cells_and_table(records)[1]],
)
