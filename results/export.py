"""What was learned, in files for others: CSV, ROS 2 messages in MCAP, or the policy as ONNX."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmark_envs import make_task
from benchmark_envs.robots import MotionLimits
from results.exceptions import BenchmarkError
from results.render import RenderRequest, check_spaces, chosen_rollout, load_model
from sb3_nmp import ConfigurationError, FileFormatError, InvalidDataError
from sb3_nmp.common.csv_files import write_csv
from sb3_nmp.common.mcap_files import write_mcap
from sb3_nmp.common.onnx_files import export_onnx

ENDINGS = (".csv", ".mcap", ".onnx")


def export(
    request: RenderRequest,
    out: Path,
    names: Sequence[str] | None = None,
    limits: MotionLimits | None = None,
) -> None:
    """Write the trajectory of one context, or the policy.

    :param request: whose, and in which context
    :param out: ends in .csv or .mcap for the trajectory, in .onnx for the policy
    :param names: of the joints or coordinates; ``q1`` and so on by default
    :param limits: that the trajectory has to keep; None: any is written
    :raises TaskError: the trajectory exceeds a limit; the message names each
    :raises BenchmarkError: limits, names or the context of a policy, another ending, a wrong number
        of names, names that are alike or that no file can have, no model for .onnx, a package that
        is missing, or a policy that ONNX cannot hold
    """
    if out.suffix not in ENDINGS:
        raise BenchmarkError(f"--out is '{out}'; its ending must be one of {', '.join(ENDINGS)}.")
    try:
        what = _export_policy if out.suffix == ".onnx" else _export_trajectory
        what(request, out, names, limits)
    except (ConfigurationError, InvalidDataError, FileFormatError) as error:
        raise BenchmarkError(str(error)) from error


def _export_policy(
    request: RenderRequest, out: Path, names: Sequence[str] | None, limits: MotionLimits | None
) -> None:
    if limits is not None:
        raise BenchmarkError(
            "limits of velocity, acceleration and jerk are checked of one trajectory, and a "
            "policy has many. Export .csv or .mcap, or leave the limits out."
        )
    if names is not None:
        raise BenchmarkError(
            "--names are of the joints in a trajectory's file, and a policy's has none. Export "
            ".csv or .mcap, or leave --names out."
        )
    if request.context is not None:
        raise BenchmarkError(
            f"--context is of one trajectory, and {out} is to hold a policy, which answers every "
            "context. Export .csv or .mcap, or leave --context out."
        )
    if request.model is None:
        raise BenchmarkError(f"--out {out} is to hold a policy: give its model (--model).")
    model = load_model(request)
    check_spaces(model, make_task(request.task), request)
    export_onnx(model.policy, out)


def _export_trajectory(
    request: RenderRequest, out: Path, names: Sequence[str] | None, limits: MotionLimits | None
) -> None:
    task, context, trajectory = chosen_rollout(request)
    n_dimensions = np.shape(trajectory)[1]
    if names is not None and len(names) != n_dimensions:
        raise BenchmarkError(f"--names has {len(names)} names; {n_dimensions} are needed.")
    if names is not None and (len(set(names)) < len(names) or not all(n.strip() for n in names)):
        raise BenchmarkError(f"--names is {list(names)}; each dimension needs a name of its own.")
    if limits is not None:
        limits.check(trajectory, task.dt, task.trajectory_names)
    if out.suffix == ".csv":
        write_csv(out, [context], [trajectory], task.times, names)
    else:
        write_mcap(out, trajectory, task.times, names)
