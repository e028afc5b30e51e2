"""Where a result comes from: commit, versions, machine."""

import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from results.harness.machine import machine
from results.harness.records import Provenance

PACKAGES = (
    "sb3-nmp",
    "cma",
    "gymnasium",
    "mujoco",
    "numpy",
    "pandas",
    "scikit-learn",
    "scipy",
    "stable-baselines3",
    "torch",
)


def provenance() -> Provenance:
    """Return the commit of this code (None outside its repository), versions, platform and date."""
    commit = git("rev-parse", "HEAD") if is_own_repository() else None
    changed = git("status", "--porcelain") if commit else None
    return Provenance(
        commit=commit,
        dirty=None if changed is None else bool(changed),
        packages={name: _version(name) for name in PACKAGES},
        python=platform.python_version(),
        platform=platform.platform(),
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        machine=machine(),
    )


def is_own_repository() -> bool:
    """Tell whether git tracks this file, in a repository that is this project's from its root on.

    A copy inside another project belongs to a repository whose commits tell nothing about it.
    """
    root = git("rev-parse", "--show-toplevel")
    if root is None or Path(root).resolve() != Path(__file__).resolve().parents[2]:
        return False
    return git("ls-files", "--error-unmatch", Path(__file__).name) is not None


def git(*arguments: str) -> str | None:
    """Return what git answers in the folder of this file, None where it fails or is absent.

    :param arguments: of git
    """
    command = ["git", "-C", str(Path(__file__).parent), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=20)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
