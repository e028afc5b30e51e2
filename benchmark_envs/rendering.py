"""Off-screen pictures of physics states."""

import os
import sys

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmark_envs.backend import unavailable
from benchmark_envs.exceptions import TaskError
from benchmark_envs.rollouts import FloatArray

#: what MuJoCo takes for MUJOCO_GL so that it loads no renderer
SWITCHED_OFF = ("disable", "disabled", "off", "false", "0")


def draw(
    model: mujoco.MjModel, states: FloatArray, camera: str, width: int, height: int
) -> list[NDArray[np.uint8]]:
    """Draw each physics state from a named camera.

    :param states: full physics states, shape (K, nstate)
    :param camera: its name in the model
    :param width: of the picture, in pixels
    :param height: of the picture, in pixels
    :return: K pictures of shape (height, width, 3)
    :raises RenderingUnavailableError: no off-screen renderer on this machine
    :raises TaskError: no such camera, or a picture of no size or larger than the model's buffer
    """
    _check(model, camera, width, height)
    if _named_backend() in SWITCHED_OFF:
        raise unavailable("that switches MuJoCo's rendering off")
    if _lacks_display():  # GLFW's half-made window would raise errors until Python ends
        raise unavailable("there is no display")
    try:
        renderer = mujoco.Renderer(model, height, width)
    except Exception as error:  # each OpenGL platform raises its own kinds
        raise unavailable(str(error)) from error
    data = mujoco.MjData(model)
    pictures: list[NDArray[np.uint8]] = []
    with renderer:
        for state in states:
            mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            pictures.append(renderer.render().copy())
    return pictures


def _check(model: mujoco.MjModel, camera: str, width: int, height: int) -> None:
    names = [model.camera(i).name for i in range(model.ncam)]
    if camera not in names:
        raise TaskError(f"no camera '{camera}'; there are {', '.join(names)}.")
    most = (model.vis.global_.offwidth, model.vis.global_.offheight)
    if not (0 < width <= most[0] and 0 < height <= most[1]):
        raise TaskError(
            f"a picture of {width} x {height} pixels cannot be drawn; each side must be at least "
            f"1, and at most {most[0]} x {most[1]}."
        )


def _named_backend() -> str:
    return os.environ.get("MUJOCO_GL", "").lower().strip()


def _lacks_display() -> bool:
    """Tell whether MuJoCo would open a window where nothing can show one."""
    by_window = _named_backend() in ("", "glfw")
    shown = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return sys.platform == "linux" and by_window and not shown
