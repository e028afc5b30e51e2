"""Table 5.2: joint errors of pick-and-place, and raw errors of pouring, rollout by rollout."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from results.adaptation.summary import error_after
from results.adaptation.tables import error_text
from results.harness.records import RunRecord
from results.report.statistics import quantile
from results.report.text_table import NOT_APPLICABLE, Cell, Page, Section, TextTable
from results.thesis.interface import Finding, Records, ThesisFigure, chosen
from results.thesis.real_robot_runs import (
    AMOUNT,
    HEIGHTS,
    PICK_AND_PLACE,
    PLACED,
    POURED,
    POURING,
    QUICK_PLACED,
    QUICK_POURED,
    TWIN,
    heights_text,
)
from results.thesis.suite_runs import OURS, by_algorithm, missing_runs, records_of

SUITES = (PICK_AND_PLACE, POURING)
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
    "pouring: raw errors, of each rollout by itself, of the thesis's one run and of ours, median "
    "and worst over seeds; best: of the best of so many rollouts.",
)
MADE = " ".join(NOTES)
#: rollouts that are compared with each other: the first four and the last four
FIRST, LAST = slice(0, 4), slice(14, 18)
#: g; the error at which the thesis's run ends
ENOUGH = 27


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
    heights = heights_text(runs[0])
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
    runs = [record for record in records if number_of(record) == AMOUNT]
    raw = [errors for run in runs if len(errors := raw_errors(run)) >= len(PUBLISHED_POURING)]
    rows: list[tuple[Cell, ...]] = []
    for count, published in enumerate(PUBLISHED_POURING, start=1):
        best = [
            error_after(record.curve, count, record.specification.budget, "best_reward")
            for record in runs
        ]
        cells = (_median_and_worst(values) for values in ([e[count - 1] for e in raw], best))
        rows.append(((str(count), ""), (str(published), ""), *cells))
    header = ("rollout", "thesis [g]", "here [g]", "best [g]")
    title = f"Table 5.2, right: error in pouring 1322 of 1400 g, {len(runs)} seeds here"
    return TextTable(title, header, tuple(rows))


def raw_errors(record: RunRecord) -> list[float]:
    """Return the error of each rollout of a run; empty where its record is too old to tell.

    :param record: of a finished run
    """
    return [0.0 - reward for reward in record.measured.more.get("rewards", ())]


def _median_and_worst(values: Sequence[float]) -> Cell:
    if not values:
        return NOT_APPLICABLE, ""
    return error_text(quantile(values, 0.5)), f"(worst {error_text(max(values))})"


def number_of(record: RunRecord) -> int:
    """Return the number of a run's context.

    :param record: of the run
    """
    return record.specification.protocol.number or 0


def _is_ours(record: RunRecord) -> bool:
    return record.finished and record.specification.label == OURS


def findings(records: Records) -> list[Finding]:
    """Return the claims of both halves.

    :param records: of `PICK_AND_PLACE` and `POURING`
    """
    placed = records[PICK_AND_PLACE]
    left = [f for n in HEIGHTS for f in _about_joints(chosen(placed, OURS, number=n), n)]
    poured = {label: chosen(records[POURING], label, number=AMOUNT) for label in (OURS, TWIN)}
    return [*left, _about_rollouts(poured), *_about_raw_errors(poured[OURS])]


def _about_joints(runs: Sequence[RunRecord], number: int) -> list[Finding]:
    """Return whether ACNMP solves a context and is nearer to the expert than CNMP there."""
    expert = np.array(runs[0].measured.rollouts["expert"].trajectory)
    solved, here, there = {}, {}, {}
    for method, (key, row) in METHODS.items():
        found = np.array([run.measured.rollouts[key].trajectory for run in runs])
        solved[method] = sum(bool(run.curve["greedy_success"][row]) for run in runs)
        here[method] = float(mean_joint_errors(found, expert).mean())
        there[method] = float(np.mean(PUBLISHED_JOINT_ERRORS[method, number]))
    where = f"{heights_text(runs[0])} cm"
    return [
        Finding(
            f"ACNMP adapts to {where}, CNMP alone fails", "shown",
            f"{solved[OURS]} and {solved['CNMP']} of {len(runs)} runs solve it",
            solved[OURS] == len(runs) and solved["CNMP"] == 0,
        ),
        Finding(
            f"its joint errors are smaller there, mean over the joints ({where})",
            f"{there['CNMP']:.2f} and {there[OURS]:.2f} degrees",
            f"{here['CNMP']:.2f} and {here[OURS]:.2f} degrees", here[OURS] < here["CNMP"],
        ),
    ]  # fmt: skip


def _about_rollouts(poured: dict[str, list[RunRecord]]) -> Finding:
    """Return whether each run pours within `ENOUGH` after the thesis's number of rollouts."""
    needed = {label: [_first_good(run) for run in runs] for label, runs in poured.items()}
    ours = needed[OURS]
    return Finding(
        f"a rollout pours within {ENOUGH} g after at most 18", "18",
        f"median {quantile(ours, 0.5):g}, worst {max(ours):g} in {len(ours)} runs; {TWIN} "
        f"{quantile(needed[TWIN], 0.5):g}, worst {max(needed[TWIN]):g}", max(ours) <= 18,
    )  # fmt: skip


def _first_good(run: RunRecord) -> float:
    """Return the first rollout whose error is at most `ENOUGH`, infinity where none is."""
    best = zip(run.curve["rollouts"], run.curve["best_reward"], strict=True)
    good = (n for n, reward in best if reward is not None and -reward <= ENOUGH)
    return float(next(good, np.inf))


def _about_raw_errors(runs: Sequence[RunRecord]) -> list[Finding]:
    """Return whether raw errors fall, nothing where no record tells them."""
    raw = [errors for run in runs if len(errors := raw_errors(run)) >= len(PUBLISHED_POURING)]
    if not raw:
        return []
    there = [float(np.mean(PUBLISHED_POURING[part])) for part in (FIRST, LAST)]
    here = [float(np.median(np.array(raw)[:, part].mean(axis=1))) for part in (FIRST, LAST)]
    return [
        Finding(
            "raw errors fall: mean of the first four rollouts and of the last four",
            f"{there[0]:.0f} and {there[1]:.0f} g",
            f"{here[0]:.0f} and {here[1]:.0f} g, median of {len(raw)} runs", here[1] < here[0],
        )
    ]  # fmt: skip


def both_halves(records: Records) -> list[TextTable]:
    """Return the table of joint errors and that of raw errors.

    :param records: of `PICK_AND_PLACE` and `POURING`
    """
    placed = chosen(records[PICK_AND_PLACE], OURS)
    return [joint_errors(placed), pouring_errors(chosen(records[POURING], OURS))]


FIGURE = ThesisFigure(
    "table-5.2",
    MADE,
    full=(PLACED, POURED),
    quick=(QUICK_PLACED, QUICK_POURED),
    findings=findings,
    tables=both_halves,
)
