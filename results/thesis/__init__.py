"""The tables and figures of the thesis beside ours, one file each.

The first line of a file says what the figure or table shows; its content is the `ThesisFigure` that
the file calls ``FIGURE``.
"""

import ast
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from results.exceptions import BenchmarkError

if TYPE_CHECKING:
    from results.report.text_table import Page
    from results.thesis.interface import ThesisFigure

TABLES = ("table-5.1", "table-5.2")
FIGURES = (
    "fig-5.3", "fig-5.4", "fig-5.5", "fig-5.6", "fig-5.8", "fig-5.9", "fig-5.12",
    "fig-6.2", "fig-6.3", "fig-6.4", "fig-6.5", "fig-6.6",
)  # fmt: skip
#: all that `find_figure` knows
NAMES = (*FIGURES, *TABLES)


def make_table(name: str, folder: Path) -> "Page":
    """Return a table of the thesis beside our numbers.

    :param name: one of `TABLES`
    :param folder: that holds the suites' folders
    :raises BenchmarkError: it holds no runs of the table's suites
    """
    return import_module(f"{__name__}.{_file(name)}").table(folder)


def find_figure(name: str) -> "ThesisFigure":
    """Return a figure or table of the thesis.

    :param name: one of `NAMES`
    :raises BenchmarkError: there is none of that name
    """
    if name not in NAMES:
        raise BenchmarkError(
            f"nothing of the thesis is called '{name}' here; there are {', '.join(NAMES)}."
        )
    return import_module(f"{__name__}.{_file(name)}").FIGURE


def describe(name: str) -> str:
    """Return the first line of the file of a table or figure, without importing it.

    :param name: one of `NAMES`
    """
    source = Path(__path__[0], f"{_file(name)}.py").read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]


def _file(name: str) -> str:
    return name.replace("-", "_").replace(".", "_")
