"""`nmp/ButtonPress-v0`: push a cube through a gap between two walls (thesis 5.2.3)."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from benchmark_envs.registry import register_task
from benchmark_envs.rollouts import FloatArray
from benchmark_envs.tasks.planar_arm_task import PlanarArmTask
from benchmark_envs.tasks.planar_arms import N_POSES, PEG, tip_pose

CUBE = (0.4, -0.124)  # m; where it stands at first
GOAL = np.array([0.445, -0.146])  # m
HALF = 0.009  # m; of the cube's side
BEFORE = 0.007  # m; the approach ends so far in front of the cube, as the thesis's recording does


@register_task("nmp/ButtonPress-v0")
class ButtonPressTask(PlanarArmTask):
    """A peg in the hand of a planar arm pushes a cube to its goal, behind a gap of 39 mm.

    Reward: minus the cube's final distance to the goal in m, 0.050 for a cube that is not touched.
    Success: at most 0.015 m. ``outcomes["touched"]`` is 1 where the cube has moved at all. There is
    one context, the thesis's goal; cube, walls and goal have the thesis's places. What the hand of
    its simulation looked like was not published; here it is a peg of 12 mm whose tip, under the
    thesis's recording of the 3-DoF arm, ends where a cube at the goal begins.

    Its film is five times faster than the rollout.

    >>> task = ButtonPressTask(arm="3dof", n_threads=1)
    >>> rollouts = task.simulate(task.goal, task.demonstrate(task.goal))
    >>> rollouts.successes.tolist(), rollouts.outcomes["touched"].tolist(), rollouts.executed.shape
    ([True], [1.0], (1, 300, 3))

    :param arm: ``"3dof"`` or ``"4dof"``
    :param n_threads: of the simulator; by default one per core
    :raises TaskError: no such arm
    """

    scene_file: ClassVar[str] = "button_press.xml"
    reward_terms: ClassVar[Mapping[str, str]] = {
        "goal": "minus the cube's final distance to the goal [m]"
    }
    context_names: ClassVar[tuple[str, ...]] = ("goal x [m]", "goal y [m]")
    tolerance: ClassVar[float] = 0.015
    thing: ClassVar[tuple[float, float] | None] = CUBE
    limits: ClassVar = ((0.435, -0.156), (0.455, -0.136))
    #: the only context, shape (2,) in m
    goal: ClassVar[FloatArray] = GOAL

    def _draw_context(self, rng: np.random.Generator) -> FloatArray:
        """Return the thesis's goal, shape (2,) in m.

        :param rng: unused
        """
        return GOAL.copy()

    def _way(self, context: FloatArray, aim: FloatArray) -> FloatArray:
        """Straight on, from in front of the cube until it is at the goal.

        The peg points away from the base all the way, as it does in the thesis's recording.
        """
        cube = np.array(CUBE)
        ahead = (aim - cube) / np.linalg.norm(aim - cube)
        line = np.linspace(cube - (HALF + BEFORE) * ahead, aim - HALF * ahead, N_POSES)
        return tip_pose(line, np.arctan2(line[:, 1], line[:, 0]), PEG)
