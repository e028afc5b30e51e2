"""``nmp-bench``: run suites, print their tables, draw their plots."""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from results.exceptions import BenchmarkError
from results.exchange.commands import add_export_ioh, add_import_sb3
from results.leaderboard.commands import add_leaderboard
from results.output_commands import add_export, add_import, add_render
from results.suites import check_suite, describe_suites
from results.thesis import NAMES, TABLES, describe
from results.tune import add_tune
from results.web_page import add_report

if TYPE_CHECKING:  # the command line answers at once: what is slow to import waits
    from results.harness.records import RunRecord

RUNS = Path("results/runs")
USAGE_ERROR, INTERRUPTED = 2, 130
COUNTED = {
    "workers": "at least 1 process is needed",
    "together": "1 does each run by itself, more do so many side by side",
}
EXIT_STATUS = (
    "exit status: 0 done (failed runs are listed, kept with their reason, and tried again next "
    "time), 1 every run failed or the file of one cannot be read, 2 wrong usage, 130 interrupted"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status.

    :param arguments: those of the process by default
    """
    options = build_parser().parse_args(arguments)
    command: Callable[[argparse.Namespace], int] = options.command
    try:
        check_counts(options)
        return command(options)
    except KeyboardInterrupt:
        print("\nnmp-bench: interrupted.", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # such as `nmp-bench table | head`
        sys.stderr.close()
        return 0
    except OSError as error:  # such as a full disk, or a folder that may not be written
        where = f" ('{error.filename}')" if error.filename else ""
        print(f"nmp-bench: {error.strerror or error}{where}.", file=sys.stderr)
        return USAGE_ERROR
    except (ValueError, RuntimeError) as error:
        if not _is_usage_error(error):
            raise
        print(f"nmp-bench: {error}", file=sys.stderr)
        return USAGE_ERROR


def _is_usage_error(error: Exception) -> bool:
    """Tell whether an error is the user's to mend, and its message all that there is to say."""
    if "MUJOCO_GL" in str(error):  # MuJoCo cannot be imported then, nor what stands on it
        return True
    from benchmark_envs import RenderingUnavailableError, TaskError

    return isinstance(error, BenchmarkError | TaskError | RenderingUnavailableError)


def build_parser() -> argparse.ArgumentParser:
    """Return the parser; each subcommand stores the function that does it in ``command``."""
    parser = argparse.ArgumentParser(
        prog="nmp-bench",
        description="Benchmark of trajectory-learning algorithms; costs are counted in rollouts.",
        epilog=EXIT_STATUS,
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    _add_run(commands.add_parser("run", help="run a suite", epilog=EXIT_STATUS))
    _add_table(commands.add_parser("table", help="print the table of runs"))
    _add_plot(commands.add_parser("plot", help="draw learning curves and final paths"))
    add_report(commands.add_parser("report", help="write one HTML page about runs"))
    _add_reproduce(commands.add_parser("reproduce", help="make what the thesis shows anew"))
    add_tune(commands.add_parser("tune", help="tune all algorithms of a suite alike"))
    add_leaderboard(
        commands.add_parser("leaderboard", help="the committed rows: show, update, check, verify")
    )
    add_render(commands.add_parser("render", help="draw a run's or a model's rollout"))
    add_export(commands.add_parser("export", help="write a trajectory or a policy for others"))
    add_import_sb3(commands.add_parser("import-sb3", help="take SB3's evaluations.npz as a run"))
    add_export_ioh(commands.add_parser("export-ioh", help="write runs for IOHanalyzer"))
    return parser


def _add_run(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Run a suite in parallel processes, one result file per run. Runs that the folder holds "
        "already are kept, so the same command goes on where an interrupted one stopped."
    )
    parser.set_defaults(command=run)
    told = "; ".join(f"{name}: {line.rstrip('.')}" for name, line in describe_suites().items())
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--suite", default="quick", help=f"{told} (default: quick)")
    what.add_argument("--task", metavar="ID", help="instead of a suite: a task, in one context")
    parser.add_argument(
        "--algorithm", nargs="+", default=[], metavar="NAME", help="on it: names, or module:Class"
    )
    add_import(parser)
    parser.add_argument(
        "--seeds",
        metavar="N|A-B|A,B",
        help="the first N, a range, or a list (default: the suite's)",
    )
    parser.add_argument(
        "--budget", type=int, help="rollouts per run (default: the suite's, or the algorithm's own)"
    )
    parser.add_argument(
        "--algorithms", nargs="+", metavar="LABEL", help="only these (default: all of the suite)"
    )
    parser.add_argument(
        "--workers", type=int, metavar="N", help="parallel processes (default: one per core)"
    )
    parser.add_argument(
        "--backend",
        choices=("processes", "ray"),
        default="processes",
        help="where: processes of this machine, or the Ray cluster that RAY_ADDRESS names "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--together",
        type=int,
        default=1,
        metavar="N",
        help="up to so many runs of an algorithm side by side in a process, networks trained as "
        "one: RC-NMP is faster; all of a group end last (default: %(default)s)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the runs (default: results/runs/SUITE)"
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="do finished runs again, replacing their files"
    )


def _add_read(
    parser: argparse.ArgumentParser, command: Callable[[argparse.Namespace], int]
) -> None:
    parser.description = "The files are written beside the runs."
    parser.set_defaults(command=command)
    parser.add_argument(
        "--suite", help="its folder is results/runs/SUITE (default: quick, unless --runs is given)"
    )
    parser.add_argument("--runs", type=Path, metavar="DIR", help="folder of the runs")


def _add_table(parser: argparse.ArgumentParser) -> None:
    _add_read(parser, table)
    parser.add_argument(
        "name",
        nargs="?",
        choices=TABLES,
        help="a table of the thesis beside ours: 5.1 from the suites push and aperture, 5.2 from "
        "pick-and-place and pouring; --runs is then the folder of the suites' folders (default: "
        "results/runs)",
    )


def _add_plot(parser: argparse.ArgumentParser) -> None:
    _add_read(parser, plot)
    parser.add_argument(
        "--reference",
        type=Path,
        nargs="+",
        metavar="FILE.npy",
        help="published curves to show beside ours, for push: errors of shape (runs, updates), two "
        "rollouts an update; 'extrapolation' or 'interpolation' in the file's name tells the panel",
    )


def _add_reproduce(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Make the runs behind a figure or table of the thesis, as far as their folder does not "
        "hold them, draw it, and print our numbers beside the thesis's and whether its claims held."
    )
    parser.set_defaults(command=reproduce)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("name", nargs="?", metavar="NAME", help=f"one of {', '.join(NAMES)}")
    what.add_argument("--list", action="store_true", help="what can be made anew, and stop")
    what.add_argument("--all", action="store_true", help="all of them")
    parser.add_argument(
        "--quick", action="store_true", help="fewer seeds and smaller budgets, a few minutes each"
    )
    parser.add_argument(
        "--workers", type=int, metavar="N", help="parallel processes (default: one per core)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of the runs' folders and of the picture (default: results/runs)",
    )


def run(options: argparse.Namespace) -> int:
    """Do ``nmp-bench run``.

    :param options: the parsed arguments
    """
    from results.harness.progress import run_with_progress
    from results.harness.resume import plan_runs
    from results.harness.suite import make_suite, parse_seeds
    from results.suites import find_recipe

    seeds = None if options.seeds is None else parse_seeds(options.seeds)
    name, recipe = options.suite, None
    if options.task is not None:
        from results.harness.slugs import task_slug
        from results.outside import make_recipe

        name = task_slug(options.task)
        recipe = make_recipe(options.task, options.algorithm, options.imports)
    elif options.algorithm:
        raise BenchmarkError("--algorithm goes with --task; suites name their own.")
    recipe = recipe or find_recipe(name, options.imports)
    suite = make_suite(name, recipe, seeds, options.budget, options.algorithms)
    folder = options.out or RUNS / suite.name
    if folder.exists() and not folder.is_dir():
        raise BenchmarkError(f"--out is '{folder}', a file; name a folder.")
    return run_with_progress(
        plan_runs(folder, suite.specifications, options.overwrite),
        options.workers,
        options.backend,
        options.together,
    )


def check_counts(options: argparse.Namespace) -> None:
    """Raise for numbers of processes or runs that can do nothing.

    :param options: the parsed arguments
    :raises BenchmarkError: one is less than 1
    """
    for name, told in COUNTED.items():
        count = getattr(options, name, None)
        if count is not None and count < 1:
            raise BenchmarkError(f"--{name} is {count}; {told}.")


def table(options: argparse.Namespace) -> int:
    """Do ``nmp-bench table``.

    :param options: the parsed arguments
    """
    from rich.console import Console

    from results.reports import report_for

    if options.name is not None:
        return _thesis_table(options)
    folder, records, labels = _read(options)
    report = report_for(records)
    runs = report.frame(records)
    page = report.tables(runs, labels)
    report.summarise(runs, labels).to_csv(folder / "table.csv", index=False)
    (folder / "table.md").write_text(page.markdown(), encoding="utf-8")
    console = Console(highlight=False)
    console.print(page.terminal(console.width))
    written = f"Written: {folder / 'table.md'}, {folder / 'table.csv'}"
    console.print(written, soft_wrap=True, markup=False)
    return 0


def _thesis_table(options: argparse.Namespace) -> int:
    """Print one of the thesis's tables beside our numbers, and write it as Markdown."""
    from rich.console import Console

    from results.thesis import make_table

    if options.suite is not None:
        raise BenchmarkError(f"{options.name} has suites of its own; leave out --suite.")
    folder = options.runs or RUNS
    page = make_table(options.name, folder)
    path = folder / f"{options.name}.md"
    path.write_text(page.markdown(), encoding="utf-8")
    console = Console(highlight=False)
    console.print(page.terminal(console.width))
    console.print(f"Written: {path}", soft_wrap=True, markup=False)
    return 0


def plot(options: argparse.Namespace) -> int:
    """Do ``nmp-bench plot``.

    :param options: the parsed arguments
    """
    from results.report.figure_style import save_figures
    from results.reports import figures

    folder, records, labels = _read(options)
    if not any(record.finished for record in records):
        raise BenchmarkError(f"no run in '{folder}' has finished; 'nmp-bench table' tells why.")
    for path in save_figures(folder, figures(records, labels, options.reference or ())):
        print(f"Written: {path}")
    return 0


def reproduce(options: argparse.Namespace) -> int:
    """Do ``nmp-bench reproduce``.

    :param options: the parsed arguments
    """
    if options.list:
        print("\n".join(f"{name}: {describe(name)}" for name in NAMES))
        return 0
    from rich.console import Console

    from results.reproduce import Request
    from results.reproduce import reproduce as make

    request = Request(options.out or RUNS, options.quick, options.workers)
    console, verdicts = Console(highlight=False), []
    for name in NAMES if options.all else (options.name,):
        page = make(name, request)
        console.print(page.terminal(console.width))
        verdicts += page.sections[-1].lines
        (request.folder / f"{request.file(name)}.md").write_text(page.markdown(), encoding="utf-8")
    if options.all:
        print("\n".join(verdicts))
    return 0


def _read(options: argparse.Namespace) -> tuple[Path, "list[RunRecord]", list[str]]:
    """Return the folder that is meant, its runs, and the algorithms in the order to show them."""
    from results.harness.record_files import read_records
    from results.harness.records import labels_of

    name = options.suite or ("quick" if options.runs is None else None)
    if name is not None:
        check_suite(name)
    folder = options.runs or RUNS / str(name)
    held = read_records(folder)
    for why in held.unreadable.values():
        print(f"nmp-bench: left out: {why}", file=sys.stderr)
    if not held.records:
        raise BenchmarkError(
            f"'{folder}' holds no readable runs; make some with 'nmp-bench run --suite "
            f"{name or 'SUITE'} --out {folder}', or name another folder (--runs)."
        )
    return folder, held.records, labels_of(held.records)
