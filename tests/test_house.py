"""The sizes of rooms: files that can be read in one go, functions that fit half a screen."""

import ast
from collections.abc import Iterator
from pathlib import Path
from statistics import median

ROOT = Path(__file__).parents[1]
PACKAGES = ("baselines", "benchmark_envs", "results", "sb3_nmp")
LONGEST_FILE, LONGEST_FUNCTION, MEDIAN_FUNCTION = 350, 60, 12


def sources() -> Iterator[Path]:
    for package in PACKAGES:
        yield from sorted((ROOT / package).rglob("*.py"))


def functions() -> Iterator[tuple[str, int]]:
    """Where each function stands, and its lines."""
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lines = (node.end_lineno or node.lineno) - node.lineno + 1
                yield f"{path.relative_to(ROOT)}:{node.lineno} {node.name}", lines


def test_no_file_is_longer_than_can_be_read_in_one_go() -> None:
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in sources()}
    assert {str(path): n for path, n in lines.items() if n > LONGEST_FILE} == {}


def test_functions_are_short() -> None:
    found = dict(functions())
    assert {where: lines for where, lines in found.items() if lines > LONGEST_FUNCTION} == {}
    assert median(found.values()) <= MEDIAN_FUNCTION
