"""Searches over primitives: where they start, how far they reach, and what luck alone gives."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import benchmark_envs  # noqa: F401  (registers the tasks)
from baselines import CMAES, RandomSearch
from baselines.primitives.pd_filtered import bends
from sb3_nmp import ConfigurationError, Demonstrations, PDController, SmoothNoise
from tests.test_acnmp import SHOWN, Reach, expert

DEMONSTRATIONS = Demonstrations(SHOWN, expert(SHOWN))
ENV = "nmp/Bottles-v0"


def executed(model: Any, budget: int) -> np.ndarray:
    kept: list[np.ndarray] = []
    model.learn(budget, callback=lambda found, _: kept.append(found["actions"].copy()) is None)
    return np.concatenate(kept).astype(np.float64)


def test_the_first_rollout_is_the_initial_trajectory_and_the_others_bend_it_at_the_scale() -> None:
    model = RandomSearch("MlpPolicy", ENV, seed=0, population_size=50)
    tried = executed(model, 400)
    line = model.initial_trajectory()
    assert_allclose(tried[0], line, atol=1e-6)
    deviations = tried[1:] - line
    spread = np.sqrt((deviations**2).mean(axis=(0, 1)))
    assert_allclose(spread, model.first_scale(), rtol=0.1)
    ends = np.abs(deviations[:, [0, -1]]).max(axis=(0, 1)) / spread
    assert (ends < 0.5).all()  # the controller holds both ends


def test_without_a_controller_the_ends_move() -> None:
    model = RandomSearch("MlpPolicy", ENV, seed=0, pd_controller=None)
    tried = executed(model, 50)
    deviations = tried - tried[0]
    assert np.abs(deviations[:, -1]).mean() > 0.3 * max(model.first_scale())


def test_random_search_draws_the_same_points_whatever_the_rewards() -> None:
    class Upside(Reach):
        def step(self, action: Any) -> Any:
            observation, reward, *rest = super().step(action)
            return observation, -reward, *rest

    runs = [
        executed(RandomSearch("MlpPolicy", env, demonstrations=DEMONSTRATIONS, seed=1), 30)
        for env in (Reach(0.3), Upside(0.3))
    ]
    assert_array_equal(runs[0], runs[1])


def test_with_demonstrations_the_start_is_what_regression_answers() -> None:
    context = np.array([0.4], np.float32)
    for regression in ("nearest", "quadratic"):
        kwargs = {"regression": regression}
        model = RandomSearch(
            "MlpPolicy",
            Reach(0.4),
            demonstrations=DEMONSTRATIONS,
            policy_kwargs=kwargs,
            seed=0,
        )
        assert model.pd_controller is None
        start = model.policy.start(context[None])[0]
        assert_allclose(executed(model, 5)[0], start, atol=1e-5)
        own = model.policy.own_answer(context[None])
        assert own is not None
        assert_allclose(own[0], start, atol=1e-6)


def test_exploration_shaped_like_the_demonstrations_leaves_alone_where_they_agree() -> None:
    steady = DEMONSTRATIONS.trajectories.copy()
    steady[:, 0] = steady[0, 0]
    shown = Demonstrations(DEMONSTRATIONS.contexts, steady)
    model = RandomSearch("MlpPolicy", Reach(0.3), demonstrations=shown, shaped=1.0, seed=0)
    directions = model.directions()
    assert np.abs(directions[:, 0]).max() < 1e-9 < np.abs(directions[:, -1]).max()


def test_bends_keep_their_size_through_the_controller_and_hold_the_ends() -> None:
    bases = SmoothNoise(n_bases=6).bases(200).T[..., None]
    bent = bends(PDController(), bases)
    assert np.sum(bent**2) == pytest.approx(np.sum(bases**2))
    assert np.abs(bent[:, 0]).max() == 0.0
    assert np.abs(bent[:, -1]).max() < 0.1 < np.abs(bases[:, -1]).max()


def test_cmaes_through_the_controller_ends_where_the_base_does() -> None:
    free, held = (
        executed(CMAES("MlpPolicy", ENV, seed=0, n_bases=10, pd_controller=pd), 20)
        for pd in (None, PDController())
    )
    ends = [np.abs(tried[:, -1] - tried[0, -1]).max() for tried in (free, held)]
    assert ends[1] < 0.04 < 0.1 < ends[0]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"shaped": 0.5}, "shaped is 0.5; it must be in .* and 0 without demonstrations"),
        ({"n_bases": 1}, "n_bases is 1; it must be >= 2"),
        ({"policy_kwargs": {"regression": "cubic"}}, "regression is 'cubic'; it must be 'nearest'"),
    ],
)
def test_settings_that_do_not_fit_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        RandomSearch("MlpPolicy", ENV, **settings)
