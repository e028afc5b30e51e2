"""``nmp-bench leaderboard``: show the committed rows, make them, check and verify them."""

import argparse
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the command line answers at once: what is slow to import waits
    from results.harness.specification import RunSpecification
    from results.leaderboard.check import Judgement
    from results.leaderboard.exact import Comparison
    from results.leaderboard.rows import Claim, Evidence, Row

HOLDS, FAILS = 0, 1
RUNS = Path("results/runs/leaderboard")
WHAT = {
    "show": "print the rows",
    "update": "do the runs that are missing, and write rows from them",
    "check": "do some runs again; fail where the program has become worse than a row",
    "verify": "simulate every stored trajectory; fail where it does not earn what is claimed",
}


def add_leaderboard(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands' arguments.

    :param parser: of ``nmp-bench leaderboard``
    """
    parser.description = "; ".join(f"{name}: {text}" for name, text in WHAT.items()) + "."
    parser.set_defaults(command=leaderboard)
    parser.add_argument("what", choices=WHAT, help="what to do")
    parser.add_argument("--board", nargs="+", metavar="NAME", help="only these (default: all)")
    parser.add_argument(
        "--algorithms", nargs="+", metavar="LABEL", help="only these rows (default: all)"
    )
    parser.add_argument(
        "--workers", type=int, metavar="N", help="parallel processes (default: one per core)"
    )
    parser.add_argument(
        "--out", type=Path, default=RUNS, metavar="DIR", help="of the runs (default: %(default)s)"
    )
    parser.add_argument(
        "--against", metavar="LABEL", help="show: by how much each row is above that one, in pairs"
    )
    parser.add_argument("--overwrite", action="store_true", help="update: do finished runs again")
    parser.add_argument(
        "--exact",
        action="store_true",
        help="check: one seed of each row, to the bit; fail where anything has changed",
    )
    parser.add_argument(
        "--data", type=Path, metavar="DIR", help="of the rows (default: those of this repository)"
    )


def leaderboard(options: argparse.Namespace) -> int:
    """Do ``nmp-bench leaderboard``.

    :param options: the parsed arguments
    """
    from results.exceptions import BenchmarkError
    from results.leaderboard.boards import BOARDS, DATA, find_board

    if options.overwrite and options.what != "update":
        raise BenchmarkError(
            f"--overwrite goes with update, which does runs and keeps them; "
            f"{options.what} keeps none."
        )
    if options.exact and options.what != "check":
        raise BenchmarkError(f"--exact goes with check, which does runs again; not {options.what}.")
    if options.against and options.what != "show":
        raise BenchmarkError(f"--against goes with show, which compares rows; not {options.what}.")
    boards = {name: find_board(name) for name in options.board or BOARDS}
    data = options.data or DATA
    doing = {"show": _show, "update": _update, "check": _check, "verify": _verify}
    return doing[options.what](boards, data, options)


def _rows(boards: dict[str, Any], data: Path, options: argparse.Namespace) -> list[Path]:
    """Return the files of the rows that are meant."""
    from results.exceptions import BenchmarkError
    from results.leaderboard.files import row_path, row_paths

    paths = [path for name in boards for path in row_paths(data, name)]
    if options.algorithms is not None:
        named = [
            row_path(data, name, run.label)
            for name, board in boards.items()
            for run in board.runs(name, options.algorithms, 1)
        ]
        paths = [path for path in paths if path in named]
    if not paths:
        raise BenchmarkError(
            f"'{data}' holds no such row; make some with 'nmp-bench leaderboard update'."
        )
    return paths


def _show(boards: dict[str, Any], data: Path, options: argparse.Namespace) -> int:
    from rich.console import Console

    from results.leaderboard.against import against
    from results.leaderboard.files import read_row
    from results.leaderboard.tables import page

    console = Console(highlight=False)
    rows = [read_row(path)[0] for path in _rows(boards, data, options)]
    shown = against(rows, options.against) if options.against else page(rows)
    console.print(shown.terminal(console.width))
    return HOLDS


def _update(boards: dict[str, Any], data: Path, options: argparse.Namespace) -> int:
    """Do all runs first: a row among the committed ones would make those after it of no commit."""
    from results.harness.progress import run_with_progress
    from results.harness.resume import plan_runs

    status = HOLDS
    for name, board in boards.items():
        runs = board.runs(name, options.algorithms)
        plan = plan_runs(options.out / name, runs, options.overwrite)
        status = run_with_progress(plan, options.workers) or status
    return _write_rows(boards, data, options) or status


def _write_rows(boards: dict[str, Any], data: Path, options: argparse.Namespace) -> int:
    """Write the rows of which all runs have finished, and the page of all rows."""
    from results.harness.record_files import read_records
    from results.harness.whole_files import write_whole
    from results.leaderboard.files import read_row, row_paths, write_row
    from results.leaderboard.rows import make_row
    from results.leaderboard.tables import page

    status = HOLDS
    for name, board in boards.items():
        found = {r.specification.stem: r for r in read_records(options.out / name).records}
        runs = board.runs(name, options.algorithms)
        for label in dict.fromkeys(run.label for run in runs):
            records = [found.get(run.stem) for run in runs if run.label == label]
            done = [record for record in records if record is not None and record.finished]
            if len(done) < len(records):
                print(f"{name}, {label}: not all runs have finished; no row", file=sys.stderr)
                status = FAILS
                continue
            print(f"Written: {write_row(data, *make_row(name, done, board.most_failures))}")
    rows = [read_row(path)[0] for path in row_paths(data)]
    if rows:
        text = f"# Leaderboard\n\n{page(rows).markdown()}"
        write_whole({data / "README.md": text.encode()})
    return status


def _verify(boards: dict[str, Any], data: Path, options: argparse.Namespace) -> int:
    from results.leaderboard.verify import missing_rows, verify_row

    status, unchecked = HOLDS, dict[str, list[str]]()
    for problem in missing_rows(data, boards) if options.algorithms is None else ():
        status = FAILS
        print(problem, file=sys.stderr)
    for path in _rows(boards, data, options):
        verdict = verify_row(path)
        print(f"{verdict.name}: {'holds' if not verdict.problems else 'FAILS'} ({verdict.how})")
        for problem in verdict.problems:
            status = FAILS
            print(f"{verdict.name}: {problem}", file=sys.stderr)
        for told in verdict.unchecked:
            unchecked.setdefault(told, []).append(verdict.name)
    for told, names in unchecked.items():
        print(f"Not checked: {told}. It concerns {', '.join(names)}.")
    return status


def _check(boards: dict[str, Any], data: Path, options: argparse.Namespace) -> int:
    status, paths = HOLDS, _rows(boards, data, options)
    if options.exact:
        for comparison in comparisons(boards, paths, options.workers):
            print(comparison.sentence(), flush=True)
            status = FAILS if comparison.changed else status
        return status
    for judgement in judgements(boards, paths, options.workers):
        print(judgement.sentence(), flush=True)
        status = FAILS if judgement.worse() else status
    return status


def comparisons(
    boards: dict[str, Any], paths: list[Path], n_workers: int | None
) -> "Iterator[Comparison]":
    """Do one seed of rows again, and compare it to the bit where the machine allows it.

    :param boards: by name
    :param paths: of the rows' claims, board by board
    :param n_workers: processes; one per core by default
    """
    from results.leaderboard.exact import Comparison, compare, name_of, unlike

    for name, group in groupby(map(_read, paths), key=lambda each: each[0].board):
        rows = [row for row, _ in group]
        why = {row.label: unlike(row) for row in rows}
        alike = [label for label, reason in why.items() if not reason]
        runs = boards[name].runs(name, alike, 1) if alike else ()
        again = _claims_again(boards[name], runs, n_workers)
        for row in rows:
            reason = why[row.label]
            unknown = Comparison(name_of(row), reason, (), 0)
            yield unknown if reason else compare(row, again[row.label])


def judgements(
    boards: dict[str, Any], paths: list[Path], n_workers: int | None, n_rows: int | None = None
) -> "Iterator[Judgement]":
    """Do some runs of rows again, and yield what came of each row.

    The very first of each row, and the others only where its bits are others, or cannot be the same
    on this machine. That alarms less often than all of them at once, so false alarms stay as rare.

    :param boards: by name
    :param paths: of the rows' claims, board by board
    :param n_workers: processes; one per core by default
    :param n_rows: of the whole check, for which p-values are corrected; these by default
    """
    from results.leaderboard.check import judge
    from results.leaderboard.exact import compare, unlike

    for name, group in groupby(map(_read, paths), key=lambda each: each[0].board):
        rows = list(group)
        most = {
            row.label: boards[name].runs(name, [row.label], n)
            for row, _ in rows
            if (n := boards[name].n_again(row.label))
        }
        whole = {row.label for row, _ in rows if row.label in most and unlike(row)}
        first = [
            run for label, runs in most.items() for run in runs[: None if label in whole else 1]
        ]
        again = _claims_again(boards[name], first, n_workers)
        changed = [
            row.label
            for row, _ in rows
            if row.label not in whole and compare(row, again[row.label]).changed
        ]
        more = [run for label in changed for run in most[label]]
        again |= _claims_again(boards[name], more, n_workers)
        for row, evidence in rows:
            yield judge(row, evidence, again[row.label], n_rows or len(paths))


def _read(path: Path) -> "tuple[Row, Evidence]":
    """Return a row and its evidence."""
    from results.leaderboard.files import read_row

    row, evidence, _ = read_row(path)
    return row, evidence


def _claims_again(
    board: Any,  # noqa: ANN401
    runs: "Sequence[RunSpecification]",
    n_workers: int | None,
) -> "defaultdict[str, list[Claim]]":
    """Return the claims of runs, done again, by label; all are spread over the processes.

    :param board: whose runs
    :param runs: of any of its rows
    :param n_workers: processes; one per core by default
    """
    from results.harness.resume import plan_runs
    from results.harness.runner import run_plan
    from results.leaderboard.rows import claim_of

    claims: defaultdict[str, list[Claim]] = defaultdict(list)
    if not runs:
        return claims
    with tempfile.TemporaryDirectory(prefix="nmp-bench-") as folder:
        for outcome in run_plan(plan_runs(Path(folder), tuple(runs)), n_workers):
            record = outcome.record
            claims[record.specification.label].append(claim_of(record, board.most_failures))
    return claims
