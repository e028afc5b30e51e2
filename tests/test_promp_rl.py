"""ProMP+RL: Gaussian processes, relevances, transfer between targets, and both searches."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from baselines import REPS, EwertonProMPRL, StarkProMPRL
from baselines.primitives import ProMP
from baselines.promp_rl.gaussian_process import WeightProcess, fit_parameters, initial_parameters
from baselines.promp_rl.relevance import pearson, relevance, update
from baselines.promp_rl.relevance_search import RelevanceSearch, RelevanceSettings
from baselines.promp_rl.reps_search import RepsSearch, RepsSettings, decode
from baselines.promp_rl.transfer import collapse, neighbour_distance, target_relevance
from baselines.reps.gaussian import FitSettings
from sb3_nmp import ConfigurationError, Demonstrations, InvalidDataError, PDController
from sb3_nmp.common.exceptions import ResumeWarning
from sb3_nmp.common.rollouts import Generation

N_TIME_POINTS = 60
PROMP = ProMP(n_bases=5, n_time_points=40)


class TestGaussianProcess:
    def make(self, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray, WeightProcess]:
        rng = np.random.default_rng(0)
        contexts = rng.uniform(-1, 1, (30, 2)) * [1, 50] + [3, 0]
        wave = np.sin(2 * contexts[:, 0])
        weights = np.stack([wave, 100 * wave, wave / 2, np.full(30, 7.0)], axis=1)
        weights += noise * rng.normal(size=weights.shape) * [1, 100, 0.5, 0]
        parameters = fit_parameters(contexts, weights, 2, initial_parameters(2))
        return contexts, weights, WeightProcess(contexts, weights, parameters)

    def test_it_reproduces_its_data(self) -> None:
        contexts, weights, process = self.make()
        error = np.abs(process.mean(contexts) - weights)
        assert np.all(error < 0.02 * weights.std(axis=0) + 1e-9)

    def test_it_generalises_between_its_data(self) -> None:
        _, _, process = self.make()
        new = np.stack([np.linspace(2.2, 3.8, 20), np.zeros(20)], axis=1)
        assert_allclose(process.mean(new)[:, 0], np.sin(2 * new[:, 0]), atol=0.1)
        assert_allclose(process.mean(new)[:, 3], 7.0)

    def test_an_entry_that_does_not_matter_gets_a_long_scale(self) -> None:
        contexts, weights, _ = self.make()
        _, used, unused, _, _ = fit_parameters(contexts, weights, 2, initial_parameters(2))
        assert unused > used + np.log(5)

    def test_noise_is_not_fitted(self) -> None:
        contexts, weights, process = self.make(noise=0.2)
        left = weights[:, 0] - process.mean(contexts)[:, 0]
        assert 0.1 < left.std() < 0.3

    def test_the_uncertainty_grows_away_from_the_data(self) -> None:
        contexts, _, process = self.make()
        near, far = process.std(contexts[0]), process.std(contexts[0] + [3.0, 0.0])
        assert np.all(far[:3] > 5 * near[:3])
        assert far[3] == near[3] == 0

    def test_one_context_shown_many_times_gives_the_mean(self) -> None:
        contexts = np.ones((4, 3))
        weights = np.array([[0.0], [1.0], [2.0], [3.0]])
        parameters = fit_parameters(contexts, weights, 1, initial_parameters(3))
        predicted = WeightProcess(contexts, weights, parameters).mean(contexts[:1])
        assert_allclose(predicted, [[1.5]], atol=0.01)

    def test_a_thousand_contexts_in_a_batch_equal_one_by_one(self) -> None:
        _, _, process = self.make()
        many = np.random.default_rng(1).normal(size=(1000, 2))
        one_by_one = np.concatenate([process.mean(row[None]) for row in many[:20]])
        assert_allclose(process.mean(many)[:20], one_by_one, atol=1e-9)


class TestRelevance:
    def test_pearson_equals_numpys(self) -> None:
        rng = np.random.default_rng(0)
        samples, values = rng.normal(size=(15, 4)), rng.normal(size=15)
        expected = [np.corrcoef(column, values)[0, 1] for column in samples.T]
        assert_allclose(pearson(samples, values), expected)

    def test_what_does_not_vary_is_not_relevant(self) -> None:
        samples = np.random.default_rng(0).normal(size=(10, 3))
        samples[:, 1] = 4.2
        values = np.arange(10.0)
        assert pearson(samples, values)[1] == 0
        assert_array_equal(relevance(samples, np.full(10, -3.3)), np.zeros(3))

    def test_the_weights_that_matter_are_found(self) -> None:
        rng = np.random.default_rng(0)
        samples = rng.normal(size=(200, 6))
        found = relevance(samples, -np.abs(samples[:, 2] - 3) - 0.5 * np.abs(samples[:, 4] + 3))
        assert found[2] == 1
        assert 0.3 < found[4] < 0.7
        assert np.all(found[[0, 1, 3, 5]] < 0.25)

    @given(scale=st.floats(1e-3, 1e3), shift=st.floats(-10, 10))
    @settings(max_examples=30, deadline=None)
    def test_the_objectives_scale_does_not_matter(self, scale: float, shift: float) -> None:
        rng = np.random.default_rng(0)
        samples, values = rng.normal(size=(15, 4)), rng.normal(size=15)
        changed = relevance(samples, scale * (values + shift))
        assert_allclose(changed, relevance(samples, values), atol=1e-6)

    def test_an_update_shrinks_the_variance_of_relevant_weights_only(self) -> None:
        rng = np.random.default_rng(0)
        relevances, start = np.array([1.0, 0.0]), np.zeros(2)
        samples = rng.normal(size=(500, 2)) * np.sqrt(relevances)
        values = -np.abs(samples[:, 0] - 0.5)
        mean, variances = update(samples, values, start, np.ones(2), relevances, 1.0)
        assert 0.3 < mean[0] < 0.6
        assert mean[1] == 0
        assert variances[0] < 0.6
        assert variances[1] == 1


class TestTransfer:
    def test_near_targets_count_more(self) -> None:
        old = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
        shares = target_relevance(old, np.array([[0.9, 0.0]]), 0.5)[0]
        assert_allclose(shares.sum(), 1)
        assert shares.argmax() == 1
        assert shares[0] > shares[2] > shares[3]

    def test_the_contexts_unit_does_not_matter(self) -> None:
        rng = np.random.default_rng(0)
        old, new, unit = rng.normal(size=(6, 2)), rng.normal(size=(3, 2)), np.array([10.0, 0.01])
        assert_allclose(
            target_relevance(old * unit, new * unit, 1.0), target_relevance(old, new, 1.0)
        )

    def test_a_target_far_away_takes_after_the_nearest(self) -> None:
        shares = target_relevance(np.array([[0.0], [1.0], [2.0]]), np.array([[1000.0]]), 0.5)
        assert_allclose(shares, [[0, 0, 1]], atol=1e-6)

    def test_equal_targets_share_alike(self) -> None:
        assert neighbour_distance(np.zeros((3, 2))) == 1
        assert neighbour_distance(np.zeros((1, 2))) == 1
        assert_allclose(target_relevance(np.zeros((4, 2)), np.zeros((1, 2)), 1.0), 0.25)

    def test_the_collapsed_gaussian_has_the_mixtures_moments(self) -> None:
        rng = np.random.default_rng(0)
        means, shares = rng.normal(size=(3, 2)), np.array([0.2, 0.5, 0.3])
        covariance = np.array([[0.5, 0.2], [0.2, 0.4]])
        rows = rng.choice(3, 200_000, p=shares)
        drawn = means[rows] + rng.multivariate_normal(np.zeros(2), covariance, len(rows))
        mean, spread = collapse(means, covariance, shares)
        assert_allclose(mean, drawn.mean(axis=0), atol=0.01)
        assert_allclose(spread, np.cov(drawn.T), atol=0.02)

    def test_of_one_primitive_the_gaussian_is_its_own(self) -> None:
        mean, covariance = collapse(np.array([[1.0, 2.0]]), np.eye(2), np.ones(1))
        assert_array_equal(mean, [1, 2])
        assert_array_equal(covariance, np.eye(2))


def middle_reward(trajectories: np.ndarray) -> np.ndarray:
    return -np.linalg.norm(trajectories[:, 20] - [1.0, -2.0], axis=1)


def end_points(trajectories: np.ndarray) -> dict[str, np.ndarray]:
    return {
        "start": -np.linalg.norm(trajectories[:, 0] - [1.0, 0.5], axis=1),
        "end": -np.linalg.norm(trajectories[:, -1] - [-1.0, 2.0], axis=1),
    }


def tell(
    search: RepsSearch | RelevanceSearch,
    trajectories: np.ndarray,
    terms: dict[str, np.ndarray] | None = None,
) -> None:
    rewards, n = middle_reward(trajectories), len(trajectories)
    terms = end_points(trajectories) if terms is None else terms
    sent = trajectories.astype(np.float32)
    search.tell(Generation(np.zeros((n, 1), np.float32), sent, rewards, rewards > -0.1, terms))


def reps_search() -> RepsSearch:
    fit = FitSettings(1.0, 1.0, np.full(10, 0.01))
    return RepsSearch(PROMP, np.zeros(10), np.eye(10), RepsSettings(1.5, 3, fit))


def relevance_search() -> RelevanceSearch:
    return RelevanceSearch(
        PROMP, np.zeros(10), np.ones(10), RelevanceSettings(1.0, np.full(10, 0.01))
    )


class TestSearches:
    def test_decoding_is_the_primitives(self) -> None:
        weights = np.random.default_rng(0).normal(size=(3, 10))
        expected = PROMP.trajectories(weights.reshape(3, 5, 2), np.zeros(2), np.zeros(2))
        assert_array_equal(decode(PROMP, weights), expected)

    @pytest.mark.parametrize("make", [reps_search, relevance_search])
    def test_the_first_trajectory_is_greedy(self, make: type) -> None:
        search = make()
        asked = search.ask(6, np.random.default_rng(0))
        assert asked.shape == (6, 40, 2)
        assert_array_equal(asked[0], np.zeros((40, 2)))
        assert np.abs(asked[1:]).max() > 0.5

    @pytest.mark.parametrize("make", [reps_search, relevance_search])
    def test_a_greedy_trajectory_that_was_tried_is_not_tried_again(self, make: type) -> None:
        search = make()
        tell(search, decode(PROMP, search.mean[None]))
        assert np.abs(search.ask(6, np.random.default_rng(0))[0]).max() > 0.2

    def test_reps_takes_in_what_others_have_tried(self) -> None:
        search, rng = reps_search(), np.random.default_rng(0)
        solution = np.tile([1.0, -2.0], (1, 5, 1))
        tell(search, PROMP.trajectories(solution, np.zeros(2), np.zeros(2)))
        tell(search, search.ask(20, rng))
        assert middle_reward(decode(PROMP, search.mean[None]))[0] > -0.7

    def test_reps_finds_what_is_rewarded(self) -> None:
        search, rng = reps_search(), np.random.default_rng(0)
        for _ in range(20):
            tell(search, search.ask(20, rng))
        assert middle_reward(decode(PROMP, search.mean[None]))[0] > -0.1

    def test_relevance_weighting_improves_every_objective(self) -> None:
        search, rng = relevance_search(), np.random.default_rng(0)
        for _ in range(60):
            tell(search, search.ask(20, rng))
        for values in end_points(decode(PROMP, search.mean[None])).values():
            assert values[0] > -0.1

    def test_the_start_is_improved_by_the_first_weights(self) -> None:
        search, rng = relevance_search(), np.random.default_rng(0)
        tell(search, search.ask(200, rng))
        assert search.objective == "start"
        assert search.relevances["start"].reshape(5, 2)[0].min() > 0.5
        assert search.relevances["start"].reshape(5, 2)[3:].max() < 0.4
        spread = search.ask(200, rng).std(axis=0)
        assert spread[-1].max() < 0.6 * spread[0].min()

    def test_objectives_come_in_turn_after_a_generation_that_learns_relevances(self) -> None:
        search, rng, seen = relevance_search(), np.random.default_rng(0), []
        for _ in range(6):
            seen.append(search.objective)
            tell(search, search.ask(8, rng))
        assert seen == [None, "start", "end"] * 2

    def test_an_objective_that_is_met_already_is_passed_over(self) -> None:
        search, rng = relevance_search(), np.random.default_rng(0)
        asked = search.ask(8, rng)
        tell(search, asked, end_points(asked) | {"wall": np.zeros(8)})
        assert list(search.relevances) == ["start", "end"]
        search = relevance_search()
        tell(search, search.ask(8, rng), {"reward": np.full(8, -3.0)})
        assert search.objective is None


class ArcEnv(gym.Env[np.ndarray, np.ndarray]):
    """Bow out to the context's height, and end at its end; the rewards tell both errors."""

    def __init__(self, context: tuple[float, float] | None = None) -> None:
        self.observation_space = gym.spaces.Box(-1.5, 1.5, (2,), np.float32)
        self.action_space = gym.spaces.Box(-9, 9, (N_TIME_POINTS, 1), np.float32)
        self.pinned, self.context = context, np.zeros(2, np.float32)
        self.exploration_scale = np.array([0.2])

    def sample_context(self, rng: np.random.Generator) -> np.ndarray:
        return rng.uniform(-1, 1, 2)

    def demonstrate(self, context: Any, mode: str | None = None) -> np.ndarray:
        time = np.linspace(0, 1, N_TIME_POINTS)
        return (context[1] * time + 4 * time * (1 - time) * np.sin(2 * context[0]))[:, None]

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        drawn = self.sample_context(self.np_random) if self.pinned is None else self.pinned
        self.context = np.asarray((options or {}).get("context", drawn), np.float32)
        return self.context, {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        error = action - self.demonstrate(self.context)
        terms = {"middle": -abs(float(error[N_TIME_POINTS // 2, 0])), "end": -abs(error[-1, 0])}
        reward = float(sum(terms.values()))
        info = {f"reward_{name}": term for name, term in terms.items()}
        return self.context, reward, True, False, info | {"is_success": reward > -0.08}


SHOWN = Demonstrations.from_task(ArcEnv(), 12, seed=0)  # pyright: ignore[reportArgumentType]
NEW = np.random.default_rng(1).uniform(-1, 1, (50, 2)).astype(np.float32)
ALGORITHMS = [StarkProMPRL, EwertonProMPRL]


def make(algorithm: Any, env: ArcEnv | None = None, **more: Any) -> Any:
    settings = {"seed": 0, "demonstrations": SHOWN} | more
    return algorithm("MlpPolicy", env or ArcEnv(), **settings)


def error(model: Any, contexts: np.ndarray) -> float:
    predicted = model.predict(contexts.astype(np.float32), deterministic=True)[0]
    expert = np.stack([ArcEnv().demonstrate(context) for context in contexts])
    return float(np.sqrt(np.mean((predicted - expert) ** 2)))


@pytest.mark.parametrize("algorithm", ALGORITHMS)
class TestAlgorithms:
    def test_demonstrations_are_known_before_the_first_rollout(self, algorithm: Any) -> None:
        narrow = {"width": 0.5} if algorithm is StarkProMPRL else {}
        model = make(algorithm, policy_kwargs={"n_bases": 8} | narrow)
        assert error(model, SHOWN.contexts) < 0.15
        assert error(model, NEW) < 0.5

    def test_a_pinned_context_is_adapted_to(self, algorithm: Any) -> None:
        env = ArcEnv(context=(1.4, -1.4))
        model = make(algorithm, env, population_size=10, exploration_scale=0.2)
        greedy, _ = model.predict(np.array(env.pinned, np.float32), deterministic=True)
        env.reset()
        assert not env.step(greedy)[4]["is_success"]
        model.learn(500)
        assert model.searches[0].solution is not None
        greedy, _ = model.predict(np.array(env.pinned, np.float32), deterministic=True)
        assert env.step(greedy)[4]["is_success"]

    def test_solved_contexts_improve_others(self, algorithm: Any) -> None:
        narrow = {"width": 1.0} if algorithm is StarkProMPRL else {}
        model = make(algorithm, population_size=10, demonstrations=SHOWN[:5], policy_kwargs=narrow)
        before = error(model, NEW)
        model.learn(1500)
        assert len(model.policy.contexts) > 5
        assert error(model, NEW) < before

    def test_a_context_solved_again_replaces_its_solution(self, algorithm: Any) -> None:
        policy = make(algorithm).policy
        for height in (1.0, 2.0):
            policy.add_targets(NEW[:1], np.full((1, N_TIME_POINTS, 1), height))
        assert len(policy.contexts) == len(SHOWN) + 1
        assert_allclose(policy.weights[-1], 2.0, atol=0.05)

    def test_samples_differ_and_spread_about_the_greedy_trajectory(self, algorithm: Any) -> None:
        model = make(algorithm).learn(20)
        contexts = np.repeat(NEW[:1], 30, axis=0)
        sampled = model.predict(contexts, deterministic=False)[0]
        greedy = model.policy.generalise(th.as_tensor(contexts[:1]))[0].numpy()
        assert sampled.std(axis=0).min() > 1e-4
        assert np.all(np.abs(sampled.mean(axis=0) - greedy) < 5 * sampled.std(axis=0))

    def test_a_loaded_model_goes_on_without_its_demonstrations(
        self, algorithm: Any, tmp_path: Path
    ) -> None:
        model = make(algorithm, demonstrations=SHOWN[:5]).learn(600)
        model.save(tmp_path / "model")
        loaded = algorithm.load(tmp_path / "model", env=ArcEnv())
        assert len(loaded.policy.contexts) == len(model.policy.contexts) > 5
        with pytest.warns(ResumeWarning, match="load_replay_buffer"):
            assert loaded.learn(20).num_timesteps == 20

    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"population_size": 1}, "population_size is 1"),
            ({"epsilon": 0.0}, r"epsilon is 0\.0"),
            ({"exploration_scale": -1.0}, r"exploration_scale is -1\.0"),
            ({"min_sigma": (0.1, 0.1)}, "tuple of 1: one per dimension"),
            ({"policy_kwargs": {"n_bases": 1}}, "n_bases is 1"),
            ({"demonstrations": None}, "demonstrations"),
        ],
    )
    def test_wrong_settings_are_refused(
        self, algorithm: Any, settings: dict[str, Any], message: str
    ) -> None:
        with pytest.raises(ConfigurationError, match=message):
            make(algorithm, **settings)

    def test_demonstrations_of_another_task_are_refused(self, algorithm: Any) -> None:
        with pytest.raises(InvalidDataError, match="contexts have 1 entries"):
            make(algorithm, demonstrations=Demonstrations(np.zeros((1, 1)), np.zeros((1, 60, 1))))


def test_starks_settings_are_checked() -> None:
    with pytest.raises(ConfigurationError, match="sample_generations is 0"):
        make(StarkProMPRL, sample_generations=0)
    with pytest.raises(ConfigurationError, match=r"shrinkage is 1\.5"):
        make(StarkProMPRL, shrinkage=1.5)
    with pytest.raises(ConfigurationError, match="width is 0"):
        make(StarkProMPRL, policy_kwargs={"width": 0.0})


class TestRepsFromDemonstrations:
    def test_the_mean_is_their_regression_on_the_context(self) -> None:
        contexts = np.random.default_rng(0).uniform(-1, 1, (20, 2))
        slopes = np.linspace(0, 1, N_TIME_POINTS)[:, None]
        trajectories = np.stack([slopes * c[0] + (1 - slopes) * c[1] for c in contexts])
        model = make(REPS, demonstrations=Demonstrations(contexts, trajectories))
        predicted = model.predict(contexts[:3].astype(np.float32), deterministic=True)[0]
        assert_allclose(predicted, trajectories[:3], atol=0.05)

    def test_the_search_starts_from_it(self) -> None:
        model = make(REPS, ArcEnv(context=(0.5, 0.5)))
        before = model.policy.gaussian.coefficients
        model.learn(10)  # half a generation
        assert_array_equal(model.policy.gaussian.coefficients, before)
        assert_allclose(model.policy.trajectory_std(), 0.2, rtol=1e-6)
        model.learn(200)
        assert model.policy.trajectory_std()[0] < 0.2

    def test_a_loaded_model_goes_on_without_them(self, tmp_path: Path) -> None:
        make(REPS).save(tmp_path / "model")
        loaded = REPS.load(tmp_path / "model", env=ArcEnv())
        assert loaded.demonstrations is None
        before = loaded.policy.gaussian.coefficients
        loaded.learn(5)
        assert_array_equal(loaded.policy.gaussian.coefficients, before)

    @pytest.mark.parametrize("settings", [{"primitive": "dmp"}, {"pd_controller": PDController()}])
    def test_what_forces_start_and_goal_is_refused(self, settings: dict[str, Any]) -> None:
        with pytest.raises(ConfigurationError, match="force start and goal"):
            make(REPS, **settings)
