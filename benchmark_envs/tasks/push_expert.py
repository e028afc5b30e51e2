"""Kinematics of the pushing arm and the expert's two moves, without physics.

The expert moves as the thesis's recordings do: in a straight line through joint space to a pose in
which the cylinder lies in the hand's pocket, a stop, and a straight line to the final pose, at
nearly constant speed with smooth ends. The headings of the hand are those of the eight recordings,
interpolated by the target's bearing: the recordings chose them by hand, and they are no simple
function of the target.
"""

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LINKS = (0.185, 0.170)  # m
REACH = 0.3535  # m; of joint 3: the farthest of the recordings, 1.5 mm short of a straight arm
OFFSETS = np.array([-math.pi / 3, -0.0575, 0.071])  # rad; headings at joint angles of zero
POCKET_DEPTH = 0.0543  # m; from joint 3 to the centre of a cylinder that touches the palm
APPROACH_DEPTH = 0.0575  # m; the same at the end of the approach: 3 mm short of the palm
RAMP = 32  # time points in which the arm gathers or loses speed
APPROACH = (90.0, 165.0)  # time points that the approach may take

#: by recording, in the order of the bearing: the target's bearing, the hand's heading at the end
#: of the approach, its final heading less the bearing, all in degrees, and the cylinder's final
#: place across the pocket in m
HEADINGS = np.array(
    [
        [-54.6, -24.0, -42.9, 0.0125],
        [-40.3, -8.0, -8.8, 0.0125],
        [-24.5, -14.5, -21.9, 0.0105],
        [-12.0, -24.3, -8.5, -0.0120],
        [16.6, 7.0, -6.7, -0.0125],
        [31.8, -13.5, 32.8, -0.0125],
        [54.8, -17.2, 24.6, -0.0125],
        [82.7, 0.5, 36.2, -0.0125],
    ]
)


def headings(target: FloatArray) -> tuple[float, float, float]:
    """Return the hand's heading after the approach and at the end [rad] and the final offset [m].

    :param target: shape (2,) in m
    """
    bearing = math.atan2(target[1], target[0])
    rows = [
        float(np.interp(math.degrees(bearing), HEADINGS[:, 0], column)) for column in HEADINGS.T
    ]
    return math.radians(rows[1]), bearing + math.radians(rows[2]), rows[3]


def hand_pose(joints: FloatArray) -> FloatArray:
    """Return where joint 3 is and where the hand points: x and y in m, heading in rad.

    :param joints: joint angles, shape (..., 3) in rad
    :return: shape (..., 3)
    """
    heading = np.cumsum(joints + OFFSETS, axis=-1)
    x = LINKS[0] * np.cos(heading[..., 0]) + LINKS[1] * np.cos(heading[..., 1])
    y = LINKS[0] * np.sin(heading[..., 0]) + LINKS[1] * np.sin(heading[..., 1])
    return np.stack([x, y, heading[..., 2]], axis=-1)


def inverse_kinematics(pose: FloatArray) -> FloatArray | None:
    """Return the joint angles of a hand pose, None if it is too near to the base.

    The elbow is at the right. A joint 3 too far away is drawn back to the arm's reach.

    :param pose: x and y of joint 3 in m, heading in rad, shape (3,)
    :return: shape (3,) in rad, the last one wrapped to [-pi, pi)
    """
    first, second = LINKS
    distance = min(math.hypot(pose[0], pose[1]), REACH)
    cosine = (distance**2 - first**2 - second**2) / (2 * first * second)
    if cosine < -1.0:
        return None
    elbow = math.acos(cosine)
    bearing = math.atan2(pose[1], pose[0])
    shoulder = bearing - math.atan2(second * math.sin(elbow), first + second * math.cos(elbow))
    joints = np.array([shoulder, elbow, pose[2] - shoulder - elbow]) - OFFSETS
    joints[2] = (joints[2] + math.pi) % (2 * math.pi) - math.pi
    return joints


def pocket_pose(cylinder: FloatArray, heading: float, depth: float, offset: float) -> FloatArray:
    """Return the hand pose that has the cylinder in its pocket, shape (3,).

    :param cylinder: its centre, shape (2,) in m
    :param heading: of the hand, in rad
    :param depth: of the cylinder's centre ahead of joint 3, in m
    :param offset: of the cylinder's centre to the hand's left, in m
    """
    ahead = np.array([math.cos(heading), math.sin(heading)])
    left = np.array([-ahead[1], ahead[0]])
    return np.array([*(cylinder - depth * ahead - offset * left), heading])


def two_moves(start: FloatArray, contact: FloatArray, end: FloatArray, n: int) -> FloatArray:
    """Return the trajectory over two straight lines in joint space, shape (n, D).

    The time is shared by the lengths of the moves.

    :param start: joint angles, shape (D,)
    :param contact: joint angles between the moves, shape (D,)
    :param end: joint angles, shape (D,)
    :param n: time points
    """
    first, second = np.linalg.norm(contact - start), np.linalg.norm(end - contact)
    k = round(float(np.clip(n * first / (first + second), *APPROACH)))
    approach = start + progress(k)[:, None] * (contact - start)
    return np.concatenate([approach, contact + progress(n - k)[:, None] * (end - contact)])


def progress(n: int) -> FloatArray:
    """Return the share of a move done after each of n time points: even speed, smooth ends.

    :param n: time points, more than twice `RAMP`
    :return: shape (n,), rising to 1
    """
    ramp = np.sin(np.linspace(0, np.pi / 2, RAMP + 2)[1:-1]) ** 2
    speed = np.concatenate([ramp, np.ones(n - 2 * RAMP), ramp[::-1]])
    return np.cumsum(speed) / speed.sum()
