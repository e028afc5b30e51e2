"""``nmp-bench leaderboard``: show the committed rows, make them, check and verify them."""

import argparse
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the command line answers at once: what is slow to import waits
    from results.harness.records import Provenance, RunRecord
    from results.harness.specification import RunSpecification
    from results.leaderboard.check import Judgement
    from results.leaderboard.exact import Comparison
    from results.leaderboard.rows import Claim, Evidence, Row

Key = tuple[str, str]  # board and label of a row
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
        "--algorithms",
        nargs="+",
        metavar="LABEL",
        help="only these rows, where a board has them (default: all)",
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
    from results.leaderboard.boards import labels_on
    from results.leaderboard.files import row_path, row_paths

    paths = [path for name in boards for path in row_paths(data, name)]
    if options.algorithms is not None:
        meant = labels_on(boards, options.algorithms)
        named = {row_path(data, name, label) for name in meant for label in meant[name]}
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
    from results.leaderboard.boards import labels_on

    status = HOLDS
    for name, labels in labels_on(boards, options.algorithms).items():
        runs = boards[name].runs(name, labels)
        plan = plan_runs(options.out / name, runs, options.overwrite)
        status = run_with_progress(plan, options.workers) or status
    return _write_rows(boards, data, options) or status


def _write_rows(boards: dict[str, Any], data: Path, options: argparse.Namespace) -> int:
    """Write the rows of which all runs have finished, and the page of all rows."""
    from results.harness.record_files import read_records
    from results.harness.whole_files import write_whole
    from results.leaderboard.boards import labels_on
    from results.leaderboard.files import read_row, row_paths, write_row
    from results.leaderboard.rows import make_row
    from results.leaderboard.tables import page

    status = HOLDS
    for name, labels in labels_on(boards, options.algorithms).items():
        board = boards[name]
        found = {r.specification.stem: r for r in read_records(options.out / name).records}
        runs = board.runs(name, labels)
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
    from results.leaderboard.boards import labels_on
    from results.leaderboard.verify import missing_rows, verify_row

    status, unchecked = HOLDS, dict[str, list[str]]()
    for problem in missing_rows(data, labels_on(boards, options.algorithms)):
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
    :param paths: of the rows' claims
    :param n_workers: processes; one per core by default
    """
    from results.leaderboard.exact import Comparison, compare, name_of, unlike

    rows = {(row.board, row.label): row for row, _ in map(_read, paths)}
    runs: dict[Key, Sequence[RunSpecification]] = {}
    for (board, label), row in rows.items():
        if reason := unlike(row):
            yield Comparison(name_of(row), reason, (), 0)
        else:
            runs[board, label] = boards[board].runs(board, [label], 1)
    for key, claims in _claims_again(boards, runs, n_workers):
        yield compare(rows[key], claims)


def judgements(
    boards: dict[str, Any], paths: list[Path], n_workers: int | None, n_rows: int | None = None
) -> "Iterator[Judgement]":
    """Do some runs of rows again, and yield what came of each row, as soon as it is known.

    The very first of each row, and the others only where its bits are others, or cannot be the same
    on this machine. That alarms less often than all of them at once, so false alarms stay as rare.

    :param boards: by name
    :param paths: of the rows' claims
    :param n_workers: processes; one per core by default
    :param n_rows: of the whole check, for which p-values are corrected; these by default
    """
    from results.leaderboard.check import judge
    from results.leaderboard.exact import compare, unlike

    rows = {(row.board, row.label): (row, evidence) for row, evidence in map(_read, paths)}
    n_rows = n_rows or len(rows)
    most: dict[Key, Sequence[RunSpecification]] = {}
    for (board, label), (row, evidence) in rows.items():
        if n_seeds := boards[board].n_again(label):
            most[board, label] = boards[board].runs(board, [label], n_seeds)
        else:
            yield judge(row, evidence, [], n_rows)
    whole = {key for key in most if unlike(rows[key][0])}
    first = {key: runs if key in whole else runs[:1] for key, runs in most.items()}
    changed: dict[Key, Sequence[RunSpecification]] = {}
    for key, claims in _claims_again(boards, first, n_workers):
        if key not in whole and compare(rows[key][0], claims).changed:
            changed[key] = most[key]
        else:
            yield judge(*rows[key], claims, n_rows)
    for key, claims in _claims_again(boards, changed, n_workers):
        yield judge(*rows[key], claims, n_rows)


def _read(path: Path) -> "tuple[Row, Evidence]":
    """Return a row and its evidence."""
    from results.leaderboard.files import read_row

    row, evidence, _ = read_row(path)
    return row, evidence


def _claims_again(
    boards: dict[str, Any], runs: "Mapping[Key, Sequence[RunSpecification]]", n_workers: int | None
) -> "Iterator[tuple[Key, list[Claim]]]":
    """Do runs again, and yield a row's claims as soon as it has all of them.

    All runs of all boards are spread over the processes, those of large budgets first.

    :param boards: by name
    :param runs: by row
    :param n_workers: processes; one per core by default
    """
    from results.leaderboard.rows import claim_of

    claims: dict[Key, list[Claim]] = {key: [] for key in runs}
    asked = [(key, run) for key, each in runs.items() for run in each]
    asked.sort(key=lambda one: -one[1].budget)
    for key, record in _records_again(asked, n_workers):
        claims[key].append(claim_of(record, boards[key[0]].most_failures))
        if len(claims[key]) == len(runs[key]):
            yield key, claims[key]


def _records_again(
    asked: "Sequence[tuple[Key, RunSpecification]]", n_workers: int | None
) -> "Iterator[tuple[Key, RunRecord]]":
    """Do runs in a folder that is removed, and yield the record of each as soon as it has ended.

    :param asked: of which row each run is
    :param n_workers: processes; one per core by default
    """
    from joblib import delayed

    from results.harness.processes import in_processes
    from results.harness.provenance import provenance

    if not asked:
        return
    origin = provenance()
    with tempfile.TemporaryDirectory(prefix="nmp-bench-") as folder:
        jobs = (delayed(_record_of)(key, run, Path(folder), origin) for key, run in asked)
        yield from in_processes(jobs, len(asked), n_workers)


def _record_of(
    key: Key, run: "RunSpecification", folder: Path, origin: "Provenance"
) -> "tuple[Key, RunRecord]":
    """Do a run of a row, in a folder for each board: two may have runs of one name."""
    from results.harness.runner import run_and_write

    (folder / key[0]).mkdir(exist_ok=True)
    return key, run_and_write(run, folder / key[0], origin).record
