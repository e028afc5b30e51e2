"""REPS: its dual, the Gaussian's fit, the policy, and the search on a small bandit."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import check_grad, minimize
from stable_baselines3.common.vec_env import DummyVecEnv

from baselines import DREPS, REPS, GaussianPrimitivePolicy
from baselines.reps.dual import dual, kl_from_uniform, solve
from baselines.reps.gaussian import (
    FitSettings,
    LinearGaussian,
    weighted_fit,
    weighted_regression,
)
from sb3_nmp.common.algorithm import TrajectoryAlgorithm
from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError
from sb3_nmp.common.pd_controller import PDController

N_TIME_POINTS, N_DIMENSIONS = 30, 2


class BowEnv(gym.Env[np.ndarray, np.ndarray]):
    """Reward: how near the trajectory's middle is to (context, 1)."""

    def __init__(self, random: bool = False) -> None:
        self.observation_space = spaces.Box(-1, 1, (1,), np.float32)
        shape = (N_TIME_POINTS, N_DIMENSIONS)
        self.action_space = spaces.Box(-3, 3, shape, np.float32)
        self.random, self.context = random, np.zeros(1, np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        if self.random:
            self.context = self.np_random.uniform(-1, 1, 1).astype(np.float32)
        return self.context, {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        target = np.array([self.context[0], 1.0])
        reward = -float(np.linalg.norm(action[N_TIME_POINTS // 2] - target))
        return self.context, reward, True, False, {"is_success": reward > -0.1}

    def initial_trajectory(self) -> np.ndarray:
        return np.linspace([0.0, -1.0], [0.0, 0.5], N_TIME_POINTS)


def vec_env(n_envs: int, random: bool = False) -> DummyVecEnv:
    return DummyVecEnv([lambda: BowEnv(random)] * n_envs)


SMALL: dict[str, Any] = {"population_size": 12, "n_bases": 5, "exploration_scale": 0.6, "seed": 3}
ALGORITHMS: list[type[REPS]] = [REPS, DREPS]


class TestDual:
    @given(seed=st.integers(0, 10_000), log_eta=st.floats(-2, 3), epsilon=st.floats(0.1, 3))
    @settings(max_examples=40, deadline=None)
    def test_gradient_equals_finite_differences(
        self, seed: int, log_eta: float, epsilon: float
    ) -> None:
        rewards, eta = np.random.default_rng(seed).normal(size=15), np.exp(log_eta)
        error = check_grad(
            lambda x: dual(float(x[0]), rewards, epsilon)[0],
            lambda x: np.array([dual(float(x[0]), rewards, epsilon)[1]]),
            np.array([eta]),
            epsilon=1e-6 * eta,
        )
        assert error < 1e-4

    @given(seed=st.integers(0, 10_000), epsilon=st.floats(0.05, 2))
    @settings(max_examples=40, deadline=None)
    def test_the_kl_bound_is_met_and_used(self, seed: int, epsilon: float) -> None:
        solution = solve(np.random.default_rng(seed).normal(size=40), epsilon)
        assert_allclose(solution.kl, epsilon, atol=1e-6)
        assert_allclose(solution.weights.sum(), 1)
        assert 1 <= solution.effective_samples <= 40

    def test_eta_is_the_minimum_of_the_dual(self) -> None:
        rewards = np.random.default_rng(0).normal(size=30)
        found = solve(rewards, 1.0).eta
        numeric = minimize(lambda x: dual(float(np.exp(x[0])), rewards, 1.0)[0], [0.0]).x[0]
        assert_allclose(found, np.exp(numeric), rtol=1e-3)

    def test_weights_maximise_the_expected_reward_under_the_bound(self) -> None:
        rng = np.random.default_rng(0)
        rewards = rng.normal(size=6)
        best = solve(rewards, 0.5).weights @ rewards
        for p in rng.dirichlet(np.full(6, 0.7), 20_000):
            if kl_from_uniform(p) <= 0.5:
                assert p @ rewards <= best + 1e-9

    @given(scale=st.floats(1e-6, 1e6), shift=st.floats(-1e3, 1e3))
    @settings(max_examples=40, deadline=None)
    def test_weights_do_not_depend_on_the_rewards_scale(self, scale: float, shift: float) -> None:
        rewards = np.random.default_rng(0).normal(size=20)
        shifted = scale * rewards + scale * shift
        expected, found = solve(rewards, 1.0), solve(shifted, 1.0)
        assert_allclose(found.weights, expected.weights, atol=1e-6)
        assert_allclose(found.eta, scale * expected.eta, rtol=1e-5)

    @pytest.mark.parametrize("value", [0.0, -8.12, 1e9])
    def test_equal_rewards_give_equal_weights(self, value: float) -> None:
        solution = solve(np.full(20, value), 1.0)
        assert_allclose(solution.weights, 1 / 20)
        assert solution.kl == 0

    def test_too_few_best_samples_for_the_bound_take_all_the_weight(self) -> None:
        solution = solve(np.array([0.0, -1.0, 1.0, 1.0]), epsilon=5.0)
        assert_allclose(solution.weights, [0, 0, 0.5, 0.5], atol=1e-12)
        assert 0 < solution.eta < 1e-3

    @pytest.mark.parametrize("epsilon", [0.0, -1.0, np.nan, np.inf])
    def test_a_bad_epsilon_is_refused(self, epsilon: float) -> None:
        with pytest.raises(ConfigurationError, match="epsilon is"):
            solve(np.arange(3.0), epsilon)

    @pytest.mark.parametrize("rewards", [[], [1.0, np.nan], [np.inf, 0.0]])
    def test_bad_rewards_are_refused(self, rewards: list[float]) -> None:
        with pytest.raises(InvalidDataError, match="not finite"):
            solve(np.array(rewards), 1.0)


class TestGaussian:
    def test_log_density_entropy_and_kl_equal_torch(self) -> None:
        rng = np.random.default_rng(0)
        features = np.array([[1.0, 0.4]])
        gaussians, torches = [], []
        for _ in range(2):
            root = rng.normal(size=(3, 3))
            gaussian = LinearGaussian(rng.normal(size=(2, 3)), root @ root.T + np.eye(3))
            gaussians.append(gaussian)
            mean = th.as_tensor((features @ gaussian.coefficients)[0])
            torches.append(
                th.distributions.MultivariateNormal(mean, th.as_tensor(gaussian.covariance))
            )
        x = rng.normal(size=(4, 3))
        density = gaussians[0].log_density(x, np.repeat(features, 4, axis=0))
        assert_allclose(density, torches[0].log_prob(th.as_tensor(x)).numpy())
        assert_allclose(gaussians[0].entropy(), torches[0].entropy().item())
        expected = th.distributions.kl_divergence(torches[0], torches[1]).item()
        assert_allclose(gaussians[0].kl(gaussians[1], features), expected)

    def test_a_constant_context_gives_the_weighted_mean_and_no_slopes(self) -> None:
        rng = np.random.default_rng(0)
        targets, weights = rng.normal(size=(10, 3)), rng.dirichlet(np.ones(10))
        features = np.tile([1.0, 0.3, -0.2], (10, 1))
        coefficients = weighted_regression(targets, features, weights)
        assert_allclose(coefficients[1:], 0, atol=1e-12)
        assert_allclose(features[0] @ coefficients, weights @ targets)

    def test_a_linear_dependence_on_the_context_is_found(self) -> None:
        rng = np.random.default_rng(0)
        features = np.concatenate([np.ones((200, 1)), rng.uniform(-1, 1, (200, 2))], axis=1)
        true = rng.normal(size=(3, 4))
        found = weighted_regression(features @ true, features, np.full(200, 1 / 200))
        assert_allclose(found, true, atol=0.02)

    @pytest.mark.parametrize("shrinkage", [0.0, 0.5, 1.0])
    def test_the_covariance_stays_above_the_floor(self, shrinkage: float) -> None:
        samples, features = np.ones((5, 8)), np.ones((5, 1))
        old = LinearGaussian(np.zeros((1, 8)), np.eye(8))
        settings_ = FitSettings(1.0, shrinkage, np.full(8, 0.1))
        new = weighted_fit(samples, features, np.full(5, 0.2), old, settings_)
        assert_allclose(new.covariance, 0.01 * np.eye(8), atol=1e-12)
        assert_allclose(new.coefficients, np.ones((1, 8)))

    def test_shrinkage_drops_correlations_and_keeps_variances(self) -> None:
        rng = np.random.default_rng(0)
        samples, features = rng.normal(size=(40, 3)) @ rng.normal(size=(3, 3)), np.ones((40, 1))
        old = LinearGaussian(np.zeros((1, 3)), np.eye(3))
        full, diagonal = (
            weighted_fit(
                samples, features, np.full(40, 1 / 40), old, FitSettings(1.0, s, np.zeros(3))
            )
            for s in (0.0, 1.0)
        )
        assert_allclose(full.covariance, np.cov(samples.T, bias=True))
        assert_allclose(diagonal.covariance, np.diag(np.diag(full.covariance)))


@pytest.mark.parametrize("algorithm", ALGORITHMS)
class TestSearch:
    def test_it_starts_from_the_initial_trajectory(self, algorithm: type[REPS]) -> None:
        model = algorithm("MlpPolicy", vec_env(4), **SMALL)
        model.env.reset()  # pyright: ignore[reportOptionalMemberAccess]
        model._begin_generation()
        mean = model.predict(np.zeros(1, np.float32), deterministic=True)[0]
        assert_allclose(mean, BowEnv().initial_trajectory(), atol=0.03)

    def test_the_first_trajectories_explore_at_the_asked_scale(self, algorithm: type[REPS]) -> None:
        settings_: dict[str, Any] = SMALL | {"exploration_scale": (0.2, 0.05)}
        model = algorithm("MlpPolicy", vec_env(1), **settings_)
        model.learn(1)
        assert_allclose(model.policy.trajectory_std(), [0.2, 0.05], rtol=1e-6)

    def test_it_solves_a_small_bandit(self, algorithm: type[REPS]) -> None:
        env = vec_env(4)
        model = algorithm("MlpPolicy", env, **SMALL).learn(360)
        greedy, _ = model.predict(np.zeros(1, np.float32), deterministic=True)
        assert_allclose(greedy[N_TIME_POINTS // 2], [0, 1], atol=0.1)

    def test_it_learns_a_mean_that_depends_on_the_context(self, algorithm: type[REPS]) -> None:
        settings_: dict[str, Any] = SMALL | {"population_size": 40}
        model = algorithm("MlpPolicy", vec_env(4, random=True), **settings_).learn(2000)
        for c in (-0.7, 0.7):
            greedy, _ = model.predict(np.array([c], np.float32), deterministic=True)
            assert_allclose(greedy[N_TIME_POINTS // 2], [c, 1], atol=0.3)

    def test_runs_do_not_depend_on_the_number_of_environments(self, algorithm: type[REPS]) -> None:
        models = [algorithm("MlpPolicy", vec_env(n), **SMALL).learn(48) for n in (1, 12)]
        for name, value in models[0].policy.state_dict().items():
            assert_array_equal(value, models[1].policy.state_dict()[name])

    def test_it_survives_rewards_that_are_all_equal(
        self, algorithm: type[REPS], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(
            BowEnv, "step", lambda self, action: (self.context, -8.0, True, False, {})
        )
        model = algorithm("MlpPolicy", vec_env(12), **SMALL).learn(240)
        assert np.isfinite(model.policy.gaussian.entropy())

    def test_saved_and_loaded_it_predicts_the_same(
        self, algorithm: type[REPS], tmp_path: Path
    ) -> None:
        model = algorithm("MlpPolicy", vec_env(4), primitive="dmp", **SMALL).learn(32)
        model.save(tmp_path / "model.zip")
        loaded = algorithm.load(tmp_path / "model.zip", env=vec_env(4))
        context = np.zeros(1, np.float32)
        assert_array_equal(
            loaded.predict(context, deterministic=True)[0],
            model.predict(context, deterministic=True)[0],
        )
        assert_array_equal(loaded._samples[0].weights, model._samples[0].weights)
        loaded.policy.save(str(tmp_path / "policy.zip"))
        policy = GaussianPrimitivePolicy.load(str(tmp_path / "policy.zip"))
        assert_array_equal(
            policy.predict(context, deterministic=True)[0],
            model.predict(context, deterministic=True)[0],
        )

    def test_samples_of_the_policy_scatter_around_its_mean(self, algorithm: type[REPS]) -> None:
        model = algorithm("MlpPolicy", vec_env(4), **SMALL).learn(4)
        contexts = np.zeros((200, 1), np.float32)
        spread = model.predict(contexts)[0].std(axis=0)
        assert 0.3 < spread.mean() < 0.9

    def test_its_log_tells_how_the_update_went(self, algorithm: type[REPS]) -> None:
        model = algorithm("MlpPolicy", vec_env(12), **SMALL).learn(24, log_interval=100)
        keys = {"eta", "kl", "sample_kl", "entropy", "effective_samples", "sigma"}
        assert {f"train/{key}" for key in keys} <= set(model.logger.name_to_value)

    @pytest.mark.parametrize(
        ("setting", "message"),
        [
            ({"epsilon": 0.0}, r"epsilon is 0\.0"),
            ({"population_size": 1}, "population_size is 1"),
            ({"sample_generations": 0}, "sample_generations is 0"),
            ({"shrinkage": 1.5}, r"shrinkage is 1\.5"),
            ({"exploration_scale": (0.1, 0.1, 0.1)}, "tuple of 2"),
            ({"exploration_scale": -1.0}, r"exploration_scale is -1\.0"),
            ({"min_sigma": 0.0}, r"min_sigma is 0\.0"),
            ({"primitive": "spline"}, "'promp' or 'dmp'"),
            ({"primitive": "dmp", "pd_controller": PDController()}, "ends at its goal by itself"),
        ],
    )
    def test_bad_settings_are_refused_with_their_value(
        self, algorithm: type[REPS], setting: dict[str, Any], message: str
    ) -> None:
        with pytest.raises(ConfigurationError, match=message):
            algorithm("MlpPolicy", vec_env(1), **setting)


def test_it_is_a_trajectory_algorithm() -> None:
    assert issubclass(REPS, TrajectoryAlgorithm)
