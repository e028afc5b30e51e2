"""`follow`: joint angles that lead an arm's tip through via-poses, by differential kinematics.

The steps are mink's (https://github.com/kevinzakka/mink): at each time point a quadratic program
finds joint velocities that bring the tip nearer to where it should be, keep each joint inside its
range, and stay near to the start posture where an arm has joints to spare.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmark_envs.exceptions import TaskError
from benchmark_envs.robots.arm import Arm
from benchmark_envs.robots.via_poses import ViaPose, smooth_way
from benchmark_envs.rollouts import FloatArray

if TYPE_CHECKING:
    import mink

SOLVER = "daqp"
ITERATIONS = 2  # per time point; the second solves for what the first one left
POSTURE_COST, AXIS_COST, DAMPING = 1e-3, 0.3, 1e-4


def follow(arm: Arm, way: Sequence[ViaPose], times: FloatArray, dt: float) -> FloatArray:
    """Return the joints over time that lead the tip through via-poses, shape (T, D).

    The tip moves in straight lines from where it is at the arm's start, and rests in each pose. It
    need not arrive: whoever asks has to look (`ArmTask` does).

    :param arm: that moves
    :param way: via-poses, checked
    :param times: of the set-points, as parts of the duration, shape (T,)
    :param dt: between them, in s
    :raises TaskError: mink is not installed, or has no solution
    """
    mink = _mink()
    start = arm.tip_pose(arm.start)
    positions, axes = smooth_way(start, way, times)
    configuration = mink.Configuration(arm.kinematic, arm.start.copy())
    tip = mink.FrameTask(arm.tip, arm.frame, position_cost=1.0, orientation_cost=0.0)
    tasks: list[Any] = [tip, _posture(arm, mink)]
    pointing = mink.AxisAlignTask(arm.tip, arm.frame, axis=arm.axis, cost=AXIS_COST)
    if axes is not None:
        tasks.append(pointing)
    limits = [mink.ConfigurationLimit(arm.kinematic)]
    joints = np.empty((len(times), arm.n_joints))
    for t, position in enumerate(positions):
        tip.set_target(mink.SE3.from_translation(position))
        if axes is not None:
            pointing.set_target(axes[t])
        for _ in range(ITERATIONS):
            try:
                velocity = mink.solve_ik(
                    configuration, tasks, dt, SOLVER, damping=DAMPING, limits=limits
                )
            except mink.NoSolutionFound as error:
                raise TaskError(
                    f"the expert finds no joint angles at {times[t]:.2f} of the duration: {error}"
                ) from error
            configuration.integrate_inplace(velocity, dt)
        joints[t] = configuration.q
    return np.clip(joints, arm.low, arm.high)


def _posture(arm: Arm, mink: Any) -> "mink.PostureTask":  # noqa: ANN401
    posture = mink.PostureTask(arm.kinematic, cost=POSTURE_COST)
    posture.set_target(arm.start)
    return posture


def _mink() -> Any:  # noqa: ANN401
    try:
        import mink
    except ImportError as error:
        raise TaskError(
            "the expert of an arm needs mink, which is not installed; install it with "
            "'pip install sb3-nmp[robots]', or give Demonstrations of your own."
        ) from error
    return mink
