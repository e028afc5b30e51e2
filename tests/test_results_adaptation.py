"""Numbers, tables and plots of runs that adapt to held-out targets."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from results.adaptation.figures import (
    adaptation_curves,
    error_quartiles,
    figures,
    panel_titles,
    read_reference,
)
from results.adaptation.protocol import LeaveOneOut
from results.adaptation.summary import error_after, frame, summarise
from results.adaptation.tables import tables
from results.exceptions import BenchmarkError, SettingsClashError
from results.harness.record_files import write_record
from results.harness.records import (
    ProtocolRecord,
    RunRecord,
    SpecificationRecord,
    SuiteRecord,
    TaskRecord,
    finished,
)
from results.harness.resume import plan_runs
from results.harness.specification import Algorithm, RunSpecification
from results.harness.suite import Recipe, make_suite
from results.one_context.protocol import OneContext
from results.report.frames import curves_frame
from results.suites import find_recipe
from tests.records_fakes import curve_of, failed_run, finished_run, specification

TASK = "nmp/Push-v0"
PUSH = TaskRecord(("target x [m]", "target y [m]"), ("joint 1 [rad]",), 0.05, "m²")
SUITE = SuiteRecord("push", ("A", "B", "C"), (0, 40, 80, 200), 130)


def asked(label: str, target: int, seed: int, budget: int = 200) -> SpecificationRecord:
    kind = "extrapolation" if target in (2, 9) else "interpolation"
    protocol = ProtocolRecord("leave-one-out", {}, target, kind)
    return specification(label, seed, TASK, budget, protocol, SUITE)


def record(
    label: str, target: int, seed: int, errors: dict[int, float], budget: int = 200
) -> RunRecord:
    """A run whose greedy trajectory succeeds below an error of 0.1."""
    curve = curve_of([-error for error in errors.values()], [e < 0.1 for e in errors.values()])
    curve["rollouts"] = list(errors)
    if 0 in errors:
        curve["best_reward"][0] = None
    return finished_run(asked(label, target, seed, budget), curve, PUSH, 2.0 + seed)


def failed(label: str, target: int, seed: int) -> RunRecord:
    return failed_run(asked(label, target, seed))


RECORDS = [
    record("A", 9, 0, {0: 4.0, 30: 1.0, 60: 0.05, 200: 0.05}),
    record("A", 9, 1, {0: 4.0, 50: 2.0, 150: 0.03, 200: 0.03}),
    record("A", 2, 0, {0: 2.0, 200: 1.5}),
    record("A", 3, 0, {0: 0.05, 200: 0.04}),
    record("A", 4, 0, {0: 0.3, 10: 0.02, 200: 0.02}),
    record("B", 9, 0, {5: 3.0, 600: 0.06, 1200: 0.06}, budget=1200),
    failed("B", 9, 1),
    failed("C", 9, 0),
]


def summary_of(kind: str, label: str) -> dict[Any, Any]:
    summary = summarise(frame(RECORDS), ["A", "B", "C"])
    return summary.set_index(["kind", "label"]).loc[(kind, label)].to_dict()


def test_a_run_that_needs_no_rollout_counts_zero():
    runs = frame(RECORDS).set_index(["label", "target", "seed"])
    assert runs.loc[("A", 3, 0), "greedy_rollouts"] == 0
    assert runs.loc[("A", 4, 0), "greedy_rollouts"] == 10
    assert math.isinf(float(runs.loc[("A", 2, 0), "greedy_rollouts"]))  # type: ignore[arg-type]


def test_an_error_holds_until_the_next_row():
    curve = {"rollouts": [5, 30, 200], "greedy_reward": [-3.0, -2.0, -1.0]}
    errors = [error_after(curve, count, 200) for count in (5, 29, 30, 199, 200)]
    assert errors == [3.0, 3.0, 2.0, 2.0, 1.0]
    assert math.isnan(error_after(curve, 0, 200))
    assert math.isnan(error_after(curve, 201, 200))


def test_summary_equals_hand_computation():
    a = summary_of("extrapolation", "A")
    assert (a["runs"], a["failed"], a["solved"], a["solved_within_published"]) == (3, 0, 2, 1)
    assert (a["greedy_rollouts_median"], a["greedy_rollouts_q25"]) == (150.0, 105.0)
    assert math.isinf(a["rollouts_worst"])
    assert (a["error_0_median"], a["error_40_median"], a["error_80_median"]) == (4.0, 2.0, 2.0)
    assert a["error_200_median"] == 0.05
    inner = summary_of("interpolation", "A")
    assert (inner["runs"], inner["greedy_rollouts_median"], inner["rollouts_worst"]) == (2, 5.0, 10)


def test_what_was_not_run_or_failed_has_a_reason():
    assert summary_of("extrapolation", "C")["reason"] == "failed"
    assert summary_of("interpolation", "B")["reason"] == "not run"
    b = summary_of("extrapolation", "B")
    assert (b["runs"], b["failed"], b["budget"]) == (1, 1, 1200)
    assert math.isnan(b["error_0_median"]) and b["error_40_median"] == 3.0


def test_table_keeps_kinds_apart_and_names_failures():
    runs = frame(RECORDS)
    text = tables(runs, ["A", "B", "C"]).markdown()
    outer, inner = text.split("## ")[1:]
    assert outer.startswith(f"{TASK}, extrapolation: held-out targets 2, 9")
    assert "| A | 3 | 150 (105–>200) | 205 [" in outer  # (60 + 150 + 200) / 2
    assert "] | 2/3 | 1/3 | 4 (3–4) |" in outer
    assert "| B | 1 1 failed |" in outer and "not run" in inner
    assert "B on nmp/Push-v0, target 9: RuntimeError: singular (seeds 1)" in text
    assert "Budgets differ: A 200, B 1200, C 200 rollouts." in text
    assert "error [m²] at 40" in text and "…" not in text


def test_tables_fit_the_terminal():
    (first, *_) = tables(frame(RECORDS), ["A", "B", "C"]).tables
    for width in (60, 80, 120):
        for part in first.parts(width):
            assert part.header[0] == "algorithm" and len(part.rows) == 3
            assert sum(part._width(i) for i in range(len(part.header))) <= width
    parts = first.parts(60)
    assert sum(len(part.header) - 1 for part in parts) == len(first.header) - 1


# -- plots -------------------------------------------------------------------------------------


def test_quartiles_take_each_run_where_it_was_left():
    curves = curves_frame(RECORDS)
    outer = curves.loc[(curves["label"] == "A") & (curves["kind"] == "extrapolation")]
    medians = error_quartiles(outer)[0.5]
    assert medians.loc[[0, 30, 50, 60, 150, 200]].tolist() == [4.0, 2.0, 2.0, 2.0, 0.05, 0.05]


def test_figure_has_a_panel_a_kind_and_an_entry_an_algorithm(tmp_path: Path):
    errors = np.abs(np.random.default_rng(0).normal(size=(4, 20)))
    np.save(tmp_path / "curve_extrapolation.npy", -errors)
    references = dict([read_reference(tmp_path / "curve_extrapolation.npy")])
    assert np.array_equal(references["extrapolation"], errors)
    titles = panel_titles(finished(RECORDS))
    figure = adaptation_curves(curves_frame(RECORDS), ["A", "B", "C"], references, titles)
    errors_of, successes = figure.axes[:2], figure.axes[2:]
    assert [axes.get_yscale() for axes in errors_of] == ["log", "log"]
    for axes in errors_of:
        low, high = axes.get_ylim()
        shown = np.concatenate([np.asarray(line.get_ydata(), float) for line in axes.lines])
        assert low <= np.nanmin(shown) and np.nanmax(shown) <= high
    ends = [line.get_ydata()[-1] for axes in successes for line in axes.lines]  # type: ignore[index]
    assert ends == pytest.approx([2 / 3, 1.0, 1.0])  # A and B beyond, A between
    assert [axes.get_title().split(":")[0] for axes in errors_of] == [
        "extrapolation", "interpolation",
    ]  # fmt: skip
    entries = [text.get_text() for text in figure.legends[0].get_texts()]
    assert entries == ["A", "B", "published curve"]
    figure.savefig(tmp_path / "figure.png")


@pytest.mark.parametrize(
    ("name", "shape"), [("curve.npy", (3, 5)), ("extrapolation.npy", (5,)), ("missing.npy", None)]
)
def test_a_reference_must_be_a_table_of_a_known_kind(
    tmp_path: Path, name: str, shape: tuple[int, ...] | None
):
    if shape is not None:
        np.save(tmp_path / name, np.zeros(shape))
    with pytest.raises(BenchmarkError, match=name):
        read_reference(tmp_path / name)


def test_a_reference_is_refused_where_it_means_nothing():
    curve = curve_of([-1.0], [False], first=0)
    protocol = ProtocolRecord("extrapolation", {}, 0, "context 0")
    one = finished_run(specification("A", 0, protocol=protocol), curve)
    with pytest.raises(BenchmarkError, match=r"extrapolation runs.*leave-one-out suites"):
        figures([one], ["A"], [Path("x.npy")])


# -- suites and planning -----------------------------------------------------------------------


def run_of(label: str, target: int = 9, **more: Any) -> RunSpecification:
    settings = {"budget": 200, "protocol": LeaveOneOut(target, target in (2, 9))} | more
    return RunSpecification(label, Algorithm("b", "a:B"), TASK, 0, **settings)


def hold(folder: Path, run: RunSpecification) -> None:
    done = finished_run(run.record, curve_of([-1.0], [True]), PUSH)
    write_record(folder / f"{run.stem}.json", done)


def test_a_folder_takes_all_targets_and_budgets_of_an_algorithms_own(tmp_path: Path):
    hold(tmp_path, run_of("A"))
    plan = plan_runs(
        tmp_path, [run_of("A"), run_of("A", 3), run_of("B", budget=1200, own_budget=True)]
    )
    assert [run.stem for run in plan.kept] == [run_of("A").stem]
    assert len(plan.todo) == 2


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (run_of("B", budget=300), "budget = 200"),
        (run_of("A", 3, budget=300, own_budget=True), "budget = 200"),
        (run_of("B", protocol=OneContext()), "protocol.name = leave-one-out"),
    ],
)
def test_other_budgets_and_protocols_clash(tmp_path: Path, other: RunSpecification, named: str):
    hold(tmp_path, run_of("A"))
    with pytest.raises(SettingsClashError, match=named):
        plan_runs(tmp_path, [other])


def test_an_algorithms_budget_goes_before_the_suites_but_not_before_the_users():
    recipe = Recipe(
        {"A": Algorithm("a", "a:A"), "B": Algorithm("b", "a:B", budget=90)}, {TASK: {}}, 30, 2,
        (LeaveOneOut(0, False), LeaveOneOut(9, True)),
    )  # fmt: skip
    runs = make_suite("x", recipe).specifications
    assert [(run.budget, run.own_budget) for run in runs[:2]] == [(30, False), (90, True)]
    assert len({run.stem for run in runs}) == len(runs) == 8
    assert [run.seed for run in runs] == [0] * 4 + [1] * 4
    assert {run.budget for run in make_suite("x", recipe, budget=7).specifications} == {7}
    assert runs[0].record.suite.labels == ("A", "B")


def test_the_suite_push_holds_out_every_target():
    suite = make_suite("push", find_recipe("push"))
    protocols = [run.record.protocol for run in suite.specifications if run.label == "ACNMP"]
    seeds = [run.seed for run in suite.specifications if run.label == "ACNMP"]
    identities = [(p.number, seed) for p, seed in zip(protocols, seeds, strict=True)]
    assert sorted(identities) == [(target, seed) for target in range(10) for seed in range(5)]
    assert {p.number for p in protocols if p.kind == "extrapolation"} == {2, 9}
