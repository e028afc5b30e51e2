"""Two planar arms that do the same skills: kinematics, even bends, and the moves of their experts.

The thesis's 3-DoF arm is that of its pushing task. The lengths of its 4-DoF arm were not published.
They are fitted to its recordings of the twelve proxy skills: with these links and zero offsets, the
hand ends 5.6 mm (root mean square) from where the 3-DoF arm's hand ends in the same skill, and at
the ends of the four peg insertions, whose headings were not fitted, both hands point the same way
within 6 degrees. Both arms reach 0.462 m with the peg, which brings the cube of the button press to
its goal and no farther.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from benchmark_envs.exceptions import TaskError
from benchmark_envs.rollouts import FloatArray
from benchmark_envs.tasks.push_expert import progress

PEG = 0.107  # m; from the tool's mount to the peg's tip
MOST_BEND = 2.6  # rad; of a joint between two links
N_BENDS = 2000  # in the table of bends
N_POSES = 40  # along a line that an expert leads the tool


@dataclass(frozen=True)
class PlanarArm:
    """A planar arm of revolute joints on a base at (0, 0).

    >>> PlanarArm.named("4dof").n_joints
    4

    :param name: ``"3dof"`` or ``"4dof"``
    :param links: lengths from joint to joint, in m
    :param mount: from the last joint to where the tool is mounted, in m
    :param offsets: headings at joint angles of zero, each relative to the link before, in rad
    :param start: joint angles at which all skills begin, in rad
    """

    name: str
    links: tuple[float, ...]
    mount: float
    offsets: tuple[float, ...]
    start: tuple[float, ...]

    @staticmethod
    def named(name: str) -> "PlanarArm":
        """Return one of the two arms.

        :param name: ``"3dof"`` or ``"4dof"``
        :raises TaskError: no such arm
        """
        if name not in ARMS:
            raise TaskError(f"no arm '{name}'; there are {', '.join(ARMS)}.")
        return ARMS[name]

    @property
    def n_joints(self) -> int:
        """D."""
        return len(self.offsets)

    @cached_property
    def _bends(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A table: bend of each elbow, the last joint's distance, its bearing from the first link.

        Sorted by the distance, which falls as the elbows bend.
        """
        bends = np.linspace(MOST_BEND, 0.0, N_BENDS)
        turned = np.exp(1j * bends[:, None] * np.arange(len(self.links)))
        at = turned @ np.array(self.links, np.complex128)
        return bends, np.abs(at).astype(np.float64), np.angle(at).astype(np.float64)

    def tool_pose(self, joints: FloatArray) -> FloatArray:
        """Return where the tool is mounted and where it points: x and y in m, heading in rad.

        :param joints: joint angles, shape (..., D) in rad
        :return: shape (..., 3)
        """
        headings = np.cumsum(joints + np.array(self.offsets), axis=-1)
        lengths = np.array([*self.links, self.mount])
        x, y = (lengths * np.cos(headings)).sum(-1), (lengths * np.sin(headings)).sum(-1)
        return np.stack([x, y, headings[..., -1]], axis=-1)

    def joints_at(self, poses: FloatArray) -> FloatArray:
        """Return the joint angles of tool poses, all elbows bent alike and to the left.

        For three joints that is the only solution with the elbow on that side; for four it is the
        one of many that the expert takes. What lies too far is drawn to the arm's reach.

        :param poses: x and y in m, heading in rad, shape (K, 3)
        :return: shape (K, D) in rad, the last joint's wrapped to [-pi, pi)
        :raises TaskError: a pose is too near to the base
        """
        ahead = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
        wrist = poses[:, :2] - self.mount * ahead
        bends, distances, bearings = self._bends
        rising = np.argmin(distances)  # bent beyond this, a long chain comes back
        distance = np.linalg.norm(wrist, axis=1)
        if (distance < distances[rising]).any():
            raise TaskError(
                f"the {self.name} arm cannot bring its last joint {distance.min():.3f} m from its "
                f"base; {distances[rising]:.3f} m is the least."
            )
        bend = np.interp(distance, distances[rising:], bends[rising:])
        turned = np.interp(distance, distances[rising:], bearings[rising:])
        first = np.arctan2(wrist[:, 1], wrist[:, 0]) - turned
        elbows = np.tile(bend[:, None], len(self.links) - 1)
        last = poses[:, 2] - first - elbows.sum(axis=1)
        joints = np.column_stack([first, elbows, last]) - np.array(self.offsets)
        joints[:, -1] = (joints[:, -1] + np.pi) % (2 * np.pi) - np.pi
        return joints


ARMS = {
    arm.name: arm
    for arm in (
        PlanarArm(
            "3dof",
            links=(0.185, 0.170),
            mount=0.0,
            offsets=(-np.pi / 3, -0.0575, 0.071),
            start=(-0.5106, 2.4228, -0.9142),
        ),
        PlanarArm(
            "4dof",
            links=(0.0937, 0.1155, 0.1380),
            mount=0.0078,
            offsets=(-np.pi / 3, -0.4785, -0.5437, 0.0053),
            start=(-2.0094, 2.6100, 2.0711, -0.8598),
        ),
    )
}


def tip_pose(at: FloatArray, heading: FloatArray, length: float) -> FloatArray:
    """Return the tool poses at which its tip is somewhere, shape (K, 3).

    :param at: of the tip, shape (K, 2) in m
    :param heading: of the tool, shape (K,) in rad
    :param length: of the tool, in m
    """
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return np.concatenate([at - length * ahead, heading[..., None]], axis=-1)


def approach_and_line(arm: PlanarArm, poses: FloatArray, share: float, n: int) -> FloatArray:
    """Return a skill of two moves: through joint space to the first pose, then along the others.

    :param arm: that moves
    :param poses: of the tool, shape (K, 3)
    :param share: of the time that the first move takes; all of it where there is one pose
    :param n: time points
    :return: joint angles, shape (n, D) in rad
    """
    joints, start, n_first = arm.joints_at(poses), np.array(arm.start), round(share * n)
    first = start + progress(n_first)[:, None] * (joints[0] - start)
    if len(joints) == 1:
        return first
    from scipy.interpolate import PchipInterpolator  # slow to import, and none but the expert asks

    along = PchipInterpolator(np.linspace(0, 1, len(joints)), joints)
    return np.concatenate([first, along(progress(n - n_first))])
