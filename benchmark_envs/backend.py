"""MuJoCo, imported first here, and what to say where its renderer does not allow that.

MuJoCo reads ``MUJOCO_GL`` when it is imported, and raises where it cannot use that.
"""

import os

from benchmark_envs.exceptions import RenderingUnavailableError


def unavailable(why: str) -> RenderingUnavailableError:
    """Return the error of a renderer that cannot be started.

    :param why: the cause, in words, without a stop
    """
    backend = os.environ.get("MUJOCO_GL", "not set")
    return RenderingUnavailableError(
        f"no off-screen renderer could be started (MUJOCO_GL is {backend}): {why}. Set "
        "MUJOCO_GL=egl with a GPU driver, or install libosmesa6 and set MUJOCO_GL=osmesa before "
        "Python starts. Everything but rendering works without."
    )


try:
    import mujoco as mujoco
except Exception as error:  # each OpenGL platform raises its own kinds
    if not os.environ.get("MUJOCO_GL"):
        raise
    raise RenderingUnavailableError(
        f"MuJoCo cannot be imported with MUJOCO_GL: {os.environ['MUJOCO_GL']} ({error}); it must "
        "be egl (with a GPU driver), osmesa (with libosmesa6), glfw (with a display) or not set, "
        "before Python starts. Only pictures need it."
    ) from error
