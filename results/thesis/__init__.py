"""The tables and figures of the thesis beside ours, one file each."""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from results.report.text_table import Page

TABLES = ("table-5.1", "table-5.2")


def make_table(name: str, folder: Path) -> "Page":
    """Return a table of the thesis beside our numbers.

    :param name: one of `TABLES`
    :param folder: that holds the suites' folders
    :raises BenchmarkError: it holds no runs of the table's suites
    """
    module = import_module(f"{__name__}.{name.replace('-', '_').replace('.', '_')}")
    return module.table(folder)
