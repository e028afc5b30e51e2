"""The commands ``nmp-bench import-sb3`` and ``nmp-bench export-ioh``."""

import argparse
import sys
from pathlib import Path

from results.output_commands import add_import


def add_import_sb3(parser: argparse.ArgumentParser) -> None:
    """Tell the command ``import-sb3``.

    :param parser: its own
    """
    parser.description = (
        "Take what SB3's EvalCallback wrote about a run in one context, so that it stands in "
        "tables beside the benchmark's own runs."
    )
    parser.set_defaults(command=import_sb3)
    parser.add_argument("file", type=Path, metavar="NPZ", help="evaluations.npz of the callback")
    parser.add_argument("--task", required=True, metavar="ID", help="on which the run was made")
    parser.add_argument("--label", required=True, metavar="NAME", help="its name in tables")
    parser.add_argument("--seed", type=int, default=0, help="of the run (default: %(default)s)")
    parser.add_argument(
        "--budget", type=int, metavar="N", help="its rollouts (default: until the last evaluation)"
    )
    parser.add_argument(
        "--steps", type=int, default=1, metavar="N", help="SB3 steps per rollout (default: 1)"
    )
    add_import(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the runs")
    parser.add_argument("--overwrite", action="store_true", help="replace a record of that name")


def import_sb3(options: argparse.Namespace) -> int:
    """Do ``nmp-bench import-sb3``.

    :param options: the parsed arguments
    """
    from results.exchange.sb3_evaluations import Source, import_evaluations

    o = options
    source = Source(o.file, o.task, o.label, o.seed, o.budget, o.steps, tuple(o.imports))
    print(f"Written: {import_evaluations(source, o.out, o.overwrite)}")
    return 0


def add_export_ioh(parser: argparse.ArgumentParser) -> None:
    """Tell the command ``export-ioh``.

    :param parser: its own
    """
    parser.description = "Write runs in one context as files for IOHanalyzer and iohinspector."
    parser.set_defaults(command=export_ioh)
    parser.add_argument("--runs", type=Path, required=True, metavar="DIR", help="of the runs")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to be made")


def export_ioh(options: argparse.Namespace) -> int:
    """Do ``nmp-bench export-ioh``.

    :param options: the parsed arguments
    """
    from results.exchange.iohprofiler import export_iohprofiler
    from results.harness.record_files import read_records

    held = read_records(options.runs)
    for why in held.unreadable.values():
        print(f"nmp-bench: left out: {why}", file=sys.stderr)
    written = export_iohprofiler(held.records, options.out)
    functions = {path.name for path in written}
    algorithms = {path.parent for path in written}
    print(
        f"Written: {len(functions)} functions, with runs of {len(algorithms)} algorithms, in "
        f"{options.out}"
    )
    return 0
