"""What sensors tell of a rollout of pick-and-place: the reward's distances, and what happened.

Shape letters: N rollouts, T time points.
"""

import math

import numpy as np

from benchmark_envs.executor import SensorLog
from benchmark_envs.rollouts import BoolArray, FloatArray
from benchmark_envs.tasks.pick_and_place_expert import (
    CLOSING,
    GRASP_DEPTH,
    OPENING,
    TOOL_LENGTH,
    needed_height,
)
from benchmark_envs.tasks.pick_and_place_layout import Layout

T = 200
FINGERS = ("finger_left", "finger_right")
UPRIGHT = math.cos(math.radians(15))  # an object that leans more does not stand
LIFTED = 0.01  # m; above the table: an object between the fingers has been grasped

#: the first and the last time point of a phase of the gripper's script
CLOSES, OPENS = (slice(round(a * T), round(b * T)) for a, b in (CLOSING, OPENING))
#: while the object is in the gripper
CARRY = slice(CLOSES.stop - 1, OPENS.start + 1)


def grasp_points(log: SensorLog, layout: Layout) -> FloatArray:
    """Return the point of the object to take it at, when the fingers begin to close, (N, 3) in m.

    :param log: of the sensors of the object's position and axis
    :param layout: where things are, of N contexts
    """
    position, axis = (
        log.readings[f"object_{name}"][:, CLOSES.start - 1] for name in ("position", "axis")
    )
    return position + (layout.heights[:, :1] / 2 - GRASP_DEPTH) * axis


def pose_errors(
    tool: FloatArray, flange: FloatArray, grasp: FloatArray, layout: Layout
) -> dict[str, FloatArray]:
    """Return the distances that are the reward's terms, each of shape (N,) in m.

    :param tool: path of the tool point, shape (N, T, 3) in m
    :param flange: path of the arm's last flange, shape (N, T, 3) in m
    :param grasp: `grasp_points`, shape (N, 3) in m
    :param layout: where things are, of N contexts
    """
    place = np.column_stack([layout.places, layout.heights[:, 0] - GRASP_DEPTH])
    errors: dict[str, FloatArray] = {}
    for name, where, phase in (("grasp", grasp, CLOSES), ("place", place, OPENS)):
        wanted = where[:, None].copy()
        square = np.sum((tool[:, phase] - wanted) ** 2, axis=2)
        wanted[..., 2] += TOOL_LENGTH
        square += np.sum((flange[:, phase] - wanted) ** 2, axis=2)
        errors[name] = np.sqrt(square.mean(axis=1) / 2)
    needed = needed_height(layout.heights)
    errors["avoid"] = avoidance_error(tool[:, CARRY], layout.crossings, needed)
    return errors


def avoidance_error(paths: FloatArray, points: FloatArray, needed: FloatArray) -> FloatArray:
    """Return how far ways pass below or beside the points over the tower, shape (N,) in m.

    The sum over three points (`Layout.crossings`). A way is made of straight lines. Each of them is
    judged where it is nearest to the point as seen from above, by the distance there; being higher
    costs nothing.

    :param paths: of the tool point, shape (N, K, 3) in m
    :param points: as seen from above, shape (N, 3, 2) in m
    :param needed: the points' height, shape (N,) in m
    """
    begin, line = paths[:, :-1, None], np.diff(paths, axis=1)[:, :, None]
    over = points[:, None]  # (N, 1, 3, 2)
    square = np.maximum(np.sum(line[..., :2] ** 2, axis=-1), 1e-12)
    share = np.sum((over - begin[..., :2]) * line[..., :2], axis=-1) / square
    nearest = begin + np.clip(share, 0.0, 1.0)[..., None] * line  # (N, K - 1, 3, 3)
    beside = nearest[..., :2] - over
    below = np.maximum(0.0, needed[:, None, None] - nearest[..., 2])
    distance = np.sqrt(np.sum(beside**2, axis=-1) + below**2)
    return distance.min(axis=1).sum(axis=1)


def contact_outcomes(log: SensorLog, layout: Layout) -> dict[str, BoolArray]:
    """Return what contacts made of grasp, carry and placing, each of shape (N,).

    :param log: of the sensors of touches, and of the object's position and axis
    :param layout: where things are, of N contexts
    """
    left, right = (log.readings[f"{name}_touch"][..., 0] > 0 for name in FINGERS)
    held = left & right
    lifted = log.readings["object_position"][..., 2] - layout.heights[:, :1] / 2 > LIFTED
    grasped = np.logical_or.reduce((held & lifted)[:, CARRY], axis=1)
    return {
        "grasped": grasped,
        "touched_tower": log.peaks["tower_touch"].max(axis=(1, 2)) > 0,
        "dropped": grasped & ~held[:, OPENS.start],
        "toppled": log.readings["object_axis"][:, -1, 2] < UPRIGHT,
    }
