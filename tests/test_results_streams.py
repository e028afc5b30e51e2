"""Numbers, tables and plots of runs on streams of contexts, and Table 5.1."""

import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread

from results.adaptation.protocol import LeaveOneOut
from results.cli import main
from results.exceptions import BenchmarkError
from results.harness.record_files import read_records
from results.harness.records import ProtocolRecord, RunRecord
from results.harness.specification import Algorithm
from results.harness.suite import Recipe
from results.leaderboard.boards import BOARDS, DATA
from results.report.frames import curves_frame
from results.report.statistics import mean_interval
from results.stream.evaluation import schedule
from results.stream.figures import by_seed_on_grid, stream_curves
from results.stream.protocol import Stream
from results.stream.summary import frame, summarise
from results.stream.tables import tables
from results.suites import find_recipe, suite_names
from results.thesis.table_5_1 import table as table_5_1
from tests.records_fakes import finished_run, specification
from tests.results_fakes import TARGET_TASK, suite_of, target_task

TASK = "nmp/Aperture-v0"
ADAPTIVE = Algorithm("adaptive", "tests.results_fakes:Adaptive")


def record(label: str, seed: int, rates: dict[int, float], in_contexts: list[int]) -> RunRecord:
    asked = specification(label, seed, TASK, 1000, ProtocolRecord("stream"))
    curve = {
        "rollouts": list(rates),
        "contexts": [min(count // 2, len(in_contexts)) for count in rates],
        "failure_rate": list(rates.values()),
        "mean_reward": [-rate for rate in rates.values()],
    }
    visits = {"contexts": {"rollouts": in_contexts, "exhausted": True}}
    return finished_run(asked, curve, training=10.0 + seed, more=visits)


RECORDS = [
    record("A", 0, {0: 0.5, 100: 0.1, 200: 0.05, 300: 0.09}, [1, 1, 7]),
    record("A", 1, {0: 0.3, 100: 0.02, 300: 0.01}, [1, 30, 2]),
    record("B", 0, {40: 0.4, 1000: 0.2}, [9, 9]),
]


def test_summary_equals_hand_computation():
    summary = summarise(frame(RECORDS), ["A", "B", "C"]).set_index("label")
    a = summary.loc["A"]
    assert a["first_failure_rate_mean"] == pytest.approx(0.4)
    assert a["failure_rate_mean"] == pytest.approx(0.05)
    assert (a["failure_rate_low"], a["failure_rate_high"]) == pytest.approx((0.01, 0.09))
    assert (a["rollouts"], a["contexts"], a["retried"], a["most_rollouts"]) == (300, 3, 1.5, 30)
    assert a["rollouts_to_0.0906_median"] == 150  # 200 for good, and 100
    assert math.isinf(a["rollouts_to_0.02_median"]) and a["rollouts_to_0.02_q25"] == math.inf
    assert math.isnan(summary.loc["B", "failure_rate_low"])  # type: ignore[arg-type]
    assert summary.loc["C", "reason"] == "not run"


def test_a_rate_counts_from_where_it_stays():
    runs = frame(RECORDS)
    assert runs["rollouts_to_0.0906"].tolist() == [200.0, 100.0, math.inf]
    assert runs["rollouts_to_0.02"].tolist() == [math.inf, 100.0, math.inf]


def test_mean_interval_works_along_a_curve():
    rows = np.random.default_rng(0).normal(size=(8, 5)) + np.arange(5)
    low, high = mean_interval(rows)
    assert low.shape == high.shape == (5,)
    assert (low < rows.mean(axis=0)).all() and (rows.mean(axis=0) < high).all()
    alone = mean_interval(rows[:, 2])
    assert np.allclose(alone, (low[2], high[2]))
    assert np.isnan(mean_interval(rows[:1])).all()


def test_table_tells_rates_prices_and_intervals():
    runs = frame(RECORDS)
    text = tables(runs, ["A", "B", "C"]).markdown()
    assert "| A | 2 | 40.0 % [30.0,50.0] | 5.0 % [1.0,9.0] | 150 (125–175) | >300 (>300) |" in text
    assert "40.0 % one seed" in text and "| C | 0 | not run |" in text


def test_rates_are_linear_between_evaluations_and_held_at_the_ends():
    curves = curves_frame(RECORDS)
    grid, rates = by_seed_on_grid(curves.loc[curves["label"] == "A"], "rollouts")
    assert grid.tolist() == [0, 100, 200, 300]
    assert rates[1] == pytest.approx([0.3, 0.02, 0.015, 0.01])
    grid, rates = by_seed_on_grid(curves.loc[curves["label"] == "A"], "contexts")
    assert grid.tolist() == [0, 3] and rates[0] == pytest.approx([0.5, 0.09])


def test_figure_shows_contexts_and_rollouts():
    figure = stream_curves(curves_frame(RECORDS), ["A", "B", "C"])
    assert "seen" in figure.axes[0].get_xlabel() and "rollouts" in figure.axes[1].get_xlabel()
    entries = [text.get_text() for text in figure.legends[0].get_texts()]
    assert entries == ["A (2 seeds)", "B (1 seed)"]


# -- suites of skills over contexts ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "budget", "n_test", "alone"),
    [("random-push", 3000, 500, {"RC-NMP, no relabelling"}), ("random-pouring", 500, 100, set())],
)
def test_a_skill_stands_beside_its_twins(name: str, budget: int, n_test: int, alone: set[str]):
    """Nothing is demonstrated, and trying the policy costs no more rollouts than two runs."""
    recipe = find_recipe(name)
    twins = {"twin, nearest", "twin, ridge", "twin, Gaussian process"}
    rivals = {"contextual CMA-ES", "contextual REPS"}
    assert set(recipe.algorithms) == {"RC-NMP"} | twins | rivals | alone
    assert (recipe.budget, recipe.n_seeds) == (budget, 5)
    (protocol,) = recipe.protocols
    assert protocol.settings["n_demonstrations"] == 0 and protocol.settings["n_test"] == n_test
    by_rollouts, by_contexts = schedule(
        budget, protocol.settings["n_contexts"], protocol.settings["n_evaluations"]
    )
    n_evaluations = len(by_rollouts) + 1 + int((by_contexts <= budget).sum())
    assert n_evaluations >= 3 and n_evaluations * n_test <= 2 * budget


#: by the name of a method with a network: that of the same without one
TWINS = {"rcnmp": "ga", "acnmp": "bo"}
#: suites that compare a network with itself: the suites they belong to have the twins
WITHIN = {"aperture-ablations", "assimilation"}


@pytest.mark.parametrize("suite", sorted({*suite_names()} - WITHIN))
def test_no_network_stands_in_a_suite_without_its_twin(suite: str):
    names = {each.name for each in find_recipe(suite).algorithms.values()}
    assert {TWINS[name] for name in names if name in TWINS} <= names


@pytest.mark.parametrize("name", BOARDS)
def test_no_network_stands_on_a_board_without_its_twin(name: str):
    """What is committed is told, not what could be made."""
    rows = [json.loads(path.read_text())["row"] for path in (DATA / name).glob("*.json")]
    names = {row["algorithm"] for row in rows}
    assert len(rows) >= 5 and {TWINS[each] for each in names if each in TWINS} <= names


def test_fewer_evaluations_are_another_protocol():
    assert Stream(n_evaluations=24).settings == Stream().settings
    assert Stream(n_evaluations=5).settings != Stream().settings
    with pytest.raises(BenchmarkError, match="n_evaluations is 0; a stream needs at least 1"):
        Stream(n_evaluations=0)


# -- from the command line ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Runs of small suites that bear the names of the thesis's."""
    absent = Algorithm("absent", "tests.results_fakes:NoSuchClass")
    algorithms = {"ACNMP": ADAPTIVE, "ProMP+RL (Stark)": absent, "ProMP+RL (Ewerton)": ADAPTIVE}
    held_out = tuple(LeaveOneOut(target, target in (2, 9)) for target in (4, 9))
    recipes = {
        "push": Recipe(algorithms, {TARGET_TASK: {}}, 45, 2, held_out),
        "aperture": Recipe(algorithms, {TARGET_TASK: {}}, 60, 2, (Stream(4, 8, 20),)),
    }
    out = tmp_path_factory.mktemp("runs")
    with target_task(), suite_of(recipes):
        for name in recipes:
            arguments = ["run", "--suite", name, "--out", str(out / name), "--workers", "1"]
            assert main(arguments) == 0
        yield out


def test_runs_are_resumed_and_told_about(folder: Path, capsys: pytest.CaptureFixture[str]):
    arguments = ["run", "--suite", "push", "--algorithms", "acnmp", "--out", str(folder / "push")]
    assert main(arguments) == 0
    assert "4 of 4 runs are finished" in capsys.readouterr().out
    names = [path.name for path in (folder / "push").glob("acnmp_*.json")]
    assert "acnmp_fake-targets-v0_target-09_seed-001.json" in names and len(names) == 4


@pytest.mark.parametrize("suite", ["push", "aperture"])
def test_tables_and_plots_fit_the_protocol(
    folder: Path, suite: str, capsys: pytest.CaptureFixture[str]
):
    assert main(["table", "--runs", str(folder / suite), "--suite", suite]) == 0
    printed = capsys.readouterr().out
    assert {"push": "extrapolation", "aperture": "fail at the end"}[suite] in printed
    assert "NoSuchClass" in printed and "…" not in printed
    numbers = pd.read_csv(folder / suite / "table.csv")
    assert set(numbers["label"]) == {"ACNMP", "ProMP+RL (Stark)", "ProMP+RL (Ewerton)"}
    assert (folder / suite / "table.md").read_text().startswith("## fake/Targets-v0")
    assert main(["plot", "--runs", str(folder / suite), "--suite", suite]) == 0
    picture = imread(folder / suite / "curves_fake-targets-v0.png")
    assert picture.shape[0] > 400 and len(np.unique(picture[..., 0])) > 10


def test_table_5_1_stands_beside_the_thesis(folder: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["table", "table-5.1", "--runs", str(folder)]) == 0
    printed = capsys.readouterr().out
    text = (folder / "table-5.1.md").read_text()
    for number in ("130", "1200 [Stark et al.]", "1.4K", "20K [Ewerton et al.]", "0.7M"):
        assert number in text
    (row,) = (line for line in text.splitlines() if line.startswith("| aperture: rollouts in a s"))
    assert row.endswith("| 5 | 5 |")
    (row,) = (line for line in text.splitlines() if line.startswith("| pushing"))
    assert "(worst " in row and row.endswith("| failed |")
    assert f"- push: nmp-bench run --suite push --out {folder / 'push'}\n" in text
    assert "Written" in printed and "…" not in printed


def test_table_5_1_tells_what_to_run(folder: Path, tmp_path: Path):
    with pytest.raises(BenchmarkError, match=r"run --suite push --out .* and .* --suite aperture"):
        table_5_1(tmp_path)
    (tmp_path / "aperture").symlink_to(folder / "aperture")
    text = table_5_1(tmp_path).markdown()
    assert "| not run | not run |" in text
    assert f"- push: nmp-bench run --suite push --out {tmp_path / 'push'}\n" in text
    (tmp_path / "push").symlink_to(folder / "aperture")
    with pytest.raises(BenchmarkError, match="runs of the protocol stream"):
        table_5_1(tmp_path)


def test_a_stream_has_no_rollout_to_draw(folder: Path, capsys: pytest.CaptureFixture[str]):
    run = next((folder / "aperture").glob("acnmp_*.json"))
    assert main(["render", TARGET_TASK, "--run", str(run), "--out", "x.gif"]) == 2
    assert "holds no rollout" in capsys.readouterr().err


def test_the_records_are_small(folder: Path):
    assert len(read_records(folder / "aperture").records) == 6
    assert all(path.stat().st_size < 20_000 for path in folder.rglob("*.json"))
