"""What decides the last bits of a result besides the versions of packages."""

import platform
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
from threadpoolctl import threadpool_info


@dataclass(frozen=True)
class Machine:
    """What decides the last bits of a result besides versions: equal ones give equal results.

    :param architecture: such as ``"x86_64"``
    :param features: of the CPU that NumPy makes use of
    :param blas: the libraries of linear algebra in use, each with the kernel it chose
    :param libc: the C library, which computes sines and exponentials
    :param cpu: its name, which decides nothing
    """

    architecture: str
    features: tuple[str, ...]
    blas: tuple[str, ...]
    libc: str
    cpu: str = field(default="", compare=False)


def machine() -> Machine:
    """Return what decides the last bits of this process's results besides versions."""
    config = cast(dict[str, Any], np.show_config(mode="dicts"))  # type: ignore[call-overload]
    simd = config.get("SIMD Extensions", {})
    kernels = {
        f"{library['internal_api']} {library.get('architecture', '')}".strip()
        for library in threadpool_info()
        if library["user_api"] == "blas"
    }
    return Machine(
        architecture=platform.machine(),
        features=tuple(sorted({*simd.get("baseline", ()), *simd.get("found", ())})),
        blas=tuple(sorted(kernels)),
        libc=" ".join(platform.libc_ver()),
        cpu=_cpu_name(),
    )


def _cpu_name() -> str:
    """Return the CPU's name, as Linux tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
