"""Contextual REPS and CMA-ES: the dual, the update beside BOLeRo's, what they learn, bad input."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import approx_fprime, fmin_l_bfgs_b
from sklearn.linear_model import Ridge

import benchmark_envs  # noqa: F401  (registers the tasks)
from baselines import ContextualCMAES, ContextualREPS
from baselines.contextual.adaptation import (
    Constants,
    Strategy,
    Tried,
    adapt,
    advantages,
    inverse_root,
    ridge_regression,
)
from baselines.contextual.features import make_features
from baselines.contextual.reps_dual import dual, solve
from baselines.reps.dual import solve as solve_without_contexts
from sb3_nmp import ConfigurationError, InvalidDataError, TrajectoryAlgorithm

ENV = "nmp/Bottles-v0"


def samples(n: int = 60, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rewards that depend on the context, and quadratic features of it."""
    rng = np.random.default_rng(seed)
    contexts = rng.uniform(-1, 1, (n, 2))
    rewards = 3 * contexts[:, 0] - contexts[:, 1] ** 2 + rng.normal(size=n)
    return rewards, make_features(contexts, "quadratic")


# -- the dual of contextual REPS -------------------------------------------------------------------


def test_the_duals_derivatives_are_those_of_finite_differences() -> None:
    rewards, features = samples()
    theta = np.random.default_rng(1).normal(size=features.shape[1])

    def value(x: np.ndarray) -> float:
        return dual(float(x[0]), x[1:], rewards, features, 0.7)[0]

    _, by_eta, by_theta = dual(1.3, theta, rewards, features, 0.7)
    expected = np.asarray(approx_fprime(np.concatenate([[1.3], theta]), value, 1e-7))
    assert_allclose(np.concatenate([[by_eta], by_theta]), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("epsilon", [0.3, 1.0])
def test_the_solution_is_that_of_bolero(epsilon: float) -> None:
    """The dual of BOLeRo's `solve_dual_contextual_reps`, minimised by L-BFGS-B as it does."""
    rewards, features = samples()

    def published(x: np.ndarray) -> tuple[float, np.ndarray]:
        scaled = (rewards - features @ x[1:]) / x[0]
        soft = np.exp(scaled - scaled.max())
        log_mean = scaled.max() + np.log(soft.mean())
        value = x[0] * (epsilon + log_mean) + x[1:] @ features.mean(axis=0)
        by_eta = epsilon + log_mean - soft @ scaled / soft.sum()
        return value, np.append(by_eta, features.mean(axis=0) - soft @ features / soft.sum())

    begin = np.ones(1 + features.shape[1])
    bounds = [(1e-8, None)] + [(None, None)] * features.shape[1]
    found, least, _ = fmin_l_bfgs_b(published, begin, bounds=bounds, factr=10, pgtol=1e-10)
    ours = solve(rewards, features, epsilon)
    assert ours.eta == pytest.approx(found[0], rel=1e-3)
    assert dual(ours.eta, ours.value, rewards, features, epsilon)[0] == pytest.approx(least)
    soft = np.exp((rewards - features @ found[1:]) / found[0])
    assert_allclose(ours.weights, soft / soft.sum(), atol=1e-5)


def test_the_weights_keep_both_constraints_and_do_not_prefer_easy_contexts() -> None:
    rewards, features = samples()
    ours = solve(rewards, features, 0.8)
    assert ours.kl == pytest.approx(0.8, abs=1e-4)
    assert ours.weights.sum() == pytest.approx(1)
    assert_allclose(ours.weights @ features, features.mean(axis=0), atol=1e-4)
    naive = solve_without_contexts(rewards, 0.8)
    assert abs(naive.weights @ features[:, 1] - features[:, 1].mean()) > 0.2
    better = rewards - features @ ours.value
    assert np.corrcoef(better, np.log(ours.weights))[0, 1] > 0.999


def test_the_solution_does_not_depend_on_the_rewards_scale() -> None:
    rewards, features = samples()
    one, other = (solve(scale * rewards + 5 * scale, features, 1.0) for scale in (1.0, 1e-4))
    assert_allclose(one.weights, other.weights, atol=1e-6)
    assert_allclose(other.value[1:], 1e-4 * one.value[1:], rtol=1e-3)


def test_rewards_that_the_context_explains_give_equal_weights() -> None:
    _, features = samples()
    for rewards in (np.ones(60), np.zeros(60)):
        assert_allclose(solve(rewards, features, 1.0).weights, 1 / 60)
    with pytest.raises(InvalidDataError, match="60 rows of features for 3 rewards"):
        solve(np.ones(3), features, 1.0)
    with pytest.raises(ConfigurationError, match=r"epsilon is -1\.0"):
        solve(samples()[0], features, -1.0)


# -- the update of contextual CMA-ES ---------------------------------------------------------------


def bolero_update(old: Strategy, tried: Tried, context_dim: int) -> Strategy:
    """What BOLeRo's `CCMAESOptimizer._update` computes, without ridge, in its own words."""
    n, p = tried.parameters.shape
    total = p + context_dim
    mu = n // 2
    ordered = np.zeros(n)
    ordered[:mu] = np.log(mu + 0.5) - np.log1p(np.arange(mu))
    ordered /= ordered.sum()
    mueff = 1 / np.sum(ordered**2)
    c1 = 2.0 / ((total + 1.3) ** 2 + mueff)
    cmu = min(1 - c1, 2.0 * (mueff - 2 + 1 / mueff) / ((total + 2.0) ** 2 + mueff))
    cc = (4 + mueff / total) / (4 + total + 2 * mueff / total)
    c_sigma = (mueff + 2) / (total + mueff + 5)
    d_sigma = 1 + 2 * max(0, np.sqrt((mueff - 1) / (total + 1)) - 1) + c_sigma
    d_sigma += np.log(context_dim + 1)
    expected = np.sqrt(p) * (1 - 1 / (4 * p) + 1 / (21 * p**2))
    baseline = Ridge(alpha=1e-12).fit(tried.value_features[:, 1:], tried.rewards)
    advantages = tried.rewards - baseline.predict(tried.value_features[:, 1:])
    weights = ordered[np.argsort(np.argsort(advantages)[::-1])]
    weighted = tried.features.T @ np.diag(weights)
    new = np.linalg.pinv(weighted @ tried.features) @ weighted @ tried.parameters
    mean_phi = tried.features.mean(axis=0)
    moved = (mean_phi @ new - mean_phi @ old.coefficients) / old.step
    ps = (1 - c_sigma) * old.step_path
    ps = ps + np.sqrt(c_sigma * (2 - c_sigma) * mueff) * inverse_root(old.covariance) @ moved
    squared, generation = np.linalg.norm(ps) ** 2, old.generation + 1
    hsig = int(squared / p / np.sqrt(1 - (1 - c_sigma) ** (2 * generation)) < 2 + 4.0 / (p + 1))
    pc = (1 - cc) * old.path + hsig * np.sqrt(cc * (2 - cc) * mueff) * moved
    noise = (tried.parameters - tried.features @ old.coefficients) / old.step
    c1a = c1 * (1 - (1 - hsig) * cc * (2 - cc))
    covariance = (1 - c1a - cmu) * old.covariance
    covariance = covariance + cmu * noise.T @ np.diag(weights) @ noise + c1 * np.outer(pc, pc)
    log_step = c_sigma / d_sigma * (np.sqrt(squared) / expected - 1)
    step = old.step * np.exp(min(0.6, log_step))
    return Strategy(new, covariance, step, pc, ps, generation)


def generation(
    strategy: Strategy, worth: Callable[[np.ndarray, np.ndarray], np.ndarray],
    rng: np.random.Generator, n: int,
) -> Tried:  # fmt: skip
    contexts = rng.uniform(-1, 1, (n, 2))
    features = make_features(contexts, "linear")
    factor = np.linalg.cholesky(strategy.covariance)
    noise = rng.standard_normal((n, len(factor))) @ factor.T
    parameters = features @ strategy.coefficients + strategy.step * noise
    rewards = worth(parameters, contexts)
    return Tried(parameters, features, make_features(contexts, "quadratic"), rewards)


def sphere(seed: int = 0, p: int = 3) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Abdolmaleki et al.'s sphere: the optimum is linear in the context."""
    slopes = np.random.default_rng(seed).normal(size=(2, p))
    return lambda parameters, contexts: -((parameters + contexts @ slopes) ** 2).sum(axis=1)


def test_ten_updates_are_those_of_bolero() -> None:
    rng, worth = np.random.default_rng(0), sphere()
    ours = theirs = Strategy(rng.normal(size=(3, 3)), np.eye(3))
    for _ in range(10):
        tried = generation(ours, worth, rng, 50)
        theirs = bolero_update(ours, tried, 2)
        ours = adapt(ours, tried, Constants(50, 3, 2), ridge=1e-12)
        for name in ("coefficients", "covariance", "step", "path", "step_path"):
            assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_contextual_sphere_is_solved(seed: int) -> None:
    """As in BOLeRo's test: 1000 rollouts, three parameters, two contexts; it begins at some 3."""
    rng, worth = np.random.default_rng(seed), sphere(seed)
    strategy = Strategy(np.zeros((3, 3)), np.eye(3))
    n = 4 + int(3 * np.log(5)) * 5
    for _ in range(1000 // n):
        strategy = adapt(strategy, generation(strategy, worth, rng, n), Constants(n, 3, 2), 1e-4)
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 11)] * 2), axis=-1).reshape(-1, 2)
    found = worth(make_features(grid, "linear") @ strategy.coefficients, grid)
    assert found.mean() > -1e-3


def test_ridge_regression_is_scikit_learns() -> None:
    rng = np.random.default_rng(0)
    features, targets = rng.normal(size=(40, 4)), rng.normal(size=(40, 2))
    weights = rng.uniform(size=40)
    weights /= weights.sum()
    oracle = Ridge(alpha=0.3, fit_intercept=False).fit(features, targets, sample_weight=weights)
    assert_allclose(ridge_regression(targets, features, weights, 0.3), oracle.coef_.T)


def test_contexts_do_not_shine_through_the_advantages() -> None:
    rng = np.random.default_rng(0)
    contexts, merit = rng.uniform(-1, 1, (50, 2)), 1e-2 * rng.normal(size=50)
    features = make_features(contexts, "quadratic")
    tried = Tried(np.zeros((50, 3)), features, features, merit + 5 * contexts[:, 0])
    left = merit - features @ np.linalg.lstsq(features, merit, rcond=None)[0]
    found = advantages(tried)
    assert np.corrcoef(found, left)[0, 1] > 0.999


# -- the algorithms --------------------------------------------------------------------------------


class Follow(gym.Env[Any, Any]):
    """Follow the parabola c t^2: the best trajectory is linear in the context."""

    def __init__(self) -> None:
        self.observation_space = gym.spaces.Box(-1, 1, (1,), np.float32)
        self.action_space = gym.spaces.Box(-9, 9, (20, 1), np.float32)
        self.exploration_scale = np.array([0.3])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        given = (options or {}).get("context", self.np_random.uniform(-1, 1, 1))
        self.context = np.asarray(given, np.float32)
        return self.context, {}

    def step(self, action: Any) -> Any:
        error = float(np.mean((action[:, 0] - self.context * np.linspace(0, 1, 20) ** 2) ** 2))
        return self.context, -error + 5.0 * float(self.context[0]), True, False, {}


def mean_error(model: TrajectoryAlgorithm) -> float:
    contexts = np.linspace(-0.9, 0.9, 7, dtype=np.float32)[:, None]
    wanted = contexts * np.linspace(0, 1, 20) ** 2
    answered = model.predict(contexts, deterministic=True)[0][..., 0]
    return float(np.mean((answered - wanted) ** 2))


@pytest.mark.parametrize("algorithm", [ContextualREPS, ContextualCMAES])
def test_one_distribution_learns_what_each_context_needs(algorithm: Any) -> None:
    """Although the context alone decides over most of the reward."""
    settings = {"n_bases": 5, "pd_controller": None, "context_features": "linear", "seed": 0}
    model = algorithm("MlpPolicy", Follow(), **settings)
    model.learn(50)
    before = mean_error(model)
    model.learn(950, reset_num_timesteps=False)
    assert mean_error(model) < 0.15 * before
    assert mean_error(model) < 5e-3


@pytest.mark.parametrize("algorithm", [ContextualREPS, ContextualCMAES])
def test_members_share_contexts_where_asked(algorithm: Any) -> None:
    seen: list[float] = []
    model = algorithm(
        "MlpPolicy", Follow(), population_size=12, rollouts_per_context=3, n_bases=5, seed=0
    )
    told = model._observe
    model._observe = lambda rollouts: told(rollouts) or seen.extend(rollouts.contexts[:, 0])
    model.learn(48)
    contexts = np.array(seen).reshape(-1, 3)
    assert_array_equal(contexts, contexts[:, :1].repeat(3, axis=1))
    assert len(np.unique(contexts)) == 16


def test_quadratic_features_express_what_linear_ones_cannot() -> None:
    grid = np.linspace(-1, 1, 30)[:, None]
    left = [
        np.linalg.lstsq(make_features(grid, kind), grid[:, 0] ** 2, rcond=None)[1][0]
        for kind in ("linear", "quadratic")
    ]
    assert left[1] < 1e-20 < 0.1 < left[0]


@pytest.mark.parametrize(
    ("algorithm", "settings", "message"),
    [
        (
            ContextualREPS,
            {"value_features": "cubic"},
            "value_features is 'cubic'; it must be 'linear' or 'quadratic'",
        ),
        (ContextualCMAES, {"ridge": 0.0}, "ridge is 0.0; it must be finite and > 0"),
        (ContextualCMAES, {"population_size": 3}, "population_size is 3; it must be >= 4"),
        (ContextualREPS, {"rollouts_per_context": 7}, "rollouts_per_context is 7; .* divisor of"),
        (ContextualCMAES, {"policy_kwargs": {"context_features": "no"}}, "context_features is 'no"),
    ],
)
def test_settings_that_do_not_fit_are_refused(
    algorithm: Any, settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        algorithm("MlpPolicy", ENV, **settings)


@pytest.mark.parametrize(("slope", "value"), [(0.0, [-5.0, 0.0]), (0.1, [-5.0, 0.1])])
def test_the_value_is_the_reward_where_the_context_explains_all(
    slope: float, value: list[float]
) -> None:
    features = np.column_stack([np.ones(6), np.linspace(-1.0, 1.0, 6)])
    found = solve(slope * features[:, 1] - 5.0, features, 1.0).value
    assert_allclose(found, value, atol=1e-9)
