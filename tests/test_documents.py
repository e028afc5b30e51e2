"""What README and docs show is true: code runs as it stands there, commands and links exist."""

import re
import shlex
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest
from matplotlib import pyplot as plt

import baselines
import benchmark_envs
import sb3_nmp
from benchmark_envs import registry, task_ids
from results.algorithms import BY_NAME
from results.cli import build_parser, main
from results.suites import check_suite
from sb3_nmp.models import cnmp_training

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("[!_]*.md")), *sorted(DOCS.glob("[!_]*/*.md"))]
TEXTS = {str(page.relative_to(ROOT)): page.read_text(encoding="utf-8") for page in PAGES}
NOTEBOOK = "file_format: mystnb"
CELL = re.compile(r"```{code-cell} python\n((?::tags: [^\n]*\n\n)?)(.*?)```", re.DOTALL)

BLOCKS = [
    pytest.param(name, block, id=f"{name}-{number}")
    for name, text in TEXTS.items()
    for number, block in enumerate(re.findall(r"```python\n(.*?)```", text, re.DOTALL))
]
COMMANDS = sorted(
    {
        (name, line.strip())
        for name, text in TEXTS.items()
        for block in re.findall(r"```[^\n]*\n.*?```|(?:^    [^\n]*\n)+", text, re.DOTALL | re.M)
        for line in block.splitlines()
        if re.match(r"\s*(nmp-bench|pip install|make|python -m) ", line)
    }
)
BENCH = [(name, line) for name, line in COMMANDS if line.startswith("nmp-bench")]
#: extras that not every environment of the tests has, by the page that needs one
NEEDS = {"docs/your_robot.md": "mink", "docs/wrappers.md": "gymnasium_robotics"}
#: what makes a documented run short enough for a test
SHORT_RUN = ["--budget", "20", "--seeds", "1", "--workers", "1"]


@pytest.fixture
def shortened(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pre-training takes a hundred steps at most."""

    def pretrain(demonstrations: Any, settings: Any, *others: Any) -> Any:
        quick = replace(settings, n_steps=min(settings.n_steps, 100))
        return cnmp_training.pretrain(demonstrations, quick, *others)

    monkeypatch.setattr("sb3_nmp.acnmp.algorithm.pretrain", pretrain)


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A folder of its own, and tasks that are forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(registry, "_TASKS", dict(registry._TASKS))
    known = set(gym.registry)
    yield
    for name in set(gym.registry) - known:
        del gym.registry[name]
    plt.close("all")


def execute(code: str, names: dict[str, Any]) -> None:
    exec(compile(code, "block", "exec"), names)


def arguments(line: str) -> list[str]:
    return shlex.split(line, comments=True)[1:]


def run_shell(cell: str) -> None:
    """Do the commands of a cell, runs in a small budget."""
    for line in cell.splitlines()[1:]:
        told = arguments(line)
        assert main([*told, *SHORT_RUN] if told[0] == "run" else told) == 0, line


@pytest.mark.usefixtures("shortened", "elsewhere")
@pytest.mark.filterwarnings("ignore:rich is experimental")
@pytest.mark.parametrize(("name", "block"), BLOCKS)
def test_a_block_of_code_runs_as_pasted(name: str, block: str) -> None:
    if name in NEEDS and find_spec(NEEDS[name]) is None:  # importing it would register its tasks
        pytest.skip(f"{NEEDS[name]} is not installed")
    execute(block, {"__name__": "__main__"})


@pytest.mark.usefixtures("shortened", "elsewhere")
@pytest.mark.parametrize("name", [name for name, text in TEXTS.items() if NOTEBOOK in text])
def test_a_notebook_runs_from_its_top(name: str) -> None:
    names: dict[str, Any] = {"__name__": "__main__"}
    cells = CELL.findall(TEXTS[name])
    assert len(cells) == TEXTS[name].count("```{code-cell}")
    for tags, cell in cells:
        if cell.startswith("%%bash"):
            run_shell(cell)
        elif "remove-input" not in tags:  # nobody sees it to paste it
            execute(cell, names)


@pytest.mark.parametrize(("name", "line"), BENCH)
def test_a_documented_command_of_the_benchmark_exists(name: str, line: str) -> None:
    told = arguments(line)
    if {"--help", "--list"} & set(told):
        with pytest.raises(SystemExit) as ended:
            build_parser().parse_args(told)
            raise SystemExit(0)
        assert ended.value.code == 0
        return
    options = build_parser().parse_args(told)
    if getattr(options, "suite", None) and not getattr(options, "task", None):
        check_suite(options.suite)
    task = getattr(options, "task", None)
    assert task is None or task in task_ids() or task.startswith("mylab/"), line
    asked = getattr(options, "algorithm", None) or []
    for algorithm in [asked] if isinstance(asked, str) else asked:
        own = algorithm.startswith("mylab.") or (task or "").startswith("mylab/")
        assert own or algorithm in BY_NAME, line


def test_other_documented_commands_exist() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M)
    others = [line for _, line in COMMANDS if not line.startswith("nmp-bench")]
    assert others
    for line in others:
        words = shlex.split(line, comments=True)
        if words[0] == "make":
            assert words[1] in targets, line
        elif words[0] == "python":
            assert find_spec(words[2]), line
        else:
            asked = re.findall(r"(?:sb3-nmp|\.)\[([\w,]+)\]", line)
            assert set(",".join(asked).split(",")) - {""} <= set(extras), line


@pytest.mark.usefixtures("elsewhere")
def test_the_readmes_commands_run_one_after_the_other() -> None:
    sb3_nmp.RCNMP("MlpPolicy", "nmp/Bottles-v0", seed=0).learn(20).save("bottles.zip")
    lines = [line for name, line in BENCH if name == "README.md"]
    does = {kind: [x for x in lines if f"nmp-bench {kind}" in x] for kind in ("run", "export")}
    assert len(does["run"]) == 1 and len(does["export"]) == 1
    run = [*arguments(does["run"][0]), *SHORT_RUN, "--algorithms", "GA", "REPS"]
    assert main(run) == 0
    after = ("nmp-bench table --suite quick", "nmp-bench plot --suite quick", "nmp-bench report")
    for start in (*after, *does["export"]):
        (line,) = (x for x in lines if x.startswith(start))
        assert main(arguments(line)) == 0, line
    assert Path("path.mcap").stat().st_size > 0


def test_every_command_is_told() -> None:
    (commands,) = (a for a in build_parser()._actions if isinstance(a.choices, dict))
    for name in commands.choices or ():
        assert f"`nmp-bench {name}`" in TEXTS["docs/api/results.md"], name


def test_links_lead_to_files() -> None:
    for name, text in TEXTS.items():
        for link in re.findall(r"\]\((?!http)([^)#]+)\)", text):
            assert (ROOT / name).parent.joinpath(link).exists(), f"{name}: {link}"


def test_every_task_and_every_algorithm_has_its_page() -> None:
    tasks = "".join(text for name, text in TEXTS.items() if name.startswith("docs/tasks/"))
    for task in task_ids():
        assert not task.startswith("nmp/") or task in tasks, task
    classes = {algorithm.path.partition(":")[2] for algorithm in BY_NAME.values()}
    told = "".join(text for name, text in TEXTS.items() if name.startswith("docs/algorithms/"))
    for name in (*classes, "SkillTransfer"):
        assert f"`{name}`" in told, name


@pytest.mark.parametrize("package", [sb3_nmp, baselines, benchmark_envs])
def test_every_public_name_says_what_it_is(package: Any) -> None:
    for name in package.__all__:
        assert getattr(package, name).__doc__, f"{package.__name__}.{name}"


def test_numbers_about_results_were_measured() -> None:
    """What pages about results say with two decimals or more stands in a measurement."""
    files = [
        *(ROOT / "results/experiments").glob("*.md"),
        ROOT / "results/leaderboard/data/README.md",
    ]
    measured = "".join(file.read_text(encoding="utf-8") for file in files)
    n_checked = 0
    for name, text in TEXTS.items():
        if not name.startswith(("README.md", "docs/results.md", "docs/algorithms/")):
            continue
        said = re.sub(r"```.*?```|\$.*?\$|`.*?`|Eq\. \d\.\d", "", text, flags=re.DOTALL)
        for number in re.findall(r"(?<![\d.])\d+\.\d{2,}(?![\d.])", said):
            n_checked += 1
            trimmed = re.escape(number.rstrip("0"))
            assert re.search(rf"(?<![\d.]){trimmed}0*(?!\d)", measured), f"{name}: {number}"
    assert n_checked > 30


def test_every_claim_has_a_verdict_and_what_it_rests_on() -> None:
    rows = [
        line.strip("|").split(" | ")
        for line in TEXTS["docs/claims.md"].splitlines()
        if line.startswith("| ")
    ]
    claims = [[cell.strip() for cell in row] for row in rows if row[0].strip() != "claim"]
    assert len(claims) > 40
    for claim in claims:
        name, place, here, twin, verdict = claim
        assert all((name, place, here, twin)), name
        assert verdict in ("held", "held in part", "not held", "not measured"), name
        assert verdict == "not measured" or re.search(r"\d", here), f"{name}: no number"
