"""Suites that run a task with several settings: files, resuming, tables and figures."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.lines import Line2D

from benchmark_envs import make_task
from results.exceptions import SettingsClashError
from results.harness.environments import RunTask
from results.harness.record_files import read_record, read_records, write_record
from results.harness.records import ContextRecord, RolloutRecord, RunRecord, TaskRecord
from results.harness.resume import plan_runs
from results.harness.runner import execute, run_plan
from results.harness.specification import Algorithm
from results.harness.suite import Recipe, Suite, make_suite
from results.one_context.figures import figures
from results.one_context.protocol import OneContext
from results.one_context.summary import compare_in_contexts, frame, summarise
from results.one_context.tables import tables
from tests.records_fakes import curve_of, failed_run, finished_run, specification

TASK = "nmp/ViaPoints-v0"
VARIANTS = {"1 point": {"n_points": 1}, "2 points": {"n_points": 2}}
HILL = Algorithm("hillclimber", "tests.results_fakes:HillClimber", {"population_size": 4})
RECIPE = Recipe({"Hill": HILL}, {TASK: {}}, 8, 2, (OneContext(),), variants=VARIANTS)
TARGETS = {"1 point": [[0.5, 0.4]], "2 points": [[0.2, 0.1], [0.8, 0.9]]}
POINTS = TaskRecord(("x [m]",), ("y [m]",), 0.005, "m")


def suite(recipe: Recipe = RECIPE) -> Suite:
    return make_suite("points", recipe)


def done(folder: Path, recipe: Recipe = RECIPE) -> list[str]:
    """Do what is left of a suite in a folder, and return the names of these runs."""
    plan = plan_runs(folder, suite(recipe).specifications)
    return [outcome.run.name for outcome in run_plan(plan, n_workers=1)]


# -- files and resuming ------------------------------------------------------------------------


def test_each_seed_is_run_in_each_variant_and_each_run_has_a_file() -> None:
    runs = suite().specifications
    assert [run.stem for run in runs] == [
        "hill_viapoints-v0_1-point_seed-000",
        "hill_viapoints-v0_2-points_seed-000",
        "hill_viapoints-v0_1-point_seed-001",
        "hill_viapoints-v0_2-points_seed-001",
    ]
    assert runs[1].name == "Hill on nmp/ViaPoints-v0, 2 points, seed 0"
    assert [run.task_settings for run in runs[:2]] == [{"n_points": 1}, {"n_points": 2}]


def test_a_variants_settings_go_before_those_of_the_task() -> None:
    given = replace(RECIPE, tasks={TASK: {"n_points": 6, "more": 1}})
    assert suite(given).specifications[0].task_settings == {"n_points": 1, "more": 1}


def test_variants_share_a_folder_and_are_resumed(tmp_path: Path) -> None:
    only_one = replace(RECIPE, variants={"1 point": {"n_points": 1}})
    assert len(done(tmp_path, only_one)) == 2
    assert all("2 points" in name for name in done(tmp_path))
    assert done(tmp_path) == []
    records = read_records(tmp_path).records
    contexts = {record.measured.context.values for record in records if record.measured.context}
    assert len(contexts) == 4, "each run has a context of its own"
    assert {record.specification.variant for record in records} == set(VARIANTS)


def test_other_settings_of_a_variant_clash_and_so_does_another_budget(tmp_path: Path) -> None:
    done(tmp_path, replace(RECIPE, variants={"1 point": {"n_points": 1}}))
    other = replace(RECIPE, variants={"1 point": {"n_points": 3}})
    with pytest.raises(SettingsClashError, match=r"1 point, seed 0, with task_settings.n_points ="):
        plan_runs(tmp_path, suite(other).specifications)
    longer = replace(RECIPE, budget=12, variants={"2 points": {"n_points": 2}})
    with pytest.raises(SettingsClashError, match="budget = 8"):
        plan_runs(tmp_path, suite(longer).specifications)


# -- what is shown -----------------------------------------------------------------------------


def test_the_initial_trajectory_is_shown_to_those_who_ask_for_it_alone() -> None:
    task = make_task(TASK)
    for asks in (False, True):
        run = RunTask(TASK, 3, 8, shown_initial=asks)
        shown = OneContext().prepare(run).demonstrations
        context = task.sample_context(np.random.default_rng(3))
        assert (shown is not None) == asks
        if shown is not None:
            np.testing.assert_array_equal(shown.contexts, context[None])
            np.testing.assert_array_equal(shown.trajectories[0], task.initial_trajectory(context))


def test_acnmp_runs_from_the_initial_trajectory() -> None:
    acnmp = Algorithm("acnmp", "sb3_nmp:ACNMP", {"population_size": 4}, shown_initial=True)
    run = suite(replace(RECIPE, algorithms={"ACNMP": acnmp})).specifications[0]
    curve = execute(run).measured.curve
    assert curve["rollouts"] == list(range(1, 9))
    assert curve["best_reward"][-1] > curve["best_reward"][0]


# -- tables and figures ------------------------------------------------------------------------


def record(label: str, seed: int, variant: str, rewards: list[float]) -> RunRecord:
    asked = specification(label, seed, TASK, variant=variant, budget=len(rewards))
    scene = {
        "limits": [[0.0, 1.0], [-0.5, 1.5]],
        "along": {"name": "x [m]", "low": 0.0, "high": 1.0},
        "targets": [[x, y + 0.01 * seed] for x, y in TARGETS[variant]],
    }
    curve = [[0.5], [0.6], [0.7]]
    return finished_run(
        asked,
        curve_of(rewards, [reward > -0.02 for reward in rewards]),
        POINTS,
        context=ContextRecord((0.5,), scene),
        rollouts={"greedy": RolloutRecord(curve, curve, rewards[-1] > -0.02)},
    )


def example() -> list[RunRecord]:
    return [
        record("A", 0, "1 point", [-0.3, -0.1, -0.2]),
        record("A", 1, "1 point", [-0.3, -0.2, 0.0]),
        record("A", 0, "2 points", [-0.5, -0.5, -0.6]),
        record("B", 0, "1 point", [-0.4, -0.4, -0.4]),
        record("B", 0, "2 points", [-0.9, -0.6, -0.6]),
        failed_run(specification("B", 1, TASK, variant="2 points")),
    ]


def test_the_summary_is_of_all_runs_and_of_each_variant() -> None:
    summary = summarise(frame(example())).set_index(["variant", "label"])
    assert summary.index.get_level_values("variant").unique().tolist() == [
        "",
        "1 point",
        "2 points",
    ]
    together, one, two = (summary.loc[(variant, "A")] for variant in ("", *VARIANTS))
    assert (together["seeds"], one["seeds"], two["seeds"]) == (3, 2, 1)
    assert together["greedy_mean"] == pytest.approx(-0.8 / 3)
    assert together["best_mean"] == pytest.approx(-0.6 / 3)
    assert (one["greedy_mean"], two["greedy_mean"]) == (pytest.approx(-0.1), -0.6)
    assert one["greedy_mean_low"] == pytest.approx(-0.2) and one["greedy_mean_high"] == 0.0
    assert summary.loc[("2 points", "B"), "failed"] == 1


def test_runs_are_compared_in_the_contexts_that_both_were_given() -> None:
    (row,) = compare_in_contexts(frame(example()), "A").to_dict("records")
    assert (row["label"], row["pairs"], row["unit"]) == ("B", 2, "m")
    assert row["greedy_difference"] == pytest.approx(-(0.2 + 0.0) / 2)
    assert row["best_difference"] == pytest.approx(-(0.3 + 0.1) / 2)
    ends = row["best_difference_low"], row["best_difference_high"]
    assert ends == pytest.approx((-0.3, -0.1))


def test_the_page_has_mean_errors_of_all_runs_and_of_each_variant() -> None:
    page = tables(frame(example()), ["A", "B", "C"])
    table, errors = page.tables
    assert errors.title.startswith(f"{TASK}, mean error at the end of the budget [m]")
    assert errors.header[:5] == (
        "algorithm", "runs", "greedy\nall", "greedy\n1 point", "greedy\n2 points",
    )  # fmt: skip
    assert errors.rows[0][2] == ("0.2667", "[0.0000,0.6000]")
    assert errors.rows[0][4] == ("0.6000", "one seed")
    assert errors.rows[2][2] == ("not run", "") and table.header[1] == "runs"
    text = page.markdown()
    assert "A's mean error minus B's in the 2 contexts that both were given: -0.1000 m (" in text
    assert "B on nmp/ViaPoints-v0, 2 points: RuntimeError: singular (seeds 1)" in text
    assert "The algorithms' finished seeds and variants differ" in text


def test_without_a_unit_there_is_no_table_of_errors() -> None:
    asked = specification("A", 0)
    page = tables(frame([finished_run(asked, curve_of([-1.0], [False]))]))
    assert [table.header[1] for table in page.tables] == ["seeds"]


def values(line: Line2D) -> list[float]:
    return np.asarray(line.get_ydata(), float).tolist()


def test_figures_show_errors_by_variant_and_the_curves_in_one_context_of_each() -> None:
    drawn = figures(example(), ["A", "B"])
    assert list(drawn) == [
        "curves_viapoints-v0.png",
        "errors_viapoints-v0.png",
        "rollouts_viapoints-v0_1-point.png",
        "rollouts_viapoints-v0_2-points.png",
    ]
    left, right = drawn["errors_viapoints-v0.png"].axes
    assert [line.get_label() for line in left.lines] == ["A (3 runs)", "B (2 runs)"]
    assert values(left.lines[0]) == pytest.approx([1.1 / 3, 0.8 / 3, 0.6 / 3])
    assert values(right.lines[0]) == pytest.approx([0.3, 0.15, 0.05])
    panel = drawn["rollouts_viapoints-v0_1-point.png"].axes[0]
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("x [m]", "y [m]")
    target, curve = panel.lines
    assert (target.get_xdata(), target.get_ydata()) == ([0.5], [0.4]), "that of seed 0 alone"
    assert np.asarray(curve.get_xdata(), float).tolist() == [0.0, 0.5, 1.0]


def test_records_from_before_there_were_variants_are_read(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    write_record(path, finished_run(specification("A", 0), curve_of([-1.0], [False])))
    held = json.loads(path.read_text())
    del held["specification"]["variant"]
    path.write_text(json.dumps(held))
    assert read_record(path).specification == specification("A", 0)
