"""`VecNormalize` in files without pickles: its settings and its running statistics.

Stable-Baselines3's own ``VecNormalize.save`` writes a pickle, and its ``load`` runs what is in it.
"""

from typing import Any

from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from sb3_nmp.common import files
from sb3_nmp.common.exceptions import FileFormatError

SETTINGS = (
    "training", "norm_obs", "norm_reward", "clip_obs", "clip_reward", "gamma", "epsilon",
    "norm_obs_keys",
)  # fmt: skip
STATISTICS = ("obs_rms", "ret_rms")


def save_vec_normalize(env: VecNormalize, path: files.AnyPath) -> None:
    """Write settings and statistics of a `VecNormalize`.

    :param env: whose
    :param path: of the file, or an open one
    """
    statistics = {name: getattr(env, name) for name in STATISTICS if hasattr(env, name)}
    settings = {name: getattr(env, name) for name in SETTINGS}
    files.write(path, "normalization", {"settings": settings, "statistics": statistics})


def load_vec_normalize(
    path: files.AnyPath, venv: VecEnv, *, allow_pickle: bool = False
) -> VecNormalize:
    """Return environments that are normalised as saved. No code from the file is run.

    :param path: of a file that `save_vec_normalize` wrote, or an open one
    :param venv: the environments
    :param allow_pickle: read what SB3's ``VecNormalize.save`` wrote, which **can run any code**;
        such a file must be given by its path
    :raises FileFormatError: it is no such file
    """
    try:
        saved = files.read(path, "normalization")
    except FileFormatError as error:
        if not allow_pickle:
            raise FileFormatError(
                f"{error} A pickle of SB3's VecNormalize.save can run any code: if you trust who "
                "wrote it, give allow_pickle=True."
            ) from error
        return VecNormalize.load(str(path), venv)
    settings: dict[str, Any] = saved["settings"]
    env = VecNormalize(venv, **settings)
    vars(env).update(saved["statistics"])
    return env
