"""The pick-and-place scene, the UR10's inverse kinematics and the expert's plan, without physics.

The expert carries as a person does: at a habitual height of the hand, which is enough for every
object and tower of `demonstration_contexts`, and higher only where tower and object need it. So the
demonstrations show no connection between the tower and the height, and a CNMP that is trained on
them succeeds among them but hits the tower in both `EXTRAPOLATION_CONTEXTS`, where the object would
be 2 and 4 cm too low at the habitual height. The thesis reports that failure too (5.2.4).
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark_envs.exceptions import TaskError
from benchmark_envs.motion import minimum_jerk
from benchmark_envs.tasks.pick_and_place_layout import Layout

FloatArray = NDArray[np.float64]

# Universal Robots' Denavit-Hartenberg figures of the UR10, in m; alpha is 90, 0, 0, 90, -90, 0 deg
D1, A2, A3, D4, D5, D6 = 0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922
TOOL_LENGTH = 0.16  # m; from the flange to the point between the finger tips, as on a 2F-85
HOME = np.radians([0.0, -80.0, -115.0, -75.0, 90.0, 0.0])  # the tool points down, 0.33 m high

GRASP_DEPTH = 0.01  # m; of the tool point below the object's top: half of the smallest object
CLEARANCE = 0.02  # m; between the carried object and the tower
HABITUAL_HEIGHT = 0.15  # m; of the tool point above the table, where no more is needed
FINAL_HEIGHT = 0.30  # m; of the tool point, after the object was put down

#: shares of the rollout's time in which the gripper closes, and opens: it follows a fixed script
CLOSING, OPENING = (0.23, 0.28), (0.79, 0.84)
#: shares of the time in which the expert moves over the object, down, up, along, down and up again
OVER, DOWN, UP, ALONG, LOWER, AWAY = (
    (0.0, 0.16),
    (0.02, 0.22),
    (0.29, 0.48),
    (0.35, 0.72),
    (0.60, 0.78),
    (0.85, 1.0),
)
#: on the field, where the tower can be as near as the gripper, it moves along only while it is up
ALONG_FIELD = (0.42, 0.65)

#: heights of object and tower in m, shape (2, 2): the thesis's two tasks beyond its demonstrations
EXTRAPOLATION_CONTEXTS = np.array([[0.08, 0.10], [0.09, 0.11]])


def demonstration_contexts() -> FloatArray:
    """Return the heights of object and tower in the thesis's ranges, shape (8, 2) in m.

    Objects of 2 and 6 cm, each with towers of 2, 4, 6 and 8 cm (5.2.4 gives the ranges).
    """
    return np.array([[o, t] for o in (0.02, 0.06) for t in (0.02, 0.04, 0.06, 0.08)])


def needed_height(heights: ArrayLike) -> FloatArray:
    """Return the tool's height at which the carried object clears the tower, shape (...) in m.

    :param heights: of object and tower, shape (..., 2) in m
    """
    return np.sum(heights, axis=-1) - GRASP_DEPTH + CLEARANCE


def carry_height(heights: ArrayLike) -> FloatArray:
    """Return the height at which the expert carries, shape (...) in m.

    :param heights: of object and tower, shape (..., 2) in m
    """
    return np.maximum(HABITUAL_HEIGHT, needed_height(heights))


def tool_path(context: FloatArray, n: int) -> FloatArray:
    """Return the expert's path of the tool point, shape (n, 3) in m.

    It is a sum of minimum-jerk moves along the axes: over the object, down, up, along and down.

    :param context: heights of object and tower, shape (2,), or on the field (6,), in m
    :param n: time points
    """
    layout, start = Layout.of(context[None]), tool_position_at_home()
    taken, place, heights = layout.objects[0], layout.places[0], layout.heights[0]
    low, high = heights[0] - GRASP_DEPTH, float(carry_height(heights))
    over, along = move(OVER, n), move(ALONG if len(context) == 2 else ALONG_FIELD, n)
    across = start[:2] + over[:, None] * (taken - start[:2]) + along[:, None] * (place - taken)
    height = start[2] + sum(
        change * move(when, n)
        for change, when in (
            (low - start[2], DOWN),
            (high - low, UP),
            (low - high, LOWER),
            (FINAL_HEIGHT - low, AWAY),
        )
    )
    return np.column_stack([across, height])


def move(when: tuple[float, float], n: int) -> FloatArray:
    """Return the share of a minimum-jerk move done at each of n time points, shape (n,).

    :param when: shares of the time at which it begins and ends
    :param n: time points
    """
    begin, end = when
    return minimum_jerk((np.arange(1, n + 1) / n - begin) / (end - begin))


def tool_position_at_home() -> FloatArray:
    """Return where the tool point is at `HOME`, shape (3,) in m."""
    _, shoulder, elbow, *_ = HOME
    r = A2 * math.cos(shoulder) + A3 * math.cos(shoulder + elbow) + D5
    z = D1 + A2 * math.sin(shoulder) + A3 * math.sin(shoulder + elbow) - D6 - TOOL_LENGTH
    return np.array([r, -D4, z])


def inverse_kinematics(points: FloatArray) -> FloatArray:
    """Return the joint angles that bring the tool to points, pointing straight down.

    The closed solution with the elbow up and the fingers closing along y. Wrist 2 stands at 90
    degrees, wrist 1 keeps the tool upright, and wrist 3 undoes the base's rotation.

    :param points: of the tool point, shape (..., 3) in m
    :return: shape (..., 6) in rad
    :raises TaskError: a point out of reach
    """
    x, y = points[..., 0], points[..., 1]
    square = x**2 + y**2 - D4**2
    radial = np.sqrt(np.maximum(square, 0.0))
    base = np.arctan2(y, x) + np.arctan2(D4, radial)
    r, z = radial - D5, points[..., 2] + TOOL_LENGTH + D6 - D1
    cosine = (r**2 + z**2 - A2**2 - A3**2) / (2 * A2 * A3)
    if (square < 0).any() or (np.abs(cosine) > 1).any():
        where = points[(square < 0) | (np.abs(cosine) > 1)][0]
        raise TaskError(
            f"the tool cannot be at {where.round(4).tolist()} m and point down: the UR10's wrist "
            f"reaches {-A2 - A3:.3f} m from its shoulder, and not the axis of its base."
        )
    elbow = -np.arccos(cosine)
    shoulder = np.arctan2(z, r) - np.arctan2(A3 * np.sin(elbow), A2 + A3 * np.cos(elbow))
    shoulder = (shoulder + np.pi) % (2 * np.pi) - np.pi
    wrist_1 = -1.5 * np.pi - shoulder - elbow
    wrist_2 = np.full_like(base, np.pi / 2)
    return np.stack([base, shoulder, elbow, wrist_1, wrist_2, base], axis=-1)
