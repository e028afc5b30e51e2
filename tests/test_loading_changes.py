"""Arguments that loading changes: what is under way follows them, or says that it does not."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines import BO, CMAES, REPS, ContextualCMAES, ContextualREPS
from sb3_nmp import RCNMP, PDController, RCNMPTraining, ResumeWarning, ShapedExploration
from sb3_nmp.common.contextual import ContextualExploration
from tests.test_interruptions import SHOWN, envs


def executed(env: Any) -> list[float]:
    return [context for context, _ in env.envs[0].unwrapped.executed]


def test_contexts_are_drawn_anew_where_each_has_one_rollout_now(tmp_path: Path) -> None:
    model = REPS("MlpPolicy", envs(), population_size=8, rollouts_per_context=4, seed=0)
    model.learn(16).save(tmp_path / "model")
    env = envs()
    REPS.load(tmp_path / "model", env=env, rollouts_per_context=1).learn(24)
    assert len(set(executed(env))) >= 23  # the first one may be that of the generation before


def test_cmaes_goes_on_whatever_kind_of_number_its_population_is(tmp_path: Path) -> None:
    many: Any = np.int64(10)
    model = CMAES("MlpPolicy", envs(pinned=0.5), population_size=many, seed=0).learn(50)
    model.save(tmp_path / "model")
    loaded = CMAES.load(tmp_path / "model", env=envs(pinned=0.5))
    before: Any = model.searches[0].search
    after: Any = loaded.searches[0].search
    np.testing.assert_array_equal(after.mean, before.mean)
    assert np.abs(before.mean).max() > 0


@pytest.mark.parametrize("population_size", [3, 4, 7])
def test_cmaes_of_a_smaller_population_begins_anew_and_says_so(
    population_size: int, tmp_path: Path
) -> None:
    model = CMAES("MlpPolicy", envs(pinned=0.5), population_size=8, seed=0).learn(16)
    model.save(tmp_path / "model")
    model.save_replay_buffer(tmp_path / "found")
    loaded = CMAES.load(tmp_path / "model", env=envs(pinned=0.5), population_size=population_size)
    loaded.load_replay_buffer(tmp_path / "found")
    with pytest.warns(ResumeWarning, match=f"of 8 rollouts, and they have {population_size} now"):
        loaded.learn(4 * population_size)
    search: Any = loaded.searches[0].search
    selected = search._strategy.sp.weights
    assert selected.lambda_ == population_size and selected.mu <= population_size // 2


@pytest.mark.parametrize("algorithm", [ContextualREPS, ContextualCMAES])
def test_features_may_be_given_among_the_policys_arguments(algorithm: Any) -> None:
    model = algorithm(
        "MlpPolicy",
        envs(),
        population_size=8,
        seed=0,
        policy_kwargs={"context_features": "linear"},
    ).learn(16)
    assert model.context_features == model.policy.context_features == "linear"
    assert model._n_updates == 2


@pytest.mark.parametrize(
    ("algorithm", "shown", "changed"),
    [
        (BO, True, {"exploration": ShapedExploration(radius=0.3)}),
        (CMAES, False, {"pd_controller": PDController()}),
        (CMAES, False, {"exploration_scale": 0.1}),
    ],
)
def test_a_search_under_way_keeps_what_it_began_with_and_says_so(
    algorithm: Any, shown: bool, changed: dict[str, Any], tmp_path: Path
) -> None:
    given = {"demonstrations": SHOWN} if shown else {}
    model = algorithm("MlpPolicy", envs(pinned=0.5), seed=0, population_size=4, **given)
    model.learn(8).save(tmp_path / "model")
    (name,) = changed
    with pytest.warns(ResumeWarning, match=f"the search under way keeps {name} as it began"):
        algorithm.load(tmp_path / "model", env=envs(pinned=0.5), **changed)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        algorithm.load(tmp_path / "model", env=envs(pinned=0.5), max_generations=7)
        if algorithm is CMAES:  # what cannot be changed is as it was
            algorithm.load(tmp_path / "model", env=envs(pinned=0.5), n_bases=5)


def test_a_model_that_has_not_searched_yet_takes_what_is_given(tmp_path: Path) -> None:
    CMAES("MlpPolicy", envs(pinned=0.5), seed=0).save(tmp_path / "model")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        CMAES.load(tmp_path / "model", env=envs(pinned=0.5), pd_controller=PDController())


def test_a_search_over_contexts_follows_its_exploration(tmp_path: Path) -> None:
    quick = {"training": RCNMPTraining(2), "n_crossover": 4, "population_size": 10}
    model = RCNMP("MlpPolicy", envs(), seed=0, **quick)
    model.learn(20).save(tmp_path / "model")
    wide = ContextualExploration(wanted_rate=0.9)
    loaded = RCNMP.load(tmp_path / "model", env=envs(), contextual=wide)
    with pytest.warns(ResumeWarning):  # of the replay buffer, which was not loaded
        loaded.learn(10, reset_num_timesteps=False)
    assert loaded._search is not None and loaded._search.exploration == wide
