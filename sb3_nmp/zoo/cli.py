"""The Zoo's scripts with our algorithms."""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from sb3_nmp.common.exceptions import ConfigurationError
from sb3_nmp.zoo.entries import ENTRIES

SCRIPTS = ("train", "enjoy")
#: registers the environments of a namespace
PACKAGES = {"nmp": "benchmark_envs"}


def main(arguments: Sequence[str]) -> int:
    """Run one of the Zoo's scripts.

    :param arguments: the script's name, and its own arguments
    :return: exit status
    """
    try:
        run(arguments)
    except ConfigurationError as error:
        print(f"sb3_nmp.zoo: {error}", file=sys.stderr)
        return 2
    return 0


def run(arguments: Sequence[str]) -> None:
    """Register the algorithms, and call the script.

    :param arguments: as in `main`
    :raises ConfigurationError: rl-zoo3 is not installed, or there is no such script
    """
    script = arguments[0] if arguments else ""
    if script not in SCRIPTS:
        raise ConfigurationError(f"there is no script '{script}'; there are {', '.join(SCRIPTS)}.")
    register()
    before = sys.argv
    sys.argv = [f"sb3_nmp.zoo {script}", *completed(script, arguments[1:])]
    try:
        getattr(import_module(f"rl_zoo3.{script}"), script)()
    finally:
        sys.argv = before


def register() -> None:
    """Make our algorithms known to the Zoo.

    :raises ConfigurationError: rl-zoo3 is not installed
    """
    if find_spec("rl_zoo3") is None:
        raise ConfigurationError("the RL Zoo is not installed: pip install 'sb3-nmp[zoo]'.")
    zoo, options = import_module("rl_zoo3"), import_module("rl_zoo3.hyperparams_opt")
    for name, entry in ENTRIES.items():
        zoo.ALGOS[name] = entry
        options.HYPERPARAMS_SAMPLER[name] = entry.sample
        options.HYPERPARAMS_CONVERTER[name] = entry.convert


def completed(script: str, arguments: Sequence[str]) -> list[str]:
    """Return a script's arguments with ours where they do not say otherwise.

    >>> completed("enjoy", ["--algo", "rcnmp", "--env", "nmp/Bottles-v0"])[-2:]
    ['--gym-packages', 'benchmark_envs']

    :param script: its name
    :param arguments: as given
    """
    given, added = list(arguments), []
    algorithm, environment = _value(given, "--algo"), _value(given, "--env")
    if script == "train" and algorithm in ENTRIES and not {"-conf", "--conf-file"} & set(given):
        added += ["--conf-file", str(Path(__file__).with_name(f"{algorithm}.yml"))]
    package = PACKAGES.get(environment.partition("/")[0])
    if package and "--gym-packages" not in given:
        added += ["--gym-packages", package]
    return given + added


def _value(arguments: list[str], option: str) -> str:
    at = arguments.index(option) + 1 if option in arguments else len(arguments)
    return arguments[at] if at < len(arguments) else ""
