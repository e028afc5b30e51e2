"""The tables and figures of the thesis beside ours, one file each.

The first line of a figure's file says what it shows; its content is the `ThesisFigure` that the
file calls ``FIGURE``.
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
FIGURES = ("fig-6.2", "fig-6.3", "fig-6.4", "fig-6.5", "fig-6.6")


def make_table(name: str, folder: Path) -> "Page":
    """Return a table of the thesis beside our numbers.

    :param name: one of `TABLES`
    :param folder: that holds the suites' folders
    :raises BenchmarkError: it holds no runs of the table's suites
    """
    return import_module(f"{__name__}.{_file(name)}").table(folder)


def find_figure(name: str) -> "ThesisFigure":
    """Return a figure of the thesis.

    :param name: one of `FIGURES`
    :raises BenchmarkError: there is none of that name
    """
    if name in TABLES:
        raise BenchmarkError(
            f"'{name}' is a table: 'nmp-bench table {name}' prints it from the runs of its suites."
        )
    if name not in FIGURES:
        raise BenchmarkError(
            f"nothing of the thesis is called '{name}' here; there are {', '.join(FIGURES)}, and "
            f"by 'nmp-bench table' {', '.join(TABLES)}."
        )
    return import_module(f"{__name__}.{_file(name)}").FIGURE


def describe(name: str) -> str:
    """Return the first line of the file of a table or figure, without importing it.

    :param name: one of `TABLES` and `FIGURES`
    """
    source = Path(__path__[0], f"{_file(name)}.py").read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]


def _file(name: str) -> str:
    return name.replace("-", "_").replace(".", "_")
