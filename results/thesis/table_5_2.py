"""The thesis's Table 5.2 beside our numbers, from the suites pick-and-place and pouring."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from results.adaptation.summary import error_after
from results.adaptation.tables import error_text
from results.harness.records import RunRecord
from results.report.text_table import NOT_APPLICABLE, Cell, Page, Section, TextTable
from results.thesis.suite_runs import OURS, by_algorithm, missing_runs, records_of

SUITES = ("pick-and-place", "pouring")
#: which rollout of a record is whose, and which row of its curve tells of it
METHODS = {"CNMP": ("untrained", 0), OURS: ("greedy", -1)}

#: mean joint errors in degrees, by method and number of the context (thesis, Table 5.2, left)
PUBLISHED_JOINT_ERRORS = {
    ("CNMP", 0): (1.038, 2.325, 8.879, 8.094, 0.360, 0.830),
    (OURS, 0): (0.889, 1.589, 4.668, 3.465, 0.845, 0.861),
    ("CNMP", 1): (1.861, 5.380, 17.978, 14.894, 0.590, 1.386),
    (OURS, 1): (0.994, 0.507, 1.780, 1.514, 0.814, 1.007),
}
#: errors in g of rollouts 1 to 18 in one run (thesis, Table 5.2, right)
PUBLISHED_POURING = (
    591, 447, 435, 175, 511, 604, 305, 42, 417, 284, 144, 194, 367, 364, 79, 177, 133, 27,
)  # fmt: skip
NOTES = (
    "joint errors: mean absolute difference from the expert's trajectory over the whole time in "
    "degrees, mean over seeds; the thesis's figure in parentheses. The expert here is ours, so "
    "compare CNMP with ACNMP, not number by number with the thesis. solved: runs whose trajectory "
    "carries the object over the tower and puts it down, after the budget of the suite.",
    "pouring: the thesis's column is the error of each rollout of its one run; ours is that of "
    "the best of so many rollouts, median and worst over seeds.",
)


def table(folder: Path) -> Page:
    """Return both halves of the table, the tables of the suites by algorithm, and notes.

    :param folder: that holds the suites' folders ``pick-and-place`` and ``pouring``
    :raises BenchmarkError: neither holds any run, or one holds runs of another protocol
    """
    records = {suite: records_of(folder, suite, "extrapolation", "Table 5.2") for suite in SUITES}
    found = {suite for suite in SUITES if records[suite]}
    missing = missing_runs(folder, SUITES, found, "Table 5.2")
    ours = {suite: [run for run in runs if _is_ours(run)] for suite, runs in records.items()}
    tables: list[TextTable] = []
    if ours["pick-and-place"]:
        tables.append(joint_errors(ours["pick-and-place"]))
    if ours["pouring"]:
        tables.append(pouring_errors(ours["pouring"]))
    sections = [Section("Missing runs", missing, "red"), Section("Notes", NOTES, "dim")]
    for suite, runs in records.items():
        page = by_algorithm(suite, runs)
        tables += page.tables
        sections += page.sections
    return Page(tables, sections)


def joint_errors(records: Sequence[RunRecord]) -> TextTable:
    """Return the left half: joint errors of CNMP and ACNMP in degrees.

    :param records: finished runs of ACNMP on pick-and-place
    """
    joints = [name.removesuffix(" [rad]") for name in records[0].task.trajectory_names]
    numbers = sorted({number_of(run) for run in records})
    rows = [
        _joint_row(
            method, number, [r for r in records if r.specification.protocol.number == number]
        )
        for number in numbers
        for method in METHODS
    ]
    header = ("", "solved", *joints)
    return TextTable("Table 5.2, left: joint errors in degrees, here (thesis)", header, tuple(rows))


def _joint_row(method: str, number: int, runs: Sequence[RunRecord]) -> tuple[Cell, ...]:
    """Return the errors of one method in one context."""
    key, row = METHODS[method]
    found, expert = (
        np.array([run.measured.rollouts[name].trajectory for run in runs])
        for name in (key, "expert")
    )
    context = runs[0].measured.context
    heights = " and ".join(f"{100 * height:g}" for height in (context.values if context else ()))
    mean = mean_joint_errors(found, expert[0])
    published = PUBLISHED_JOINT_ERRORS[method, number]
    cells = ((f"{here:.2f}", f"({there:.2f})") for here, there in zip(mean, published, strict=True))
    n_solved = sum(run.curve["greedy_success"][row] for run in runs)
    return ((method, f"{heights} cm"), (f"{n_solved}/{len(runs)}", ""), *cells)


def mean_joint_errors(
    trajectories: NDArray[np.float64], expert: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return mean absolute differences over runs and time in degrees, shape (D,).

    :param trajectories: shape (N, T, D) in rad
    :param expert: shape (T, D) in rad
    """
    return np.degrees(np.abs(trajectories - expert).mean(axis=(0, 1)))


def pouring_errors(records: Sequence[RunRecord]) -> TextTable:
    """Return the right half: the error of pouring in g by rollout.

    :param records: finished runs of ACNMP on pouring; only context 0, the thesis's, is shown
    """
    runs = [record for record in records if number_of(record) == 0]
    rows: list[tuple[Cell, ...]] = []
    for count, published in enumerate(PUBLISHED_POURING, start=1):
        errors = [
            error_after(record.curve, count, record.specification.budget, "best_reward")
            for record in runs
        ]
        known = np.array(errors, np.float64)
        here = NOT_APPLICABLE if not len(known) else error_text(float(np.median(known)))
        worst = "" if not len(known) else f"(worst {error_text(float(known.max()))})"
        rows.append(((str(count), ""), (str(published), ""), (here, worst)))
    header = ("rollouts", "thesis [g]", "here [g]")
    title = f"Table 5.2, right: error in pouring 1322 of 1400 g, {len(runs)} seeds here"
    return TextTable(title, header, tuple(rows))


def number_of(record: RunRecord) -> int:
    """Return the number of a run's context.

    :param record: of the run
    """
    return record.specification.protocol.number or 0


def _is_ours(record: RunRecord) -> bool:
    return record.finished and record.specification.label == OURS
