"""The sizes of rooms, of files and functions that can be read in one go; the oldest versions."""

import ast
import re
import tomllib
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


def test_the_oldest_versions_that_are_tested_are_those_that_are_allowed() -> None:
    """But torch's, of which no index that pip knows by itself has an old CPU build."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    asked = [*project["dependencies"], *extras["contrib"], *extras["parquet"]]
    bounds = dict(re.match(r"([\w-]+)>=([\d.]+)", each).groups() for each in asked)  # type: ignore[union-attr]
    pins = re.findall(r"^([\w-]+)==([\d.]+)$", (ROOT / "constraints-oldest.txt").read_text(), re.M)
    told = {name: version for name, version in pins if name != "torch"}
    assert told.keys() == bounds.keys() - {"torch"}
    for name, version in told.items():
        assert version == bounds[name] or version.startswith(f"{bounds[name]}."), name
        assert not version.removeprefix(bounds[name]).strip(".0"), name
