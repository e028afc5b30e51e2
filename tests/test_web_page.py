"""The page about runs: whole in itself, with every number, safe whatever records say."""

from html.parser import HTMLParser
from pathlib import Path

import pytest

from results.cli import main
from results.harness.record_files import write_record
from results.harness.records import ContextRecord, RolloutRecord, RunRecord
from results.web_page import page_of
from tests.records_fakes import curve_of, failed_run, finished_run, specification

VOID = {"meta", "img", "br"}


class Reader(HTMLParser):
    """Keeps cells and sources, and checks that every element is closed where it should be."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.cells: list[str] = []
        self.sources: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = dict(attrs)
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag == "img":
            self.images.append(known)
        if tag not in VOID:
            self.open.append(tag)
        if tag == "td":
            self.cells.append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "td" in self.open:
            self.cells[-1] += f" {data}"


def run(label: str, seed: int) -> RunRecord:
    line = [[0.5, -0.4 + 0.8 * i / 199] for i in range(200)]
    return finished_run(
        specification(label, seed),
        curve_of([-5.0, -1.0 - seed, -1.0, -0.5], [False, True, True, True]),
        context=ContextRecord((0.5, -0.2, 0.5, 0.0)),
        rollouts={"greedy": RolloutRecord(line, line, True, reward=-0.5)},
    )


RECORDS = [run("A", 0), run("A", 1), run("<b>B & C</b>", 0), failed_run(specification("D", 0))]


@pytest.fixture(scope="module")
def page() -> str:
    return page_of(RECORDS, Path("some runs"), ["'x.json' is damaged"])


def test_the_page_is_whole_in_itself(page: str) -> None:
    found = Reader(page)
    assert found.sources and all(source.startswith("data:image/") for source in found.sources)
    assert "default-src 'none'" in page
    assert len(found.images) >= 2 and all(image["alt"] for image in found.images)
    assert page.count("how it was made") == len(found.images)
    assert "nmp-bench plot --runs &#x27;some runs&#x27;" in page


def test_tables_stand_on_it_with_every_cell(page: str) -> None:
    cells = [" ".join(cell.split()) for cell in Reader(page).cells]
    assert "A" in cells and "<b>B & C</b>" in cells
    assert "2/2 34–100 %" in cells and "2 (2)" in cells
    assert "<b>B" not in page
    assert "D on nmp/Bottles-v0: RuntimeError: singular (seeds 0)" in page
    assert "x.json" in page and "3 of 4 finished" in page and "c0ffee" in page


def test_equal_records_give_equal_pages(page: str) -> None:
    assert page_of(RECORDS, Path("some runs"), ["'x.json' is damaged"]) == page


def test_the_command_writes_it_beside_the_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_record(tmp_path / "a.json", RECORDS[-1])
    assert main(["report", "--runs", str(tmp_path)]) == 0
    assert Reader((tmp_path / "report.html").read_text()).images == []
    assert main(["report", "--runs", str(tmp_path / "none")]) == 2
    assert "holds no readable runs" in capsys.readouterr().err
