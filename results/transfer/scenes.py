"""What Figure 5.8 draws: the skills of both arms from above, as polygons and lines in m."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmark_envs import make_task
from benchmark_envs.tasks.planar_arm_task import PlanarArmTask
from benchmark_envs.tasks.planar_arms import PEG, PlanarArm
from results.transfer.skills import BUTTON, PROXIES, SOURCE, TARGET

FloatArray = NDArray[np.float64]
#: at which parts of the time the arm is drawn
MOMENTS = (0.0, 0.5, 1.0)
#: which of the four skills of each kind is drawn
DRAWN = {"nmp/ArmReach-v0": 2, "nmp/ArmPush-v0": 2, "nmp/PegInsertion-v0": 1}


def scenes(contexts: FloatArray) -> list[dict[str, Any]]:
    """Return one skill of each kind and the button press, each by both arms, as JSON values.

    :param contexts: of the proxies, as `proxy_contexts` returns them
    """
    kinds = list(PROXIES)
    chosen = {k: contexts[contexts[:, 0] == i][DRAWN[k], 1:] for i, k in enumerate(kinds)}
    found = []
    for arm in (SOURCE, TARGET):
        for name in (*kinds, BUTTON):
            task = make_task(name, n_threads=1, arm=arm)
            assert isinstance(task, PlanarArmTask)
            context = chosen.get(name, task.sample_context(np.random.default_rng(0)))
            found.append({"task": name, "arm": arm} | scene(task, context))
    return found


def scene(task: PlanarArmTask, context: FloatArray) -> dict[str, Any]:
    """Return the expert's rollout from above: the arm at some moments, walls, thing and target.

    :param task: the skill of an arm
    :param context: shape (2,) in m
    """
    context = task.check_context(context)
    rollouts = task.simulate(context, task.demonstrate(context))
    joints = rollouts.executed[0]
    at = [round(share * (len(joints) - 1)) for share in MOMENTS]
    path = next(iter(rollouts.paths.values()))[0]
    return {
        "arm_lines": [arm_line(task.kinematics, joints[t]).round(4).tolist() for t in at],
        "boxes": [box.round(4).tolist() for box in boxes(task.model, context)],
        "thing": [path[0].round(4).tolist(), path[-1].round(4).tolist()] if task.thing else [],
        "path": path[::5].round(4).tolist(),
        "target": context.tolist(),
        "solved": bool(rollouts.successes[0]),
    }


def arm_line(arm: PlanarArm, joints: FloatArray) -> FloatArray:
    """Return base, joints and tip of an arm, shape (D + 2, 2) in m.

    :param arm: which
    :param joints: shape (D,) in rad
    """
    headings = np.cumsum(joints + np.array(arm.offsets))
    ahead = np.stack([np.cos(headings), np.sin(headings)], axis=1)
    lengths = np.array([*arm.links, arm.mount])[:, None]
    corners = np.cumsum(np.vstack([np.zeros((1, 2)), lengths * ahead]), axis=0)
    return np.vstack([corners, corners[-1] + PEG * ahead[-1]])


def boxes(model: mujoco.MjModel, context: FloatArray) -> list[FloatArray]:
    """Return the corners of the walls, each of shape (4, 2) in m.

    :param model: of the scene; walls of its body ``target`` stand at the context, facing the base
    :param context: shape (2,) in m
    """
    found, target = [], model.body("target").id
    bearing = np.arctan2(context[1], context[0])
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        is_box = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX
        if not is_box or body not in (0, target) or not model.geom_conaffinity[geom]:
            continue
        corners = model.geom_size[geom, :2] * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
        w, *_, z = model.geom_quat[geom]
        corners = turned(corners, 2 * np.arctan2(z, w)) + model.geom_pos[geom, :2]
        found.append(corners if body == 0 else turned(corners, bearing) + context)
    return found


def turned(points: FloatArray, angle: float) -> FloatArray:
    """Return points turned about the origin, shape (K, 2).

    :param points: shape (K, 2)
    :param angle: in rad
    """
    cos, sin = np.cos(angle), np.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])
