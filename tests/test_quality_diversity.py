"""CMA-ME: its measures, its archive, what it finds, what is saved, and bad input."""

import subprocess
import sys
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from stable_baselines3.common.env_util import make_vec_env

from baselines import CMAME
from baselines.quality_diversity.archive_search import ArchiveSearch, part_means
from benchmark_envs import TrajectoryVecEnv, make_task
from benchmark_envs.tasks.bottles import BOTTLES
from sb3_nmp import ConfigurationError
from sb3_nmp.bayesian.search import Subspace
from sb3_nmp.common.rollouts import Generation

ENV = "nmp/Bottles-v0"
SIZE = 6
#: over six time points a coordinate each; the first of two parts in time is the first three
SPACE = Subspace(np.zeros((SIZE, 1)), np.eye(SIZE)[..., None])
HILL = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
needs_ribs = pytest.mark.skipif(find_spec("ribs") is None, reason="the extra 'qd' is missing")


def search(**changes: Any) -> ArchiveSearch:
    settings = {"n_emitters": 2, "population_size": 10, "n_cells": 20, "n_parts": 2, "sigma": 0.5}
    return ArchiveSearch(SPACE, **{**settings, **changes})


def rollouts(tried: np.ndarray, rewards: np.ndarray) -> Generation:
    n = len(tried)
    contexts, successes = np.zeros((n, 1), np.float32), np.zeros(n, bool)
    return Generation(contexts, tried.astype(np.float32), rewards, successes)


def two_hills(tried: np.ndarray) -> np.ndarray:
    """Return minus the squared distance to the nearer one of two hills."""
    points = tried[..., 0]
    return -np.minimum(((points - HILL) ** 2).sum(axis=1), ((points + HILL) ** 2).sum(axis=1))


def climb(each: ArchiveSearch, n_generations: int, seed: int = 0) -> ArchiveSearch:
    rng = np.random.default_rng(seed)
    for _ in range(n_generations):
        tried = each.ask(each.population_size, rng)
        each.tell(rollouts(tried, two_hills(tried)))
    return each


def test_measures_are_mean_deviations_in_units_of_exploration() -> None:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(12, 20, 2))
    points = rng.standard_normal((4000, 12))
    measures = points @ part_means(directions, 4)
    assert measures.shape == (4000, 8)
    assert_allclose(measures.std(axis=0), 1.0, atol=0.05)
    bent = np.tensordot(points, directions, axes=1)
    first = bent[:, :5, 0].mean(axis=1)
    assert abs(np.corrcoef(first, measures[:, 0])[0, 1]) > 0.999
    stiff = directions * [1.0, 0.0]
    assert (part_means(stiff, 4)[:, [1, 3, 5, 7]] == 0.0).all()


@needs_ribs
@pytest.mark.parametrize("seed", range(4))
def test_both_of_two_hills_are_in_the_archive_and_higher_than_chance_comes(seed: int) -> None:
    each = climb(search(), 80, seed)
    drawn = 0.5 * np.random.default_rng(seed).standard_normal((800, SIZE))
    luck = two_hills(drawn[..., None])
    for hill in (HILL, -HILL):
        near, by_luck = (
            ((points - hill) ** 2).sum(axis=1) < 3.0 for points in (each.points, drawn)
        )
        assert each.rewards[near].max() > luck[by_luck].max() > -1.0
    cells = each.cells(np.stack([HILL, -HILL]))
    assert cells[0] != cells[1]


@needs_ribs
def test_strategies_are_told_what_they_asked_for() -> None:
    each = search(population_size=11)
    assert each.ask(11, np.random.default_rng(0)).shape == (11, SIZE, 1)
    told: list[np.ndarray] = []

    class Told:
        def tell(self, solution: np.ndarray, *rest: Any) -> None:
            told.append(solution)
            assert all(len(part) == len(solution) for part in rest[:2])
            assert all(len(part) == len(solution) for part in rest[2].values())

    each._emitters = [Told(), Told()]  # pyright: ignore
    tried = np.arange(66.0).reshape(11, 6, 1)
    each.tell(rollouts(tried, np.zeros(11)))
    assert_allclose(np.concatenate(told), tried[..., 0])
    assert [len(part) for part in told] == [6, 5]


@needs_ribs
def test_a_rollout_that_was_not_asked_for_is_known_and_told_to_no_strategy() -> None:
    each = search()
    each.tell(rollouts(np.zeros((1, SIZE, 1)), np.array([-1.0])))
    assert len(each.points) == 1
    assert each._archive is None
    assert climb(each, 2).rewards.shape == (21,)


@needs_ribs
def test_a_search_made_again_from_what_was_told_goes_on_to_the_bit() -> None:
    each = search()
    each.tell(rollouts(np.zeros((1, SIZE, 1)), np.array([-1.0])))
    climb(each, 5)
    asked = each.ask(10, np.random.default_rng(1))
    again = ArchiveSearch.__new__(ArchiveSearch)
    again.__setstate__(each.__getstate__())
    for half in (each, again):
        half.tell(rollouts(asked, two_hills(asked)))
    one, other = climb(each, 3, seed=1), climb(again, 3, seed=1)
    assert np.array_equal(one.points, other.points)
    assert len(np.unique(one.points, axis=0)) == len(one.points)


@needs_ribs
def test_modes_are_successes_of_different_cells_and_both_ways_are_among_them() -> None:
    env = make_vec_env(ENV, n_envs=20, vec_env_cls=TrajectoryVecEnv)
    model = CMAME("MlpPolicy", env, seed=1000).learn(300)
    trajectories, rewards = model.policy.modes(BOTTLES[None])
    task = make_task(ENV, n_threads=1)
    done = task.simulate(BOTTLES, trajectories[0])
    assert done.successes.all()
    assert_allclose(done.rewards, rewards[0], rtol=1e-5)
    found = {task.mode_of(BOTTLES, executed) for executed in done.executed}
    assert len(found) == 2
    answer, _ = model.predict(BOTTLES, deterministic=True)
    best = trajectories[0][rewards[0].argmax()]
    assert_allclose(answer, best, atol=1e-6)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"n_emitters": 7}, "n_emitters is 7; .* the population of 20 must give each at least 3"),
        ({"n_emitters": 0}, "n_emitters is 0; it must be >= 1"),
        ({"n_cells": 1}, "n_cells is 1; it must be >= 2"),
        ({"n_parts": 201}, "n_parts is 201; trajectories have 200 time points"),
        ({"n_parts": 0}, "n_parts is 0; it must be >= 1"),
        ({"sigma": 0.0}, "sigma is 0.0; it must be finite and > 0"),
    ],
)
@needs_ribs
def test_settings_that_do_not_fit_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        CMAME("MlpPolicy", ENV, **settings)


def test_without_pyribs_the_extra_is_named(monkeypatch: Any) -> None:
    monkeypatch.setattr("baselines.quality_diversity.archive_search.find_spec", lambda _: None)
    with pytest.raises(ConfigurationError, match=r"needs pyribs, .*sb3-nmp\[qd\]"):
        CMAME("MlpPolicy", ENV)


def test_pyribs_is_imported_where_it_is_used_alone() -> None:
    code = "import sys, baselines; raise SystemExit('ribs' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
