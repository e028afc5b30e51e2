"""The commands that write one file: ``nmp-bench render`` and ``nmp-bench export``."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # what is slow to import waits
    from results.render import RenderRequest


def add_render(parser: argparse.ArgumentParser) -> None:
    """Tell the command ``render``.

    :param parser: its own
    """
    parser.description = "Draw one rollout as .gif, .mp4 or, as a sheet of pictures, .png."
    parser.set_defaults(command=render)
    _add_source(parser)
    parser.add_argument("--camera", metavar="NAME", help="of the task's model (default: its own)")
    parser.add_argument(
        "--size", type=_size, default=(480, 360), metavar="WxH",
        help="of a picture, in pixels (default: 480x360)",
    )  # fmt: skip
    parser.add_argument(
        "--speed", type=float, default=1.0, metavar="FACTOR",
        help="of a film; a factor other than 1 is written on it (default: %(default)s)",
    )  # fmt: skip


def add_export(parser: argparse.ArgumentParser) -> None:
    """Tell the command ``export``.

    :param parser: its own
    """
    parser.description = (
        "Write the trajectory of one context as .csv or, for ROS 2, as a JointTrajectory in .mcap; "
        "or a model's policy as .onnx."
    )
    parser.set_defaults(command=export)
    _add_source(parser)
    parser.add_argument("--names", nargs="+", metavar="NAME", help="of the joints or coordinates")
    for quantity, unit in (("velocity", "s"), ("acceleration", "s²"), ("jerk", "s³")):
        parser.add_argument(
            f"--max-{quantity}", nargs="+", type=float, metavar="NUMBER",
            help=f"per {unit}, one or one for each joint: nothing is written beyond it",
        )  # fmt: skip


def _size(text: str) -> tuple[int, int]:
    """Return width and height of ``"640x480"``."""
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise argparse.ArgumentTypeError(f"'{text}' is no size; write it like 640x480")
    return int(width), int(height)


def _add_source(parser: argparse.ArgumentParser) -> None:
    """Let a command be told whose rollout is meant, and where to write it."""
    parser.add_argument("task", metavar="TASK", help="such as nmp/Bottles-v0")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--model", type=Path, metavar="ZIP", help="saved by model.save()")
    source.add_argument("--run", type=Path, metavar="JSON", help="a run's file: its greedy rollout")
    source.add_argument("--expert", metavar="MODE", help="the task's scripted expert")
    parser.add_argument("--algorithm", default="rcnmp", help="of the model (default: %(default)s)")
    add_import(parser)
    parser.add_argument("--seed", type=int, default=0, help="of the context, where it is drawn")
    parser.add_argument(
        "--context", nargs="+", type=float, metavar="NUMBER", help="instead of a drawn one"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="what to write")


def add_import(parser: argparse.ArgumentParser) -> None:
    """Let a command be told of modules of other packages.

    :param parser: its own
    """
    parser.add_argument(
        "--import", nargs="+", default=[], dest="imports", metavar="MODULE",
        help="modules that register tasks or suites, or hold algorithms, of your own",
    )  # fmt: skip


def render(options: argparse.Namespace) -> int:
    """Do ``nmp-bench render``.

    :param options: the parsed arguments
    """
    from results.render import Look, render_rollout

    look = Look(options.camera, options.size, options.speed)
    return _write(options, lambda request, out: render_rollout(request, out, look))


def _write(options: argparse.Namespace, write: Callable[["RenderRequest", Path], None]) -> int:
    """Let a function write what `_add_source` was told."""
    from results.harness.plugins import bring_in
    from results.render import RenderRequest

    o = options
    bring_in(o.imports, o.task)
    context = None if o.context is None else tuple(o.context)
    write(RenderRequest(o.task, o.model, o.run, o.expert, o.algorithm, o.seed, context), o.out)
    print(f"Written: {o.out}")
    return 0


def export(options: argparse.Namespace) -> int:
    """Do ``nmp-bench export``.

    :param options: the parsed arguments
    """
    from benchmark_envs.robots import MotionLimits
    from results.export import export as write

    o = options
    given = (o.max_velocity, o.max_acceleration, o.max_jerk)
    limits = MotionLimits(*given) if any(limit is not None for limit in given) else None
    return _write(options, lambda request, out: write(request, out, o.names, limits))
