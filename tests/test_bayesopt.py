"""TuRBO and LogEI: the trust region, what is proposed, what is learned, and bad input."""

import random
import sys
from typing import Any

import numpy as np
import pytest
import torch as th
from numpy.testing import assert_allclose

import benchmark_envs  # noqa: F401  (registers the tasks)
from baselines import LogEI, RandomSearch, TuRBO
from baselines.bayesopt.algorithms import BayesianPrimitiveSearch
from baselines.bayesopt.log_ei import LogEISearch, LogEISettings
from baselines.bayesopt.surrogate import Surrogate, isolated, values_of
from baselines.bayesopt.turbo import (
    FIRST_LENGTH,
    LEAST_LENGTH,
    TrustRegion,
    TuRBOSearch,
    TuRBOSettings,
    candidates,
    region_box,
)
from baselines.primitive_search import PointSearch
from sb3_nmp import ConfigurationError
from sb3_nmp.bayesian.search import Subspace
from sb3_nmp.common.rollouts import Generation

pytest.importorskip("botorch", reason="the extra 'botorch' is not installed")
ENV = "nmp/Bottles-v0"
SIZE, GOAL = 6, np.array([0.8, -0.5, 0.3, -0.9, 0.1, 0.6])
SPACE = Subspace(np.zeros((SIZE, 1)), np.eye(SIZE)[..., None])
TURBO = TuRBOSettings(10, 2.0, 3, None, True, 500, 100, 40)
LOG_EI = LogEISettings(10, 2.0, "rbf", False, 32, 1, 32, 20, 100, 40)


def rollouts(tried: np.ndarray, rewards: np.ndarray) -> Generation:
    return Generation(
        np.zeros((len(tried), 1), np.float32),
        tried.astype(np.float32),
        rewards,
        np.zeros(len(tried), bool),
    )


def minimise(search: PointSearch, n_generations: int, n: int = 5, seed: int = 0) -> float:
    """Return the least squared distance to GOAL that a search finds."""
    rng = np.random.default_rng(seed)
    for _ in range(n_generations):
        tried = search.ask(n, rng)
        assert tried.shape == (n, SIZE, 1)
        search.tell(rollouts(tried, -((tried[..., 0] - GOAL) ** 2).sum(axis=1)))
    return float(-search.rewards.max())


def make(name: str, **changes: Any) -> PointSearch:
    if name == "turbo":
        return TuRBOSearch(SPACE, 5, TuRBOSettings(**{**TURBO.__dict__, **changes}))
    return LogEISearch(SPACE, LogEISettings(**{**LOG_EI.__dict__, **changes}))


# -- the searches on a bowl ------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["turbo", "log-ei"])
def test_a_bowl_is_descended_and_chance_does_not_do_as_well(name: str) -> None:
    """Random points come as near as 2, squared; the searches ten times nearer."""
    rng = np.random.default_rng(0)
    luck = np.median([
        ((rng.uniform(-2, 2, (60, SIZE)) - GOAL) ** 2).sum(axis=1).min() for _ in range(20)
    ])  # fmt: skip
    assert luck > 1.5
    assert minimise(make(name), 12 if name == "turbo" else 8) < 0.12 * luck


def test_log_ei_proposes_near_the_best_that_its_process_knows() -> None:
    """On a bowl of which enough is known, the next point is near its bottom."""
    search = make("log-ei", n_initial=2)
    rng = np.random.default_rng(0)
    points = rng.uniform(-2, 2, (60, SIZE))
    search.tell(rollouts(points[..., None], -((points - GOAL) ** 2).sum(axis=1)))
    proposed = search.ask(1, rng)[..., 0]
    far = np.sqrt(((points - GOAL) ** 2).sum(axis=1)).min()
    assert np.sqrt(((proposed - GOAL) ** 2).sum(axis=1)).mean() < 0.5 * far


def test_turbo_proposes_inside_its_region_around_the_best_and_shrinks_it() -> None:
    search = make("turbo", copula=False)
    assert isinstance(search, TuRBOSearch)
    rng, tried = np.random.default_rng(1), []
    for _ in range(30):
        trajectories = search.ask(5, rng)
        tried.append(trajectories[..., 0])
        search.tell(rollouts(trajectories, -((tried[-1] - GOAL) ** 2).sum(axis=1)))
    assert LEAST_LENGTH < search.region.length < FIRST_LENGTH
    spread = [float(np.abs(part - part.mean(axis=0)).max()) for part in (tried[3], tried[-1])]
    assert spread[1] < 0.5 * spread[0]


@pytest.mark.parametrize("told_before", [0, 1])
def test_the_region_is_not_judged_before_the_design_is_done(told_before: int) -> None:
    search = TuRBOSearch(SPACE, 1, TuRBOSettings(**{**TURBO.__dict__, "failure_tolerance": 1}))
    if told_before:  # a greedy rollout, in a stream of contexts
        search.tell(rollouts(np.zeros((1, SIZE, 1)), np.zeros(1)))
    rng = np.random.default_rng(0)
    search.tell(rollouts(search.ask(1, rng), np.full(1, -1.0)))
    for _ in range(len(search._design) - 1):
        search.tell(rollouts(search.ask(1, rng), np.full(1, -1.0)))
    assert search.region.length == FIRST_LENGTH
    search.tell(rollouts(search.ask(1, rng), np.full(1, -1.0)))
    assert search.region.length < FIRST_LENGTH


def test_an_exhausted_region_begins_anew_and_the_model_forgets() -> None:
    search = make("turbo", failure_tolerance=1)
    assert isinstance(search, TuRBOSearch)
    rng, lengths = np.random.default_rng(0), []
    for generation in range(12):
        search.tell(rollouts(search.ask(5, rng), np.full(5, -float(generation))))  # ever worse
        lengths.append(search.region.length)
    n_halvings = int(np.ceil(np.log2(FIRST_LENGTH / LEAST_LENGTH)))
    assert lengths[:3] == [FIRST_LENGTH, FIRST_LENGTH, FIRST_LENGTH / 2]
    again = 2 + n_halvings
    assert lengths[again - 1] == FIRST_LENGTH > lengths[again - 2]
    assert len(search.cube) == 5 * (12 - again)
    assert len(search.points) == 60


# -- the trust region ------------------------------------------------------------------------------


def test_the_region_doubles_after_successes_in_a_row_and_halves_after_failures() -> None:
    region = TrustRegion(success_tolerance=2, failure_tolerance=3)
    seen = []
    for found in (1.0, 2.0, 2.001, 2.0, 1.0, 3.0, 2.0):
        region.update(2.0 if seen else 0.0, found)
        seen.append(region.length)
    # 2.001 is no success: the gain is below a thousandth of the best
    assert seen == [0.8, 0.8, 0.8, 0.4, 0.4, 0.4, 0.4]
    for _ in range(6):
        region.update(0.0, 1.0)
    assert region.length == 1.6
    for _ in range(100):
        region.update(0.0, 1.0)
    assert region.length == 1.6


def test_the_box_has_the_volume_of_a_cube_and_is_longer_where_little_varies() -> None:
    lengths = np.array([0.1, 0.4, 1.6])
    low, high = region_box(np.full(3, 0.5), lengths, 0.05)
    assert np.prod(high - low) == pytest.approx(0.05**3)
    assert_allclose((high - low) / (high - low)[0], [1.0, 4.0, 16.0])
    low, high = region_box(np.zeros(3), lengths, 1.0)
    assert (low >= 0).all()
    assert (high <= 1).all()


def test_candidates_lie_in_the_box_and_differ_in_twenty_coordinates_on_average() -> None:
    size, rng = 100, np.random.default_rng(0)
    centre, lengths = rng.uniform(0.3, 0.7, size), np.ones(size)
    drawn = candidates(centre, lengths, 0.2, 400, rng)
    low, high = region_box(centre, lengths, 0.2)
    assert ((drawn >= low) & (drawn <= high)).all()
    changed = (drawn != centre).sum(axis=1)
    assert changed.min() >= 1
    assert 19 < changed.mean() < 22


# -- what the process sees -------------------------------------------------------------------------


def test_the_copula_keeps_order_alone_and_the_plain_values_are_standardised() -> None:
    rng = np.random.default_rng(0)
    rewards = rng.normal(size=50)
    monotone = values_of(rewards, copula=True)
    assert_allclose(monotone, values_of(np.exp(3 * rewards), copula=True))
    assert (np.argsort(monotone) == np.argsort(rewards)).all()
    plain = values_of(rewards, copula=False)
    assert plain.mean() == pytest.approx(0)
    assert plain.std() == pytest.approx(1)
    assert values_of(np.ones(3), copula=False).tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("kernel", ["matern", "rbf"])
def test_the_process_predicts_and_its_kernel_is_sought_when_rollouts_grew(kernel: Any) -> None:
    rng = np.random.default_rng(0)
    cube = rng.uniform(size=(60, 2))
    values = values_of(np.sin(5 * cube[:, 0]), copula=False)
    surrogate = Surrogate(kernel, 60)
    with isolated(rng):
        process = surrogate.fit(cube, values, 60)
        expected = process.posterior(th.as_tensor(cube)).mean.detach().numpy()[:, 0]
        assert np.abs(expected - values).max() < 0.1
        before = dict(surrogate._found)
        (lengths,) = (value for name, value in before.items() if "lengthscale" in name)
        assert lengths[0, 1] > lengths[0, 0]  # nothing varies along the second coordinate
        surrogate.fit(cube, -values, 61)
        assert is_same(before, surrogate._found)
        surrogate.fit(cube, np.cos(9 * cube[:, 1]), 90)
        assert not is_same(before, surrogate._found)


def is_same(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> bool:
    return all(np.array_equal(one[name], other[name]) for name in one)


def test_the_global_generators_and_settings_are_left_alone() -> None:
    th.manual_seed(3)
    np.random.seed(3)
    random.seed(3)
    before = th.get_rng_state(), np.random.get_state()[1].tolist(), random.getstate()  # pyright: ignore
    minimise(make("turbo"), 4)
    minimise(make("log-ei"), 4)
    assert th.equal(before[0], th.get_rng_state())
    assert before[1] == np.random.get_state()[1].tolist()  # pyright: ignore
    assert before[2] == random.getstate()
    assert th.get_default_dtype() == th.float32


# -- the algorithms --------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", [TuRBO, LogEI])
def test_the_bottles_are_passed_and_better_than_by_luck(algorithm: Any) -> None:
    best = {}
    for each in (algorithm, RandomSearch):
        rewards: list[float] = []
        model = each("MlpPolicy", ENV, seed=2000)
        model.learn(
            200, callback=lambda found, _, kept=rewards: kept.extend(found["rewards"]) is None
        )
        best[each] = max(rewards)
    assert best[algorithm] > best[RandomSearch]


@pytest.mark.parametrize("algorithm", [TuRBO, LogEI])
def test_without_botorch_the_extra_is_named(algorithm: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr("baselines.bayesopt.surrogate.find_spec", lambda _: None)
    with pytest.raises(ConfigurationError, match=r"needs BoTorch, .*sb3-nmp\[botorch\]"):
        algorithm("MlpPolicy", ENV)


def test_botorch_is_imported_where_it_is_used_alone() -> None:
    import subprocess

    code = "import sys, baselines; raise SystemExit('botorch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize(
    ("algorithm", "settings", "message"),
    [
        (TuRBO, {"reach": 0.0}, "reach is 0.0; it must be finite and > 0"),
        (TuRBO, {"n_candidates": 3}, "n_candidates is 3; it must be at least the population of 5"),
        (TuRBO, {"failure_tolerance": 0}, "failure_tolerance is 0; it must be >= 1, or None"),
        (LogEI, {"n_initial": 1}, "n_initial is 1; it must be >= 2"),
        (LogEI, {"kernel": "cubic"}, "kernel is 'cubic'; it must be 'matern' or 'rbf'"),
        (LogEI, {"n_restarts": 99}, "n_restarts is 99; it must be >= 1 and at most n_raw"),
    ],
)
def test_settings_that_do_not_fit_are_refused(
    algorithm: type[BayesianPrimitiveSearch], settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        algorithm("MlpPolicy", ENV, **settings)
