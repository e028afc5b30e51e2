import math
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from results.harness.records import ContextRecord, RolloutRecord, RunRecord, TaskRecord
from results.one_context.figures import figures
from results.one_context.summary import compare, frame, summarise
from results.report.frames import rollouts_to_success
from results.report.statistics import (
    interquartile_mean,
    interquartile_mean_interval,
    probability_of_improvement,
    quantile,
    success_interval,
)
from tests.records_fakes import curve_of, failed_run, finished_run, specification


def record(label: str, seed: int, successes: list[bool], rewards: list[float]) -> RunRecord:
    asked = specification(label, seed, budget=len(rewards))
    return finished_run(asked, curve_of(rewards, successes), training=1.0 + seed)


def failed(label: str, seed: int) -> RunRecord:
    return failed_run(specification(label, seed))


def example() -> pd.DataFrame:
    return frame(
        [
            record("A", 0, [False, True, True, True], [-5.0, -1.0, -1.0, -1.0]),
            record("A", 1, [True, False, False, True], [-4.0, -3.0, -3.0, -2.0]),
            record("A", 2, [True, True, False, False], [-4.0, -3.0, -3.0, -6.0]),
            record("B", 0, [False] * 4, [-9.0, -9.0, -9.0, -9.0]),
            record("B", 1, [False] * 4, [-9.0, -9.0, -9.0, -2.0]),
            failed("B", 2),
        ]
    )


def test_success_counts_from_where_it_lasts():
    assert rollouts_to_success([5, 10, 15], [True, False, True]) == 15
    assert rollouts_to_success([5, 10, 15], [False, True, True]) == 10
    assert math.isinf(rollouts_to_success([5, 10], [True, False]))


def test_summary_equals_hand_computation():
    summary = summarise(example()).set_index("label")
    a, b = summary.loc["A"], summary.loc["B"]
    assert (a["seeds"], a["failed"], a["greedy_solved"]) == (3, 0, 2)
    assert (a["greedy_rollouts_q25"], a["greedy_rollouts_median"]) == (3.0, 4.0)
    assert math.isinf(a["greedy_rollouts_q75"])
    assert (a["any_rollouts_median"], a["any_rollouts_q75"]) == (1.0, 1.5)
    assert a["greedy_reward_median"] == -2.0
    assert a["greedy_iqm"] == -3.0  # three values: none is a whole quarter
    assert a["best_reward_median"] == -2.0
    assert a["training_seconds"] == 2.0
    assert (b["seeds"], b["failed"], b["greedy_solved"]) == (2, 1, 0)
    assert math.isinf(b["greedy_rollouts_median"])


def test_a_row_without_runs_tells_why():
    runs = frame([record("A", 0, [True], [-1.0]), failed("B", 0)])
    summary = summarise(runs, ["C", "B", "A"])
    assert summary["label"].tolist() == ["C", "B", "A"]
    assert summary["reason"].tolist() == ["not run", "failed", ""]


@given(st.permutations(range(6)))
@settings(max_examples=20, deadline=None)
def test_aggregation_does_not_depend_on_the_order_of_the_runs(order: list[int]):
    runs = example()
    shuffled = runs.iloc[order]
    pd.testing.assert_frame_equal(summarise(runs), summarise(shuffled))
    pd.testing.assert_frame_equal(compare(runs, "A"), compare(shuffled, "A"))


def test_quantile_of_finite_values_is_numpys():
    values = np.random.default_rng(0).normal(size=7)
    for q in (0.0, 0.25, 0.5, 0.8, 1.0):
        assert quantile(values, q) == pytest.approx(np.quantile(values, q))


def test_a_median_next_to_infinity_is_infinite():
    assert quantile([1.0, math.inf], 0.5) == math.inf
    assert quantile([1.0, 2.0, math.inf], 0.5) == 2.0
    assert quantile([math.inf, math.inf], 0.5) == math.inf


def test_success_interval_equals_published_values():
    assert success_interval(19, 20) == pytest.approx((0.764, 0.991), abs=1e-3)
    assert success_interval(0, 10) == pytest.approx((0.0, 0.2775), abs=1e-3)
    assert success_interval(10, 10) == pytest.approx((0.7225, 1.0), abs=1e-3)


def test_interquartile_mean_drops_the_outer_quarters():
    assert interquartile_mean([100.0, 2.0, 3.0, -100.0]) == 2.5


def test_bootstrap_interval_is_seeded_and_holds_the_mean():
    values = np.random.default_rng(0).normal(size=30)
    low, high = interquartile_mean_interval(values)
    assert (low, high) == interquartile_mean_interval(values)
    assert low < interquartile_mean(values) < high
    assert np.isnan(interquartile_mean_interval([1.0])).all()


def test_bootstrap_interval_covers_the_truth_about_as_often_as_it_says():
    rng = np.random.default_rng(1)
    covered = 0
    for _ in range(60):
        low, high = interquartile_mean_interval(rng.normal(size=40))
        covered += low <= 0.0 <= high
    assert covered >= 50


def test_probability_of_improvement_counts_pairs_and_halves_ties():
    p, low, high = probability_of_improvement([1.0, 3.0], [2.0, 3.0])
    assert p == (0 + 0 + 1 + 0.5) / 4
    assert low <= p <= high
    assert probability_of_improvement([5.0, 6.0], [1.0, 2.0])[::2] == (1.0, 1.0)
    assert probability_of_improvement([-math.inf] * 2, [-math.inf] * 2)[0] == 0.5
    p, low, high = probability_of_improvement([1.0], [0.0])
    assert p == 1.0 and math.isnan(low) and math.isnan(high)


def test_fewer_rollouts_are_better():
    row = compare(example(), "A").iloc[0]
    assert row["rollouts_p"] == pytest.approx((2 * 1.0 + 1 * 0.5) / 3)
    assert row["reward_p"] == pytest.approx((1 + 1 + 1 + 1 + 0.5 + 0) / 6)


def test_verdicts_are_corrected_for_the_whole_table():
    good = [record("A", seed, [True], [-1.0 - 0.01 * seed]) for seed in range(10)]
    bad = [record(label, seed, [True], [-9.0 - seed]) for label in "BC" for seed in range(10)]
    few = [record("D", seed, [True], [-9.0 - seed]) for seed in range(2)]
    compared = compare(frame([*good, *bad, *few]), "A").set_index("label")
    assert compared["reward_verdict"].to_dict() == {
        "B": "better",
        "C": "better",
        "D": "cannot be told",
    }
    assert set(compared["rollouts_verdict"]) == {"cannot be told"}
    assert set(compared["rollouts_p_value"]) == {1.0}
    alone = compare(frame([*good, *few]), "A").iloc[0]
    assert compared.loc["D", "reward_p_value"] == pytest.approx(2 * alone["reward_p_value"])


# -- figures of final rollouts -----------------------------------------------------------------


def run_with_rollout(task: TaskRecord, scene: dict[str, Any] | None, seed: int = 0) -> RunRecord:
    path = [[0.1 * i] * len(task.trajectory_names) for i in range(20)]
    return finished_run(
        specification("A", seed, "nmp/Any-v0"),
        curve_of([-1.0, -0.5], [False, seed == 0]),
        task,
        context=ContextRecord((0.5,), scene),
        rollouts={"greedy": RolloutRecord(path, path, seed == 0, "left_way" if seed == 0 else "")},
    )


def test_final_rollouts_are_drawn_joint_by_joint_where_there_is_no_plane() -> None:
    """Any task can be plotted: here one of three joints, and one run that did not solve it."""
    arm = TaskRecord(("x [m]",), ("q1 [rad]", "q2 [rad]", "q3 [rad]"), 0.05)
    runs = [run_with_rollout(arm, None, seed) for seed in (0, 1)]
    figure = figures(runs, ["A"])["rollouts_any-v0.png"]
    assert [axes.get_ylabel() for axes in figure.axes] == list(arm.trajectory_names)
    assert figure.axes[-1].get_xlabel() == "time [s]"
    assert figure.axes[0].lines[0].get_xdata()[-1] == pytest.approx(1.0)  # type: ignore[index]
    entries = [text.get_text() for text in figure.legends[0].get_texts()]
    assert entries == ["left way", "not solved"]


def test_final_rollouts_are_drawn_in_the_plane_where_the_task_tells_a_scene() -> None:
    scene = {
        "limits": [[0.0, 2.0], [0.0, 2.0]],
        "points": {"start": [0.0, 0.0], "goal": [2.0, 2.0]},
        "circles": [{"center": [1.0, 1.0], "radius": 0.1, "style": "dashed", "label": "touch"}],
        "boxes": [{"low": [0.5, 0.5], "high": [0.7, 0.7]}],
    }
    plane = TaskRecord(("x [m]",), ("x [m]", "y [m]"), 0.05, optimum=("shortest path", -0.4999))
    drawn = figures([run_with_rollout(plane, scene)], ["A"])
    (axes,) = drawn["rollouts_any-v0.png"].axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")
    entries = [text.get_text() for text in drawn["rollouts_any-v0.png"].legends[0].get_texts()]
    assert entries == ["left way", "touch"]
    assert len(axes.patches) == 2 and axes.get_xlim() == (0.0, 2.0)
    texts = [text.get_text() for text in drawn["curves_any-v0.png"].axes[2].texts]
    assert texts == ["shortest path (-0.4999)"]


def test_a_verdict_goes_by_pairs_within_a_variant() -> None:
    """One that loses in seven of ten variants by a little, and wins three by far, is worse."""
    rng = np.random.default_rng(1)
    levels = [(k, k - 0.1) for k in range(1, 8)] + [(0, 8)] * 3
    rows = [
        {
            "task": "T", "variant": f"v{v}", "seed": seed, "label": label, "outcome": "finished",
            "greedy_reward": value + 1e-3 * rng.random(), "greedy_rollouts": 10.0,
        }
        for v, (theirs, ours) in enumerate(levels)
        for seed in range(5)
        for label, value in (("theirs", theirs), ("ours", ours))
    ]  # fmt: skip
    row = compare(pd.DataFrame(rows), "ours").iloc[0]
    assert row["reward_p"] == pytest.approx(0.3)
    assert row["reward_verdict"] == "worse"
    assert compare(pd.DataFrame(rows), "theirs").iloc[0]["reward_verdict"] == "better"
