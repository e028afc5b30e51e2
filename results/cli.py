"""``nmp-bench``: run suites, print their tables, draw their plots."""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from results.exceptions import BenchmarkError
from results.records import Record, read_records
from results.suites import SUITES, known_algorithms, make_suite, parse_seeds

RUNS = Path("results/runs")
THESIS_TABLES = ("table-5.1", "table-5.2")
USAGE_ERROR, INTERRUPTED = 2, 130
EXIT_STATUS = (
    "exit status: 0 done (failed runs are listed, kept with their reason, and tried again next "
    "time), 1 every run failed, 2 wrong usage, 130 interrupted"
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status.

    :param arguments: those of the process by default
    """
    from benchmark_envs import RenderingUnavailableError, TaskError

    options = build_parser().parse_args(arguments)
    command: Callable[[argparse.Namespace], int] = options.command
    try:
        return command(options)
    except (BenchmarkError, TaskError, RenderingUnavailableError) as error:
        print(f"nmp-bench: {error}", file=sys.stderr)
        return USAGE_ERROR
    except KeyboardInterrupt:
        print("\nnmp-bench: interrupted.", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # such as `nmp-bench table | head`
        sys.stderr.close()
        return 0


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
    _add_render(commands.add_parser("render", help="draw a run's or a model's rollout"))
    return parser


def _suites() -> str:
    return "; ".join(
        f"{name}: {recipe.description}, {recipe.n_seeds} seeds, {recipe.budget} rollouts each"
        for name, recipe in SUITES.items()
    )


def _add_run(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Run a suite in parallel processes, one result file a run. Runs that the folder holds "
        "already are kept, so the same command goes on where an interrupted one stopped."
    )
    parser.set_defaults(command=run)
    parser.add_argument("--suite", default="quick", help=f"{_suites()} (default: quick)")
    parser.add_argument(
        "--seeds",
        metavar="N|A-B|A,B",
        help="the first N, a range, or a list (default: the suite's)",
    )
    parser.add_argument(
        "--budget", type=int, help="rollouts a run (default: the suite's, or the algorithm's own)"
    )
    parser.add_argument(
        "--algorithms", nargs="+", metavar="LABEL", help="only these (default: all of the suite)"
    )
    parser.add_argument(
        "--workers", type=int, metavar="N", help="parallel processes (default: one a core)"
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
        choices=THESIS_TABLES,
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


def _add_render(parser: argparse.ArgumentParser) -> None:
    parser.description = "Draw one rollout as .gif, .mp4 or, as a sheet of pictures, .png."
    parser.set_defaults(command=render)
    parser.add_argument("task", metavar="TASK", help="such as nmp/Bottles-v0")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--model", type=Path, metavar="ZIP", help="saved by model.save()")
    source.add_argument("--run", type=Path, metavar="JSON", help="a run's file: its greedy rollout")
    source.add_argument("--expert", metavar="MODE", help="the task's scripted expert")
    parser.add_argument("--algorithm", default="RC-NMP", help="of the model (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the context, where it is drawn")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="what to write")


def run(options: argparse.Namespace) -> int:
    """Do ``nmp-bench run``.

    :param options: the parsed arguments
    """
    from results.planning import plan_runs
    from results.progress import run_with_progress

    if options.workers is not None and options.workers < 1:
        raise BenchmarkError(f"--workers is {options.workers}; at least 1 process is needed.")
    seeds = None if options.seeds is None else parse_seeds(options.seeds)
    suite = make_suite(options.suite, seeds, options.budget, options.algorithms)
    folder = options.out or RUNS / suite.name
    if folder.exists() and not folder.is_dir():
        raise BenchmarkError(f"--out is '{folder}', a file; name a folder.")
    return run_with_progress(
        plan_runs(folder, suite.specifications, options.overwrite), options.workers
    )


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
    report.summary(runs, labels).to_csv(folder / "table.csv", index=False)
    (folder / "table.md").write_text(report.markdown(runs, labels), encoding="utf-8")
    console = Console(highlight=False)
    console.print(report.terminal(runs, labels, console.width))
    console.print(f"Written: {folder / 'table.md'}, {folder / 'table.csv'}", soft_wrap=True)
    return 0


def _thesis_table(options: argparse.Namespace) -> int:
    """Print one of the thesis's tables beside our numbers, and write it as Markdown."""
    from rich.console import Console

    from results.text_table import markdown_page, terminal_page
    from results.thesis_table_5_1 import table_5_1
    from results.thesis_table_5_2 import table_5_2

    if options.suite is not None:
        raise BenchmarkError(f"{options.name} has suites of its own; leave out --suite.")
    folder = options.runs or RUNS
    page = dict(zip(THESIS_TABLES, (table_5_1, table_5_2), strict=True))[options.name](folder)
    path = folder / f"{options.name}.md"
    path.write_text(markdown_page(*page), encoding="utf-8")
    console = Console(highlight=False)
    console.print(terminal_page(*page, console.width))
    console.print(f"Written: {path}", soft_wrap=True)
    return 0


def plot(options: argparse.Namespace) -> int:
    """Do ``nmp-bench plot``.

    :param options: the parsed arguments
    """
    from results.plot import save_figures
    from results.reports import report_for

    folder, records, labels = _read(options)
    if all(record["outcome"] != "finished" for record in records):
        raise BenchmarkError(f"no run in '{folder}' has finished; 'nmp-bench table' tells why.")
    report = report_for(records)
    if options.reference:
        report = report.with_references(options.reference)
    for path in save_figures(folder, report.figures(records, labels)):
        print(f"Written: {path}")
    return 0


def render(options: argparse.Namespace) -> int:
    """Do ``nmp-bench render``.

    :param options: the parsed arguments
    """
    from results.render import RenderRequest, render_rollout

    request = RenderRequest(
        options.task, options.model, options.run, options.expert, options.algorithm, options.seed
    )
    render_rollout(request, options.out)
    print(f"Written: {options.out}")
    return 0


def _read(options: argparse.Namespace) -> tuple[Path, list[Record], list[str]]:
    """Return the folder that is meant, its runs, and the algorithms in the order to show them."""
    name = options.suite or ("quick" if options.runs is None else None)
    expected = [] if name is None else make_suite(name).labels
    folder = options.runs or RUNS / str(name)
    records = read_records(folder)
    if not records:
        raise BenchmarkError(
            f"'{folder}' holds no runs; make some with 'nmp-bench run --suite "
            f"{name or 'SUITE'} --out {folder}', or name another folder (--runs)."
        )
    found = [record["specification"]["label"] for record in records]
    known = [label for label in known_algorithms() if label in found]
    return folder, records, list(dict.fromkeys([*expected, *known, *found]))
