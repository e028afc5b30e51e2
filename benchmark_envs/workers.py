"""The tasks in worker processes: these must import this package as their parent did.

Stable-Baselines3's SubprocVecEnv starts its workers from multiprocessing's fork server. There only
the main module is imported, and Gymnasium knows no ``nmp/*`` unless that module imports this
package (pytest's does not, nor one that imports it inside a function).
"""

import multiprocessing
from multiprocessing import forkserver


def register_in_workers() -> None:
    """Let the fork server import this package, besides what it was to import before.

    A fork server that is running already stays as it is, and ``spawn`` has none: there, name
    environments with the package, as in ``"benchmark_envs:nmp/Push-v0"``.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return
    server = getattr(forkserver, "_forkserver", None)
    before = list(getattr(server, "_preload_modules", ["__main__"]))
    multiprocessing.set_forkserver_preload([*before, "benchmark_envs"])
