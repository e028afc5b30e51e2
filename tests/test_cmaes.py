"""CMA-ES over residuals: the search by ask and tell, its space, and the algorithm's settings."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cloudpickle
import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import benchmark_envs  # noqa: F401  (registers the tasks)
from baselines import CMAES
from baselines.cmaes.search import FloatArray, ResidualSearch, ResidualSpace
from sb3_nmp import (
    ConfigurationError,
    Demonstrations,
    DemonstrationWarning,
    InvalidDataError,
    SmoothNoise,
)
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.models.cnmp_training import CNMPPretraining

SHAPE = (50, 2)
ENV_ID = "nmp/Bottles-v0"
NOISE = SmoothNoise(sigma=(0.5, 2.0), n_bases=4)


def base(contexts: FloatArray) -> FloatArray:
    """The first entry lifts the first dimension, the second one the second."""
    return np.repeat(contexts[:, None, :2], SHAPE[0], axis=1)


def make_search(context_step: FloatArray | None = None, population: int = 8) -> ResidualSearch:
    space = ResidualSpace(NOISE, np.array([1.0, -1.0, 5.0]), context_step)
    return ResidualSearch(space, base, SHAPE, population)


def generation(trajectories: FloatArray, target: FloatArray) -> Generation:
    rewards = -np.mean((trajectories - target) ** 2, axis=(1, 2))
    n, sent = len(trajectories), trajectories.astype(np.float32)
    return Generation(np.zeros((n, 3), np.float32), sent, rewards, rewards > -0.01)


def make(**more: Any) -> CMAES:
    settings: dict[str, Any] = {"pretraining": CNMPPretraining(5), "seed": 0}
    return CMAES("MlpPolicy", ENV_ID, **(settings | more))


class TestSpace:
    def test_without_shifts_all_base_trajectories_are_the_contexts(self) -> None:
        space = make_search().space
        assert space.size(2) == 8
        assert_array_equal(space.contexts(np.ones((2, 8)), 2), [[1, -1, 5], [1, -1, 5]])

    def test_shifts_move_the_context_only(self) -> None:
        space = make_search(np.array([0.1, 0.2, 0.0])).space
        assert space.size(2) == 11
        parameters = np.zeros((1, 11))
        parameters[0, 8:] = [1, 2, 3]
        assert_allclose(space.contexts(parameters, 2), [[1.1, -0.6, 5.0]])
        assert_array_equal(space.residuals(parameters, SHAPE), np.zeros((1, *SHAPE)))

    def test_residuals_have_the_standard_deviation_sigma(self) -> None:
        parameters = np.random.default_rng(0).normal(size=(20_000, 8))
        spread = make_search().space.residuals(parameters, SHAPE).std(axis=0)
        assert_allclose(spread, np.tile([0.5, 2.0], (SHAPE[0], 1)), rtol=0.03)

    def test_mixing_moves_the_dimensions_together(self) -> None:
        space = replace(make_search().space, mixing=np.tile([[0.0, 1.0], [0.0, 1.0]], (50, 1, 1)))
        parameters = np.random.default_rng(0).normal(size=(20_000, 8))
        residuals = space.residuals(parameters, SHAPE)
        plain = make_search().space.residuals(parameters, SHAPE) / NOISE.sigma
        assert_allclose(residuals[..., 0], 0.0)
        assert_allclose(residuals[..., 1], 2.0 * plain.sum(axis=2))


class TestSearch:
    @pytest.mark.parametrize("context_step", [None, np.array([0.3, 0.3, 0.3])])
    def test_it_solves_a_quadratic(self, context_step: FloatArray | None) -> None:
        search, rng = make_search(context_step), np.random.default_rng(0)
        best = np.array([0.7, -1.5, 0.3, 1.0, -0.4, 0.2, 2.0, -1.0])
        target = base(np.array([[1.0, -1.0]])) + search.space.residuals(best[None], SHAPE)
        for _ in range(200):
            search.tell(generation(search.ask(8, rng), target))
        assert_allclose(search.trajectories(search.mean[None]), target, atol=0.01)

    def test_the_first_trajectory_is_the_bases(self) -> None:
        asked = make_search().ask(8, np.random.default_rng(0))
        assert_array_equal(asked[0], base(np.array([[1.0, -1.0]]))[0])
        assert np.abs(asked[1:] - asked[0]).max(axis=(1, 2)).min() > 0.1

    def test_a_base_trajectory_that_was_tried_is_not_tried_again(self) -> None:
        search = make_search()
        target = base(np.array([[1.0, -1.0]]))
        search.tell(generation(target, target))
        asked = search.ask(8, np.random.default_rng(0))
        assert np.abs(asked - target).max(axis=(1, 2)).min() > 0.1

    def test_a_saved_search_goes_on_as_if_it_had_not_been(self) -> None:
        search, rng, target = make_search(), np.random.default_rng(0), np.zeros((1, *SHAPE))
        for _ in range(10):
            search.tell(generation(search.ask(8, rng), target))
        copy = cloudpickle.loads(cloudpickle.dumps(search))
        assert copy.base is None
        copy.base = base
        for _ in range(10):
            asked = search.ask(8, np.random.default_rng(1))
            assert_array_equal(copy.ask(8, np.random.default_rng(1)), asked)
            for one in (search, copy):
                one.tell(generation(asked, target))

    def test_the_global_generator_is_left_alone(self) -> None:
        np.random.seed(3)
        before = np.random.get_state()
        search = make_search()
        search.tell(generation(search.ask(8, np.random.default_rng(0)), np.zeros((1, *SHAPE))))
        assert_array_equal(np.random.get_state()[1], before[1])  # pyright: ignore

    def test_a_saved_search_is_small(self) -> None:
        assert len(cloudpickle.dumps(make_search())) < 50_000


class TestAlgorithm:
    def test_without_demonstrations_the_initial_trajectory_is_tried_first(self) -> None:
        model = make().learn(1)
        initial = model.initial_trajectory()
        context = gym.make(ENV_ID).reset()[0]
        assert_allclose(model.predict(context, deterministic=True)[0], initial, atol=1e-6)

    def test_it_learns_the_bottles_from_the_initial_trajectory(self) -> None:
        """Half of the seeds do, whichever version of cma is used."""
        models = [make(n_bases=8, population_size=10, seed=seed).learn(600) for seed in range(4)]
        assert sum(model.searches[0].solution is not None for model in models) >= 2

    def test_demonstrations_are_learned_before_the_first_rollout(self) -> None:
        shown = Demonstrations.from_task(ENV_ID, 2, seed=0)
        model = make(demonstrations=shown, pretraining=CNMPPretraining(400))
        predicted = model.predict(shown.contexts.astype(np.float32), deterministic=True)[0]
        assert np.sqrt(np.mean((predicted - shown.trajectories) ** 2)) < 0.05

    def test_residuals_may_be_shaped_like_the_demonstrations(self) -> None:
        """These begin alike and end apart: there is little to search at the start."""
        ramps = np.linspace(0, 1, 200)[:, None] * np.array([-1.0, 0.0, 1.0])[:, None, None]
        shown = Demonstrations(np.arange(12.0).reshape(3, 4), np.repeat(ramps, 2, axis=2))
        spread = []
        for shaped in (0.0, 0.99):
            with pytest.warns(DemonstrationWarning) as told:  # these lie outside both spaces
                model = make(demonstrations=shown, shaped=shaped, population_size=50)
            assert [str(each.message).split()[2] for each in told] == ["contexts", "trajectories"]
            model.learn(50)
            search: Any = model.searches[0].search
            tried = search.ask(50, np.random.default_rng(0))
            spread.append(tried.std(axis=0).mean(axis=1))
        assert spread[1][0] < 0.3 * spread[0][0]
        assert spread[1].max() > spread[0].max()

    def test_solved_contexts_are_remembered(self) -> None:
        shown = Demonstrations.from_task(ENV_ID, 3, seed=0)
        model = make(demonstrations=shown, pretraining=CNMPPretraining(400))
        model.learn(100)
        case = model.searches[0]
        assert case.solution is not None
        assert_array_equal(model.predict(case.context, deterministic=True)[0], case.solution)

    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"population_size": 2}, "population_size is 2"),
            ({"n_bases": 1}, "n_bases is 1"),
            ({"exploration_scale": -0.1}, r"exploration_scale is -0\.1"),
            ({"context_std": -0.1}, r"context_std is -0\.1"),
            ({"context_std": np.nan}, "context_std is nan"),
            ({"context_std": 0.3}, r"context_std is 0\.3, but there are no demonstrations"),
            ({"shaped": 0.9}, r"shaped is 0\.9, but there are no demonstrations"),
            ({"shaped": 1.1}, r"shaped is 1\.1; it must be in \[0, 1\]"),
            ({"exploration_scale": (0.1, 0.1, 0.1)}, "tuple of 2: one per dimension"),
            ({"demonstrations": np.zeros((2, 200, 2))}, "must be Demonstrations"),
        ],
    )
    def test_wrong_settings_are_refused(self, settings: dict[str, Any], message: str) -> None:
        with pytest.raises(ConfigurationError, match=message):
            make(**settings)

    def test_demonstrations_of_another_task_are_refused(self) -> None:
        with pytest.raises(InvalidDataError, match="contexts have 1 entries"):
            make(demonstrations=Demonstrations(np.zeros((1, 1)), np.zeros((1, 200, 2))))

    def test_a_loaded_model_goes_on_without_its_demonstrations(self, tmp_path: Path) -> None:
        shown = Demonstrations.from_task(ENV_ID, 2, seed=0)
        make(demonstrations=shown, context_std=0.3).learn(10).save(tmp_path / "model")
        loaded = CMAES.load(tmp_path / "model", env=gym.make(ENV_ID))
        assert loaded.learn(10).num_timesteps == 10
