"""The code that README and docs show runs as it stands there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCKS = [
    pytest.param(block, id=f"{page.name}-{number}")
    for page in PAGES
    for number, block in enumerate(re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL))
]


@pytest.mark.filterwarnings("ignore:rich is experimental")
@pytest.mark.parametrize("block", BLOCKS)
def test_a_block_of_code_runs_as_pasted(
    block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(block, "block", "exec"), {"__name__": "__main__"})


def test_links_lead_to_files() -> None:
    for page in PAGES:
        for link in re.findall(r"\]\((?!http)([^)#]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_every_claim_has_a_verdict_and_what_it_rests_on() -> None:
    text = (ROOT / "docs" / "claims.md").read_text(encoding="utf-8")
    rows = [line.strip("|").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    claims = [[cell.strip() for cell in row] for row in rows if row[0].strip() != "claim"]
    assert len(claims) > 40
    for claim in claims:
        name, place, here, twin, verdict = claim
        assert all((name, place, here, twin)), name
        assert verdict in ("held", "held in part", "not held", "not measured"), name
        assert verdict == "not measured" or re.search(r"\d", here), f"{name}: no number"
