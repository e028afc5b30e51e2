"""Estimates against closed forms and scipy; intervals by how often they hold the truth."""

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from results.exceptions import BenchmarkError
from results.report.statistics import (
    bootstrap,
    expected_rollouts,
    holm,
    interquartile_mean,
    interquartile_mean_interval,
    mean_interval,
    performance_profile,
    performance_profile_band,
    permutation_p,
    probability_of_improvement,
    stratified_interval,
    verdict,
)

N_STUDIES = 2000


@pytest.fixture
def fewer_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Enough to tell coverage, in seconds."""
    monkeypatch.setattr(bootstrap, "N_RESAMPLES", 1000)


def share_held(intervals: list[tuple[float, float]], truth: float) -> float:
    low, high = np.array(intervals).T
    return float(np.mean((low <= truth) & (truth <= high)))


# -- rollouts to success, censored -------------------------------------------------------------


@pytest.mark.parametrize(
    ("rollouts", "budget", "mean"),
    [
        # the exact shares of a geometric distribution: 1/2 within 3, and 1/3 within 3
        ([1] * 4 + [2] * 2 + [3] + [math.inf], 3, 2.0),
        ([1] * 9 + [2] * 6 + [3] * 4 + [math.inf] * 8, 3, 3.0),
    ],
)
def test_expected_rollouts_are_exact_for_a_geometric_distribution(
    rollouts: list[float], budget: int, mean: float
) -> None:
    assert expected_rollouts(rollouts, budget)[0] == pytest.approx(mean)


def test_expected_rollouts_are_those_of_beginning_anew() -> None:
    """E = mean of the successes + (1 - p) / p * budget, which simulated restarts take too."""
    counts, budget = np.array([3.0, 5.0, 10.0, math.inf, math.inf]), 12
    found = expected_rollouts(counts, budget)[0]
    assert found == pytest.approx(6.0 + 2 / 3 * budget)
    rng, spent = np.random.default_rng(0), []
    for _ in range(5_000):
        total = 0.0
        while math.isinf(count := rng.choice(counts)):
            total += budget
        spent.append(total + count)
    assert np.mean(spent) == pytest.approx(found, rel=0.05)


def test_budgets_may_differ_and_a_run_that_needs_none_costs_nothing() -> None:
    assert expected_rollouts([0.0, math.inf, 4.0], [10, 20, 30])[0] == 12.0
    assert expected_rollouts([0.0, 0.0], 10) == (0.0, 0.0, 0.0)


def test_no_success_gives_a_lower_end_alone() -> None:
    mean, low, high = expected_rollouts([math.inf] * 4, 50)
    assert math.isinf(mean) and math.isinf(high)
    assert math.exp(-200 / low) == pytest.approx(0.025)


def test_targets_of_one_seed_are_not_seeds() -> None:
    counts, seeds = [10.0, 10.0, 10.0, 40.0, 40.0, 40.0], [1, 1, 1, 2, 2, 2]
    mean, low, high = expected_rollouts(counts, 50, seeds)
    alone = expected_rollouts(counts, 50)
    assert mean == alone[0] == 25.0
    assert low < alone[1] and alone[2] < high
    assert expected_rollouts([30.0, 120.0], 150)[1:] == pytest.approx((low * 3, high * 3))
    assert math.isnan(expected_rollouts(counts, 50, [1] * 6)[1])


@pytest.mark.parametrize(("p", "budget", "n"), [(0.05, 40, 20), (0.05, 200, 20), (0.02, 60, 20)])
def test_expected_rollouts_lie_in_their_interval(p: float, budget: int, n: int) -> None:
    rng = np.random.default_rng(1)
    counts = rng.geometric(p, (N_STUDIES, n)).astype(float)
    counts[counts > budget] = math.inf
    held = share_held([expected_rollouts(each, budget)[1:] for each in counts], 1 / p)
    assert 0.93 <= held <= 0.97


# -- the bootstrap -----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.usefixtures("fewer_resamples")
@pytest.mark.parametrize("n", [5, 10, 20])
def test_interquartile_means_lie_in_their_interval(n: int) -> None:
    studies = np.random.default_rng(2).normal(size=(N_STUDIES, n))
    held = share_held([interquartile_mean_interval(each) for each in studies], 0.0)
    assert 0.93 <= held <= 0.97


@pytest.mark.slow
@pytest.mark.usefixtures("fewer_resamples")
def test_means_over_targets_lie_in_their_interval_because_seeds_are_drawn() -> None:
    """Two tasks, 8 seeds each, 10 targets a seed that share half of their variance."""
    rng = np.random.default_rng(3)
    seeds, targets = rng.normal(size=(N_STUDIES, 2, 8, 1)), rng.normal(size=(N_STUDIES, 2, 8, 10))
    studies = seeds + targets

    def mean(samples: np.ndarray) -> np.ndarray:
        return samples.mean(axis=1)

    held = share_held([stratified_interval(tuple(each), mean) for each in studies], 0.0)
    assert 0.93 <= held <= 0.97
    pooled = share_held(
        [stratified_interval([task.ravel() for task in each], mean) for each in studies[:300]], 0.0
    )
    assert pooled < 0.75


def test_the_interval_of_a_mean_is_nearly_students() -> None:
    values = np.random.default_rng(4).normal(size=12)
    exact = stats.t.interval(0.95, 11, values.mean(), stats.sem(values))
    found = [float(end) for end in mean_interval(values)]
    assert found == pytest.approx(list(exact), abs=0.06 * (exact[1] - exact[0]))
    assert interquartile_mean(values) == pytest.approx(stats.trim_mean(values, 0.25))


# -- comparisons -------------------------------------------------------------------------------


@given(
    st.lists(st.integers(-3, 3), min_size=2, max_size=8),
    st.lists(st.integers(-3, 3), min_size=2, max_size=8),
)
@settings(max_examples=40, deadline=None)
def test_the_probability_of_improvement_is_mann_and_whitneys(ours: list, theirs: list) -> None:
    p, low, high = probability_of_improvement(ours, theirs)
    assert p == pytest.approx(stats.mannwhitneyu(ours, theirs).statistic / len(ours) / len(theirs))
    assert 0 <= low <= p <= high <= 1
    assert probability_of_improvement(theirs, ours) == pytest.approx((1 - p, 1 - high, 1 - low))


@pytest.mark.parametrize("shift", [0.0, 0.8, 1.5])
def test_probabilities_of_improvement_lie_in_their_interval(shift: float) -> None:
    rng = np.random.default_rng(5)
    ours, theirs = rng.normal(shift, size=(N_STUDIES, 12)), rng.normal(size=(N_STUDIES, 12))
    intervals = [probability_of_improvement(x, y)[1:] for x, y in zip(ours, theirs, strict=True)]
    assert 0.93 <= share_held(intervals, float(stats.norm.cdf(shift / math.sqrt(2)))) <= 0.97


def test_twenty_wins_of_twenty_leave_room_for_doubt() -> None:
    _, low, high = probability_of_improvement(np.arange(20, 40), np.arange(20))
    assert 0.8 < low < 0.95 and high == 1.0


def test_the_permutation_test_is_the_rank_sum_test_for_one_task() -> None:
    rng = np.random.default_rng(6)
    ours, theirs = rng.normal(0.9, size=9), rng.normal(size=11)
    for mine, scipys in (("two-sided", "two-sided"), ("less", "less")):
        exact = stats.mannwhitneyu(ours, theirs, alternative=scipys, method="exact").pvalue
        found = permutation_p([(ours, theirs)], mine)  # type: ignore[arg-type]
        assert found == pytest.approx(exact, abs=3 * math.sqrt(exact * (1 - exact) / 20_000) + 1e-4)


@pytest.mark.parametrize("together", [False, True])
def test_a_difference_between_tasks_is_none_between_algorithms(together: bool) -> None:
    """The same rank order within tasks far apart; pooled, the first would seem worse."""
    rng = np.random.default_rng(7)
    easy, hard = rng.normal(100, size=12), rng.normal(size=12)
    strata = [(easy[:2], easy[2:]), (hard[:10], hard[10:])]
    assert permutation_p(strata, together=together) > 0.05
    pooled = [(np.r_[easy[:2], hard[:10]], np.r_[easy[2:], hard[10:]])]
    assert permutation_p(pooled, together=together) < 0.01


def test_of_pairs_it_counts_how_far_apart_they_are_where_all_are_ranked_together() -> None:
    """Four are far better and one a little worse: within pairs, that is four of five."""
    strata = [([1.0 + i], [101.0 + i]) for i in range(4)] + [([300.5], [300.0])]
    assert permutation_p(strata, "less") == pytest.approx(6 / 32, abs=0.01)
    assert permutation_p(strata, "less", together=True) == pytest.approx(2 / 32, abs=0.01)


@pytest.mark.parametrize("together", [False, True])
def test_the_permutation_test_is_wrong_as_often_as_it_says(together: bool) -> None:
    rng, p = np.random.default_rng(8), []
    for _ in range(600):
        strata = [(x[:5].round(1), x[5:].round(1)) for x in rng.exponential(size=(2, 11))]
        p.append(permutation_p(strata, "less", n_permutations=199, together=together))
    shares = np.mean(np.array(p)[:, None] <= [0.05, 0.2, 0.5], axis=0)
    assert shares == pytest.approx([0.05, 0.2, 0.5], abs=0.045)


def test_a_value_that_is_no_number_has_no_rank():
    with pytest.raises(BenchmarkError, match="a value is NaN, which has no rank"):
        permutation_p([([1.0, np.nan], [2.0, 3.0])])


@given(st.lists(st.floats(0, 1), min_size=1, max_size=6), st.floats(0.001, 0.999))
@settings(max_examples=60, deadline=None)
def test_holm_rejects_what_the_closed_test_rejects(p: list[float], level: float) -> None:
    """Holm's is the closure of Bonferroni's: each intersection of hypotheses must be rejected."""
    indices = range(len(p))
    for i in indices:
        sets = [s for k in indices for s in combinations(indices, k + 1) if i in s]
        closed = max(min(1.0, len(s) * min(p[j] for j in s)) for s in sets)
        assert holm(p)[i] == pytest.approx(closed)
        assert (holm(p)[i] <= level) == (closed <= level) or closed == pytest.approx(level)


def test_a_table_of_equal_algorithms_has_a_verdict_in_at_most_five_of_a_hundred() -> None:
    rng, false_tables, n = np.random.default_rng(9), 0, 200
    for _ in range(n):
        ours, *others = rng.normal(size=(6, 8))
        p = [permutation_p([(ours, x)], n_permutations=500, seed=1) for x in others]
        false_tables += any(verdict(0.9, each) != "cannot be told" for each in holm(p))
    assert false_tables <= n * 0.05 + 2 * math.sqrt(n * 0.05 * 0.95)


def test_a_p_value_is_a_probability() -> None:
    with pytest.raises(BenchmarkError, match=r"\[0.5, 1.2\].*\[0, 1\]"):
        holm([0.5, 1.2])


# -- profiles ----------------------------------------------------------------------------------


def test_a_profile_counts_tasks_alike_whatever_their_seeds() -> None:
    strata = [np.array([-10.0, -20.0, -math.inf, -30.0]), np.array([[-5.0, -15.0]])]
    found = performance_profile(strata, [-40.0, -18.0, -7.0])
    assert found.tolist() == [(0.75 + 1.0) / 2, (0.25 + 1.0) / 2, (0.0 + 0.5) / 2]
    assert np.isnan(performance_profile_band(strata, [-18.0])).all()


@pytest.mark.slow
@pytest.mark.usefixtures("fewer_resamples")
def test_a_profile_lies_in_its_band() -> None:
    rng, truth = np.random.default_rng(10), stats.norm.sf([-0.5, 0.0])
    bands = [
        performance_profile_band(list(rng.normal(size=(2, 15))), [-0.5, 0.0]) for _ in range(500)
    ]
    low, high = np.array(bands).transpose(1, 0, 2)
    held = np.mean((low <= truth) & (truth <= high), axis=0)
    assert (held >= 0.92).all() and (held <= 0.985).all()
