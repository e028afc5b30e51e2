"""Proxy skills of the two planar arms: `nmp/ArmReach-v0`, `nmp/ArmPush-v0`, `nmp/PegInsertion-v0`.

What both arms are shown before the button press is transferred from one to the other (thesis
5.2.3): reaching, pushing and peg insertion.
"""

from collections.abc import Mapping
from typing import ClassVar

import mujoco
import numpy as np

from benchmark_envs.registry import register_task
from benchmark_envs.rollouts import FloatArray
from benchmark_envs.tasks.planar_arm_task import PlanarArmTask
from benchmark_envs.tasks.planar_arms import N_POSES, PEG, tip_pose
from benchmark_envs.tasks.push_expert import APPROACH_DEPTH, POCKET_DEPTH

CYLINDER = (0.2796, -0.0624)  # m; where it stands at first
DEPTH = 0.04  # m; of the slot
BEFORE = 0.015  # m; the approach ends so far in front of the slot
#: about the base: bearing in degrees and distance in m, from which targets are drawn
BAND = Mapping[str, tuple[float, float]]


class ProxySkill(PlanarArmTask):
    """A proxy skill; its context is where the tip or the cylinder is to come to."""

    band: ClassVar[BAND]
    limits: ClassVar = ((-0.30, -0.46), (0.47, 0.46))

    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        """Draw a target from the band, shape (2,) in m.

        :param rng: the generator to draw from
        """
        bearing = np.radians(rng.uniform(*self.band["bearing"]))
        return rng.uniform(*self.band["distance"]) * np.array([np.cos(bearing), np.sin(bearing)])


@register_task("nmp/ArmReach-v0")
class ArmReachTask(ProxySkill):
    """The tip of the peg is to reach a target on the table, the peg pointing away from the base.

    Reward: minus the tip's final distance to the target in m. Success: at most 0.01 m.

    >>> task = ArmReachTask(arm="3dof", n_threads=1)
    >>> bool(task.simulate([0.3, 0.1], task.demonstrate([0.3, 0.1])).successes[0])
    True

    :param arm: ``"3dof"`` or ``"4dof"``
    :param n_threads: of the simulator; by default one per core
    :raises TaskError: no such arm
    """

    scene_file: ClassVar[str] = "arm_reach.xml"
    reward_terms: ClassVar[Mapping[str, str]] = {
        "goal": "minus the tip's final distance to the target [m]"
    }
    tolerance: ClassVar[float] = 0.01
    approach_share: ClassVar[float] = 1.0
    band: ClassVar[BAND] = {"bearing": (-60.0, 110.0), "distance": (0.30, 0.458)}

    def _way(self, context: FloatArray, aim: FloatArray) -> FloatArray:
        """There and no farther."""
        bearing = np.arctan2(context[1], context[0])
        return tip_pose(aim[None], np.array([bearing]), PEG)


@register_task("nmp/ArmPush-v0")
class ArmPushTask(ProxySkill):
    """A cylinder is pushed to a target by a hand with a pocket, which holds it as it turns.

    Reward: minus the cylinder's final distance to the target in m. Success: at most 0.03 m.

    >>> task = ArmPushTask(arm="4dof", n_threads=1)
    >>> bool(task.simulate([0.35, 0.15], task.demonstrate([0.35, 0.15])).successes[0])
    True

    :param arm: ``"3dof"`` or ``"4dof"``
    :param n_threads: of the simulator; by default one per core
    :raises TaskError: no such arm
    """

    scene_file: ClassVar[str] = "arm_push.xml"
    reward_terms: ClassVar[Mapping[str, str]] = {
        "goal": "minus the cylinder's final distance to the target [m]"
    }
    tool: ClassVar[str] = "pocket"
    tolerance: ClassVar[float] = 0.03
    thing: ClassVar[tuple[float, float] | None] = CYLINDER
    band: ClassVar[BAND] = {"bearing": (-60.0, 90.0), "distance": (0.33, 0.40)}

    def _way(self, context: FloatArray, aim: FloatArray) -> FloatArray:
        """Around the base, from where the cylinder is in the pocket to where it is at the target.

        The hand turns half as much to the inside again as the way around the base does.
        """
        first, last = (np.arctan2(y, x) for x, y in (CYLINDER, aim))
        bearing = np.linspace(first, last, N_POSES)
        distance = np.linspace(np.hypot(*CYLINDER), np.hypot(*aim), N_POSES)
        heading = bearing + 0.5 * (bearing - first)
        depth = np.full((N_POSES, 1), POCKET_DEPTH)
        depth[0] = APPROACH_DEPTH
        at = distance[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        return np.concatenate([at - depth * ahead, heading[:, None]], axis=1)


@register_task("nmp/PegInsertion-v0")
class PegInsertionTask(ProxySkill):
    """A peg of 12 mm is put 40 mm deep into a slot of 26 mm that faces the base.

    The context is where its tip is to come to. Reward: minus the tip's final distance to that place
    in m. Success: at most 0.008 m.

    >>> task = PegInsertionTask(arm="4dof", n_threads=1)
    >>> bool(task.simulate([0.43, 0.15], task.demonstrate([0.43, 0.15])).successes[0])
    True

    :param arm: ``"3dof"`` or ``"4dof"``
    :param n_threads: of the simulator; by default one per core
    :raises TaskError: no such arm
    """

    scene_file: ClassVar[str] = "peg_insertion.xml"
    reward_terms: ClassVar[Mapping[str, str]] = {
        "goal": "minus the tip's final distance to the end of the slot [m]"
    }
    tolerance: ClassVar[float] = 0.008
    band: ClassVar[BAND] = {"bearing": (-65.0, 45.0), "distance": (0.44, 0.46)}

    def _model(self, context: FloatArray) -> mujoco.MjModel:
        """The slot stands at the context."""
        return self._with_target(context)

    def _way(self, context: FloatArray, aim: FloatArray) -> FloatArray:
        """Straight into the slot."""
        bearing = np.arctan2(context[1], context[0])
        ahead = np.array([np.cos(bearing), np.sin(bearing)])
        line = np.linspace(aim - (DEPTH + BEFORE) * ahead, aim, N_POSES)
        return tip_pose(line, np.full(40, bearing), PEG)
