"""The suites, one file each: which algorithms run on which tasks, and with which settings.

A suite's name is that of its file, its description the first line of the file, its content the
`Recipe` that the file calls ``RECIPE``. Hyper-parameters are chosen on seeds of 1000 and above,
which no reported run uses.
"""

import ast
from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from results.exceptions import BenchmarkError

if TYPE_CHECKING:  # a list of the suites needs no algorithm
    from results.harness.suite import Recipe

_REGISTERED: dict[str, "Recipe"] = {}


def register_suite(name: str, recipe: "Recipe") -> None:
    """Add a suite that has no file here.

    :param name: of the suite
    :param recipe: what it is made of
    """
    _REGISTERED[name] = recipe


def suite_names() -> list[str]:
    """Return the names of all suites."""
    files = [module.name.replace("_", "-") for module in iter_modules(__path__)]
    return [*sorted(files), *_REGISTERED]


def describe_suites() -> dict[str, str]:
    """Return a line about each suite by its name, without importing an algorithm."""
    lines = {name: "registered by a program" for name in _REGISTERED}
    for module in iter_modules(__path__):
        source = Path(__path__[0], f"{module.name}.py").read_text(encoding="utf-8")
        text = ast.get_docstring(ast.parse(source)) or ""
        lines[module.name.replace("_", "-")] = text.partition("\n")[0]
    return lines


def find_recipe(name: str, modules: Sequence[str] = ()) -> "Recipe":
    """Return what a suite is made of.

    :param name: of the suite
    :param modules: to import first, here and in every worker; they may register it
    :raises BenchmarkError: there is none of that name, or a module cannot be imported
    """
    from results.harness.plugins import import_modules

    import_modules(modules)
    if name in _REGISTERED:
        recipe = _REGISTERED[name]
    else:
        check_suite(name)
        recipe = import_module(f"{__name__}.{name.replace('-', '_')}").RECIPE
    return replace(recipe, imports=(*recipe.imports, *modules)) if modules else recipe


def check_suite(name: str) -> None:
    """Raise for a suite that does not exist.

    :param name: of the suite
    :raises BenchmarkError: there is none of that name
    """
    if name not in suite_names():
        raise BenchmarkError(
            f"no suite '{name}' is registered; there are {', '.join(suite_names())}."
        )
