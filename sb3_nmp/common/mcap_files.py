"""Trajectories as ROS 2 messages ``trajectory_msgs/msg/JointTrajectory`` in an MCAP file.

``ros2 bag play`` sends them, and Foxglove and PlotJuggler show them.
"""

from collections.abc import Sequence
from importlib.util import find_spec
from io import BytesIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sb3_nmp.common.exceptions import ConfigurationError, FileFormatError, InvalidDataError
from sb3_nmp.common.files import AnyPath, bytes_of, writing
from sb3_nmp.common.finite_arrays import numbers

TOPIC = "/joint_trajectory_controller/joint_trajectory"
TYPE = "trajectory_msgs/msg/JointTrajectory"
NANO = 1_000_000_000
LINE = "=" * 80
DEFINITION = f"""std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint[] points
{LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{LINE}
MSG: trajectory_msgs/JointTrajectoryPoint
float64[] positions
float64[] velocities
float64[] accelerations
float64[] effort
builtin_interfaces/Duration time_from_start
{LINE}
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec
"""


def write_mcap(
    path: AnyPath,
    trajectory: ArrayLike,
    times: ArrayLike,
    joints: Sequence[str] | None = None,
    topic: str = TOPIC,
) -> None:
    """Write one trajectory as a message, its values as positions, bit for bit.

    :param path: of the file, or an open one
    :param trajectory: shape (T, D), in rad or m
    :param times: when each point is reached, shape (T,), in s from the start; to the nanosecond
    :param joints: their names, D of them; ``q1`` and so on by default
    :param topic: of the message
    :raises ConfigurationError: mcap-ros2-support is not installed
    :raises InvalidDataError: no numbers, shapes that do not fit, times that do not increase, or a
        value that is not finite
    """
    _check_installed()
    from mcap_ros2.writer import Writer

    points, at = numbers("positions", trajectory), numbers("times", times)
    n_joints = points.shape[-1] if points.ndim else 0
    names = list(joints or (f"q{i + 1}" for i in range(n_joints)))
    if points.ndim != 2 or at.shape != points.shape[:1] or len(names) != points.shape[1]:
        raise InvalidDataError(
            f"a trajectory of shape {points.shape}, times of shape {at.shape} and {len(names)} "
            "joints do not fit: (T, D), (T,) and D are needed."
        )
    if not np.isfinite(points).all() or not (np.diff(at, prepend=-1e-9) > 0).all():
        raise InvalidDataError("positions must be finite, and times increase from 0 or later.")
    message = {
        "header": {"stamp": _stamp(0.0), "frame_id": ""},
        "joint_names": names,
        "points": [
            {
                "positions": point.tolist(),
                "velocities": [],
                "accelerations": [],
                "effort": [],
                "time_from_start": _stamp(float(time)),
            }
            for time, point in zip(at, points, strict=True)
        ],
    }
    buffer = BytesIO()
    writer = Writer(buffer)
    schema = writer.register_msgdef(TYPE, DEFINITION)
    writer.write_message(topic, schema, message, log_time=0, publish_time=0)
    writer.finish()
    with writing(path) as file:
        file.write(buffer.getvalue())


def read_mcap(path: AnyPath) -> tuple[list[str], NDArray[np.float64], NDArray[np.float64]]:
    """Return the joints' names, the times (T,) and the positions (T, D) of the first trajectory.

    :param path: of the file, or an open one
    :raises ConfigurationError: mcap-ros2-support is not installed
    :raises FileFormatError: it holds no such message
    """
    _check_installed()
    from mcap.exceptions import McapError
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    try:
        reader = make_reader(BytesIO(bytes_of(path)), decoder_factories=[DecoderFactory()])
        for schema, _, _, found in reader.iter_decoded_messages():
            if schema is not None and schema.name == TYPE:
                times = [_seconds(point.time_from_start) for point in found.points]
                positions = [list(point.positions) for point in found.points]
                return list(found.joint_names), np.array(times), np.array(positions)
    except (McapError, ValueError, EOFError) as error:
        raise FileFormatError(f"{path} is no MCAP file: {error}") from error
    raise FileFormatError(f"{path} holds no message of the type {TYPE}.")


def _stamp(seconds: float) -> dict[str, int]:
    whole, nano = divmod(round(seconds * NANO), NANO)
    return {"sec": whole, "nanosec": nano}


def _seconds(duration: object) -> float:
    return duration.sec + duration.nanosec / NANO  # pyright: ignore[reportAttributeAccessIssue]


def _check_installed() -> None:
    if find_spec("mcap_ros2") is None:
        raise ConfigurationError("mcap-ros2-support is not installed: pip install 'sb3-nmp[ros]'.")
