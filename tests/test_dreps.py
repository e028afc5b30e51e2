"""DREPS: its dual on discrete toy problems, and the clusters of bad samples."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import check_grad

from baselines import DREPS
from baselines.dreps.clusters import fit_clusters, k_means
from baselines.dreps.dual import TOLERANCE, References, dual, sample_weights, solve
from baselines.reps import dual as reps_dual
from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError
from tests.test_reps import vec_env

NONE = References(np.empty((0, 20)), np.empty(0), np.empty(0))


def toy(seed: int, bounds: tuple[float, ...], signs: tuple[float, ...] = (-1, -1)) -> Any:
    """Return rewards and references that are distributions over 20 outcomes, q uniform."""
    rng = np.random.default_rng(seed)
    references = rng.dirichlet(np.full(20, 2.0), len(bounds)).clip(1e-3)
    references /= references.sum(axis=1, keepdims=True)
    rewards = rng.normal(size=20) + 10 * references[0]  # what is near the first one is tempting
    ratios = np.log(references * 20)
    return rewards, References(ratios, np.array(signs, float), np.array(bounds)), references


def kl(p: np.ndarray, q: np.ndarray) -> float:
    positive = p > 0
    return float(np.sum(p[positive] * np.log(p[positive] / q[positive])))


class TestDual:
    @given(seed=st.integers(0, 10_000), k=st.floats(0.2, 5), chi=st.booleans())
    @settings(max_examples=40, deadline=None)
    def test_gradient_equals_finite_differences(self, seed: int, k: float, chi: bool) -> None:
        rewards, references, _ = toy(seed, (0.5, 0.8), (-1, 1 if chi else -1))
        multipliers = np.random.default_rng(seed).uniform(0, 1, 2)

        def both(x: np.ndarray) -> tuple[float, np.ndarray]:
            return dual(float(x[0]), x[1:], rewards, 0.7, references)

        point = np.concatenate([[k], multipliers])
        error = check_grad(lambda x: both(x)[0], lambda x: both(x)[1], point, epsilon=1e-6)
        assert error < 1e-3

    def test_it_is_convex(self) -> None:
        rewards, references, _ = toy(0, (0.5, 0.8))
        rng = np.random.default_rng(0)
        for _ in range(200):
            a, b = rng.uniform(0.1, 3, (2, 3))
            values = [
                dual(float(x[0]), x[1:], rewards, 0.7, references)[0] for x in (a, b, (a + b) / 2)
            ]
            assert values[2] <= (values[0] + values[1]) / 2 + 1e-9

    def test_without_references_it_is_the_dual_of_reps(self) -> None:
        rewards = np.random.default_rng(0).normal(size=20)
        value, gradient = dual(0.7, np.empty(0), rewards, 1.0, NONE)
        expected = reps_dual.dual(0.7, rewards, 1.0)
        assert_allclose([value, gradient[0]], expected)
        assert_allclose(solve(rewards, 1.0, NONE).weights, reps_dual.solve(rewards, 1.0).weights)

    def test_the_weights_are_the_stationary_policy(self) -> None:
        rewards, references, (bad, good) = toy(1, (0.5, 0.8), (-1, 1))
        nu, omega, eta = 0.4, 0.3, 1.1
        k = eta - nu + omega
        q = np.full(20, 1 / 20)
        pi = q ** (eta / k) * good ** (omega / k) * bad ** (-nu / k) * np.exp(rewards / k)
        found = sample_weights(k, np.array([nu, omega]), rewards, references)
        assert_allclose(found, pi / pi.sum())


class TestSolve:
    @pytest.mark.parametrize("seed", range(12))
    def test_feasible_solutions_meet_every_bound(self, seed: int) -> None:
        rewards, references, distributions = toy(seed, (0.9, 0.7))
        solution = solve(rewards, 1.0, references)
        divergences = [kl(solution.weights, b) for b in distributions]
        assert_allclose(solution.divergences, divergences, atol=1e-9)
        met = (
            solution.kl <= 1 + TOLERANCE
            and min(divergences[0] - 0.9, divergences[1] - 0.7) >= -TOLERANCE
        )
        assert solution.feasible == met
        assert solution.feasible

    def test_no_other_policy_within_the_bounds_is_better(self) -> None:
        rewards, references, distributions = toy(3, (0.9, 0.7))
        solution = solve(rewards, 1.0, references)
        rng, within = np.random.default_rng(0), 0
        for concentration in (3.0, 30.0, 300.0):
            near = concentration * (solution.weights + 1e-3)
            for p in rng.dirichlet(near, 5000):
                if kl(p, np.full(20, 1 / 20)) <= 1 and all(
                    kl(p, b) >= xi for b, xi in zip(distributions, (0.9, 0.7), strict=True)
                ):
                    within += 1
                    assert p @ rewards <= solution.weights @ rewards + 0.02
        assert within > 100

    def test_the_constraint_keeps_away_from_what_tempts(self) -> None:
        rewards, references, distributions = toy(0, (1.2, 0.0))
        plain, away = reps_dual.solve(rewards, 1.0), solve(rewards, 1.0, references)
        assert kl(plain.weights, distributions[0]) < 1.2
        assert kl(away.weights, distributions[0]) >= 1.2 - TOLERANCE
        assert away.multipliers[0] > 0

    def test_a_constraint_that_is_met_anyway_changes_nothing(self) -> None:
        rewards, references, _ = toy(0, (0.0, 0.0))
        found = solve(rewards, 1.0, references)
        assert_allclose(found.weights, reps_dual.solve(rewards, 1.0).weights, atol=1e-3)
        assert_allclose(found.multipliers, 0, atol=1e-6)

    def test_the_upper_bound_to_the_good_is_met(self) -> None:
        rewards, references, distributions = toy(5, (0.2, 0.3), (-1, 1))
        solution = solve(rewards, 1.0, references)
        assert kl(solution.weights, distributions[1]) <= 0.3 + TOLERANCE
        assert solution.feasible and solution.eta >= 0

    @pytest.mark.parametrize("seed", range(4))
    def test_an_impossible_bound_is_reported(self, seed: int) -> None:
        rewards, references, _ = toy(seed, (50.0, 0.1))
        solution = solve(rewards, 0.5, references)
        assert not solution.feasible
        assert_allclose(solution.weights, reps_dual.solve(rewards, 0.5).weights)
        assert kl(solution.weights, np.full(len(rewards), 1 / len(rewards))) <= 0.5 + TOLERANCE

    @pytest.mark.parametrize("scale", [1e-6, 1e6])
    def test_weights_do_not_depend_on_the_rewards_scale(self, scale: float) -> None:
        rewards, references, _ = toy(0, (1.2, 0.5))
        expected, found = solve(rewards, 1.0, references), solve(scale * rewards, 1.0, references)
        assert_allclose(found.weights, expected.weights, atol=1e-4)
        assert_allclose(
            found.multipliers, scale * expected.multipliers, rtol=1e-2, atol=1e-6 * scale
        )

    def test_equal_rewards_give_equal_weights(self) -> None:
        _, references, _ = toy(0, (0.1, 0.1))
        assert_allclose(solve(np.full(20, -8.0), 1.0, references).weights, 1 / 20)

    def test_references_that_do_not_fit_are_refused(self) -> None:
        with pytest.raises(InvalidDataError, match="2 references need"):
            References(np.zeros((1, 5)), np.ones(2), np.ones(2))


class TestClusters:
    def test_separate_groups_are_found(self) -> None:
        rng = np.random.default_rng(0)
        centres = np.array([[0.0, 0.0], [5.0, 0.0], [0.0, 5.0]])
        truth = rng.integers(0, 3, 60)
        labels = k_means(centres[truth] + rng.normal(0, 0.3, (60, 2)), 3)
        for i in range(3):
            assert len(np.unique(labels[truth == i])) == 1
        assert len(np.unique(labels)) == 3

    @pytest.mark.parametrize("n_clusters", [1, 2, 9])
    def test_equal_samples_make_one_cluster(self, n_clusters: int) -> None:
        assert_allclose(k_means(np.ones((4, 3)), n_clusters), 0)

    def test_small_clusters_keep_nearly_the_prior_covariance(self) -> None:
        rng = np.random.default_rng(0)
        prior = np.diag([1.0, 4.0, 9.0])
        ((mean, covariance),) = fit_clusters(rng.normal(size=(1, 3)), np.zeros(1, int), prior)
        assert_allclose(covariance, prior * 3 / 4)
        samples = 0.1 * rng.normal(size=(3000, 3))
        ((mean, covariance),) = fit_clusters(samples, np.zeros(3000, int), prior)
        assert_allclose(mean, 0, atol=0.01)
        assert_allclose(covariance, 0.01 * np.eye(3), atol=0.02)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"xi": -1.0}, r"xi is -1\.0"),
        ({"xi": np.inf}, "xi is inf"),
        ({"chi": 0.0}, r"chi is 0\.0"),
        ({"n_clusters": 0}, "use REPS"),
        ({"bad_fraction": 0.0}, r"bad_fraction is 0\.0"),
        ({"good_fraction": 1.0}, r"good_fraction is 1\.0"),
    ],
)
def test_bad_settings_are_refused_with_their_value(setting: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        DREPS("MlpPolicy", vec_env(1), **setting)


def test_the_log_tells_about_the_clusters() -> None:
    model = DREPS("MlpPolicy", vec_env(12), population_size=12, n_bases=5, seed=0)
    model.learn(24, log_interval=100)
    for key in ("train/nu", "train/kl_to_bad", "train/feasible"):
        assert key in model.logger.name_to_value
