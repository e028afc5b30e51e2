"""`nmp-bench reproduce`: claims judged from records, its errors, and a real quick run."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from results.cli import main
from results.exceptions import BenchmarkError, SettingsClashError
from results.harness.record_files import read_records
from results.harness.records import (
    ContextRecord,
    ProtocolRecord,
    RolloutRecord,
    RunRecord,
    TaskRecord,
)
from results.reproduce import specifications
from results.sampling.curves import BUNDLES, curves, heights_of
from results.sampling.measures import bundles_found, in_gap, inside, spanned
from results.sampling.runs import run_sampling, sampling_runs
from results.thesis import NAMES, describe, find_figure
from results.thesis.interface import Finding, SuiteRuns, verdict
from tests.records_fakes import curve_of, finished_run, specification

POINTS = TaskRecord(("x [m]",), ("y [m]",), 0.005, error_unit="m")


def held(name: str, records: dict[str, list[RunRecord]]) -> list[bool]:
    figure = find_figure(name)
    assert figure.draw is not None and figure.draw(records).axes, (
        "it can be drawn whatever the verdict"
    )
    return [finding.held for finding in figure.findings(records)]


# -- measures of samples ---------------------------------------------------------------------------


def test_a_sample_is_inside_only_if_it_never_leaves_the_widened_envelope() -> None:
    shown = curves([-0.5, 0.5])[..., 0]
    tries = np.stack([shown[0], 1.015 * shown[1], 1.05 * shown[1], np.zeros(200)])
    tries[3, 0] = 0.03  # wider than 2 % of the largest width, at one moment
    assert inside(tries, shown).tolist() == [True, True, False, False]
    assert spanned(curves([-0.2, 0.3, 2.0])[..., 0], shown) == pytest.approx(0.5, abs=1e-6)


def test_gaps_and_bundles_are_told_by_height() -> None:
    bundles = BUNDLES["two bundles"]
    drawn = curves([-0.65, -0.45, -0.29, -0.1, 0.2, 0.3, 0.6])
    np.testing.assert_allclose(heights_of(drawn)[:2], [-0.65, -0.45])
    assert in_gap(drawn, bundles).tolist() == [False, False, False, True, True, False, False]
    own = np.array([0, 0, 0, 2, 2, 1, 1])
    assert bundles_found(drawn[1:], own[1:], bundles) == 2
    assert bundles_found(drawn[1:], np.zeros(6, int), bundles) == 0, "one category bridges the gap"


# -- verdicts from records -------------------------------------------------------------------------


def sampled(label: str, variant: str, k: int, **more: Any) -> RunRecord:
    asked = specification(label, 0, "sampling", protocol=ProtocolRecord("sampling"))
    asked = replace(asked, variant=variant, settings={"n_categories": k})
    paths = [[0.0] * 200] * 2
    return finished_run(
        asked, {"rollouts": [0]}, more={"samples": paths, "categories": [0, k - 1], **more}
    )


@pytest.mark.parametrize("good", [True, False])
def test_figure_6_2_holds_only_where_samples_cover_and_categories_part(good: bool) -> None:
    runs = [
        sampled("CNMP", "six demonstrations", 0, mean=[0.0] * 200, std=[0.1] * 200),
        sampled(
            "RC-NMP", "six demonstrations", 1,
            inside=0.97 if good else 0.94, spanned=0.95 if good else 0.85,
        ),
        sampled("RC-NMP", "two bundles", 1, gap=0.4),
        sampled("RC-NMP, 2 categories", "two bundles", 2, gap=0.04 if good else 0.06),
        sampled("RC-NMP, 6 categories", "six bundles", 6, found=6 if good else 5, gap=0.0),
    ]  # fmt: skip
    assert held("fig-6.2", {"fig-6.2": runs}) == [good] * 4


def via_run(label: str, seed: int, variant: str, errors: tuple[float, float]) -> RunRecord:
    asked = replace(
        specification(label, seed, "nmp/ViaPoints-v0", budget=10), variant=f"{variant} points"
    )
    curve = curve_of([-errors[0]] * 2 + [-errors[1]] * 8, [False] * 10)
    steep = 10.0 if errors[1] > 0.05 else 1.0
    scene = {"targets": [[0.2, 0.0], [0.3, 0.1 * steep], [0.9, 0.5]]}
    rollouts = {"greedy": RolloutRecord([[0.1]] * 5)}
    return finished_run(
        asked, curve, POINTS, context=ContextRecord((0.0,), scene), rollouts=rollouts
    )


@pytest.mark.parametrize("good", [True, False])
def test_figure_6_4_needs_intervals_of_paired_differences_above_zero(good: bool) -> None:
    sign, rng, runs = 1.0 if good else -1.0, np.random.default_rng(0), []
    for variant, hard in (("2", 0.0), ("6", 0.2)):
        for seed in range(6):
            level = 0.4 + hard * sign + 0.1 * rng.random()
            by_label = {
                "RC-NMP": (level, level - 0.2),
                "RC-NMP without crossover": (level + 0.01 * sign, level - 0.2),
                "RC-NMP without mutation": (level, level - 0.2 + 0.01 * sign),
                "ACNMP, policy gradient": (level, level - 0.2 + 0.01 * sign),
                "ACNMP": (level, level - 0.2 + 0.01 * sign),
            }
            runs += [via_run(name, seed, variant, pair) for name, pair in by_label.items()]
    assert held("fig-6.4", {"via-points": runs}) == [good] * 5


def test_figure_6_4_does_not_hold_for_a_difference_that_noise_explains() -> None:
    rng, runs = np.random.default_rng(1), []
    for label in find_figure("fig-6.4").full[0].labels:  # pyright: ignore[reportAttributeAccessIssue]
        for variant in ("2", "6"):
            runs += [via_run(label, s, variant, (0.5, 0.3 + 0.1 * rng.random())) for s in range(4)]
    assert held("fig-6.4", {"via-points": runs})[:4] == [False] * 4


@pytest.mark.parametrize("good", [True, False])
def test_figure_6_3_shows_the_least_and_the_largest_error(good: bool) -> None:
    ends = (0.001, 0.002, 0.08, 0.1) if good else (0.02, 0.03, 0.03, 0.04)
    runs = [via_run("RC-NMP", seed, "4", (0.5, end)) for seed, end in enumerate(ends)]
    assert held("fig-6.3", {"via-points": runs}) == [good, True, good]


def stopped(budget: int, seed: int, solved: bool, mode: str) -> RunRecord:
    asked = specification("RC-NMP", seed, budget=budget)
    path = [[0.5, -0.4], [0.5, 0.4]]
    rollout = RolloutRecord(path, path, solved, mode if solved else "")
    return finished_run(asked, curve_of([-1.0], [solved]), rollouts={"greedy": rollout})


@pytest.mark.parametrize("good", [True, False])
def test_figure_6_5_needs_collisions_before_solutions_in_both_modes(good: bool) -> None:
    modes = ("s", "reverse_s") if good else ("s", "s")
    early = [stopped(1, seed, not good, mode) for seed, mode in enumerate(modes)]
    late = [stopped(40, seed, True, mode) for seed, mode in enumerate(modes)]
    assert held("fig-6.5", {"a": early, "b": late}) == [good, good]


@pytest.mark.parametrize("good", [True, False])
def test_figure_6_6_compares_solved_runs_and_rollouts(good: bool) -> None:
    solved = (
        {"RC-NMP": 20, "DREPS": 20, "REPS": 8} if good else {"RC-NMP": 8, "DREPS": 8, "REPS": 8}
    )
    after = {"RC-NMP": 2, "DREPS": 12, "REPS": 12}
    runs = []
    for label, count in solved.items():
        for seed in range(20):
            successes = [i >= after[label] - 1 and seed < count for i in range(15)]
            rewards = [-0.1 if success else -4.0 for success in successes]
            asked = specification(label, seed, budget=15)
            runs.append(finished_run(asked, curve_of(rewards, successes)))
    assert held("fig-6.6", {"bottles": runs}) == [good] * 4


def test_a_verdict_is_held_in_part_where_one_claim_of_two_holds() -> None:
    yes, no = Finding("a", "", "", True), Finding("b", "", "", False)
    assert [verdict(found) for found in ([yes], [yes, no], [no])] == [
        "held", "held in part", "not held",
    ]  # fmt: skip


def test_a_figure_without_a_finished_run_says_which_there_are() -> None:
    with pytest.raises(BenchmarkError, match="no run of RC-NMP on 4 points has finished"):
        find_figure("fig-6.3").findings({"via-points": [via_run("GA", 0, "4", (1.0, 0.5))]})


# -- runs and the command line ---------------------------------------------------------------------


def test_every_figure_names_its_file_and_runs_that_exist() -> None:
    for name in NAMES:
        figure, (kind, _, number) = find_figure(name), name.partition("-")
        begins = f"{'Figure' if kind == 'fig' else 'Table'} {number}: "
        assert figure.name == name and describe(name).startswith(begins)
        for asked in (*figure.full, *figure.quick):
            if isinstance(asked, SuiteRuns):
                runs = specifications(asked)
                assert {run.label for run in runs} == set(asked.labels)
                numbers = {run.protocol.number for run in runs}
                assert asked.numbers is None or numbers == set(asked.numbers)
    (quick,) = find_figure("fig-6.4").quick
    assert isinstance(quick, SuiteRuns)
    assert {run.variant for run in specifications(quick)} == {"2 points", "4 points", "6 points"}
    with pytest.raises(BenchmarkError, match="no variant 9 points; it has 1 point, 2 points"):
        specifications(replace(quick, variants=("9 points",)))
    (pushed, _) = find_figure("fig-5.6").quick
    assert isinstance(pushed, SuiteRuns)
    with pytest.raises(BenchmarkError, match=r"'push' has no context \[10\]; it has \[0, 1, 2"):
        specifications(replace(pushed, numbers=(9, 10)))


def test_the_list_names_figures_and_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0] for line in lines] == list(NAMES)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["fig-7"], "nothing of the thesis is called 'fig-7' here; there are fig-5.3, fig-5.4"),
        (["table-5"], "nothing of the thesis is called 'table-5' here"),
        (["fig-6.2", "--workers", "0"], "--workers is 0; at least 1"),
    ],
)
def test_wrong_usage_is_told_in_a_sentence(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["reproduce", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_a_real_run_is_made_drawn_judged_and_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Networks that have hardly learned cannot cover the demonstrations."""
    figure = find_figure("fig-6.2")
    (few,) = figure.quick
    tiny = replace(few, shortened=0.005)
    changed = replace(figure, quick=(tiny,))
    monkeypatch.setattr("results.reproduce.find_figure", lambda _: changed)
    command = ["reproduce", "fig-6.2", "--quick", "--workers", "1", "--out", str(tmp_path)]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "fig-6.2: not held" in printed and "quick runs, too few" in printed
    assert (tmp_path / "fig-6.2-quick.png").stat().st_size > 10_000
    assert printed.split()[-3:] == ["fig-6.2:", "not", "held"], "the verdict is the last line"
    lines = (tmp_path / "fig-6.2-quick.md").read_text().split("\n")
    assert [line for line in lines if line][-1] == "- fig-6.2: not held"
    folder = tmp_path / "fig-6.2-quick"
    before = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert len(read_records(folder).records) == 5
    assert main(command) == 0
    assert {path: path.stat().st_mtime_ns for path in folder.iterdir()} == before, "it resumes"
    with pytest.raises(SettingsClashError, match="made with other settings"):
        run_sampling(folder, sampling_runs([0], [6], 0.01), 1, print)
