"""BO, ACNMP's twin: what it answers, where its search begins, what it learns, and bad input."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from baselines import BO, BOPolicy
from sb3_nmp import (
    ACNMP,
    ACNMPCritic,
    ACNMPExploration,
    CNMPPretraining,
    ConfigurationError,
    Demonstrations,
    ResumeWarning,
    ShapedExploration,
)
from sb3_nmp.bayesian.search import CriticSearch, Subspace
from sb3_nmp.bayesian.shaped_noise import (
    FEWEST,
    LEAST_SHARE,
    nearer_scale,
    noise_directions,
    spread_over_time,
)
from sb3_nmp.common.regression import NEWEST, fit
from sb3_nmp.common.rollouts import Generation
from tests.test_acnmp import SHOWN, Reach, expert
from tests.test_another_context import Reach as Ending

EVERY = pytest.mark.parametrize("regression", ["nearest", "ridge", "quadratic", "gaussian-process"])
DEMONSTRATIONS = Demonstrations(SHOWN, expert(SHOWN))


def build(env: Any, regression: str = "quadratic", **more: Any) -> BO:
    settings: dict[str, Any] = {"demonstrations": DEMONSTRATIONS, "seed": 0, **more}
    return BO("MlpPolicy", env, policy_kwargs={"regression": regression}, **settings)


# -- the regressions -------------------------------------------------------------------------------


def test_each_regression_answers_what_it_can_express() -> None:
    rng = np.random.default_rng(0)
    known, asked = rng.uniform(-1, 1, (400, 2)), rng.uniform(-1, 1, (50, 2))

    def linear(x: np.ndarray) -> np.ndarray:
        return np.stack([x[:, 0] + 2, x[:, 0] - 3 * x[:, 1]], axis=1)

    def curved(x: np.ndarray) -> np.ndarray:
        return linear(x) + np.stack([x[:, 0] * x[:, 1], x[:, 1] ** 2], axis=1)

    def wavy(x: np.ndarray) -> np.ndarray:
        return np.sin(4 * x)

    def error(regression: Any, function: Any) -> float:
        answer = fit(regression, known, function(known))(asked)
        return float(np.abs(answer - function(asked)).max())

    assert error("ridge", linear) < 0.02
    assert error("quadratic", curved) < 0.02 < 0.1 < error("ridge", curved)
    assert error("gaussian-process", wavy) < 0.02 < 0.1 < error("quadratic", wavy)
    nearest = (((asked[:, None] - known) / known.std(axis=0)) ** 2).sum(axis=2).argmin(axis=1)
    assert_array_equal(fit("nearest", known, curved(known))(asked), curved(known)[nearest])


def test_a_gaussian_process_sees_the_newest_alone() -> None:
    """So its cost is bounded in a stream."""
    known = np.linspace(0, 1, NEWEST + 50)[:, None]
    forgotten = np.where(np.arange(len(known))[:, None] < 50, 99.0, known)
    fitted = [fit("gaussian-process", known, each)(known[50:]) for each in (forgotten, known)]
    assert_array_equal(fitted[0], fitted[1])


@EVERY
def test_contexts_units_do_not_matter(regression: Any) -> None:
    rng = np.random.default_rng(0)
    known, values, asked = rng.random((9, 2)), rng.random((9, 3)), rng.random((4, 2))
    unit = np.array([1.0, 1000.0])
    scaled = fit(regression, known * unit, values)(asked * unit)
    assert_allclose(
        scaled, fit(regression, known / known.std(axis=0), values)(asked / known.std(0))
    )


@EVERY
def test_one_demonstration_is_the_answer_everywhere(regression: Any) -> None:
    answer = fit(regression, np.array([[1.0, 2.0]]), np.array([[3.0, 4.0]]))
    assert_allclose(answer(np.array([[1.0, 2.0], [5.0, -9.0]])), [[3.0, 4.0]] * 2, atol=1e-12)


# -- the algorithm ---------------------------------------------------------------------------------


@EVERY
def test_a_context_is_answered_by_the_regression_on_the_demonstrations(regression: Any) -> None:
    model = build(Reach(0.3), regression)
    asked = np.array([[0.3], [2.0]], np.float32)
    flat = DEMONSTRATIONS.trajectories.reshape(len(DEMONSTRATIONS), -1)
    expected = fit(regression, DEMONSTRATIONS.contexts, flat)(asked.astype(np.float64))
    answered = model.predict(asked, deterministic=True)[0]
    assert_allclose(answered.reshape(2, -1), expected, rtol=1e-6)


def test_the_search_begins_at_the_answer_and_explores_acnmps_noise() -> None:
    noise = ShapedExploration(noise=0.7, n_bases=5, shaped=0.9, radius=0.4)
    model = build(Reach(2.0), exploration=noise, critic=ACNMPCritic(pull=0.1))
    first = model.predict(np.array([2.0], np.float32), deterministic=True)[0]
    tried: list[np.ndarray] = []
    model.learn(3, callback=lambda now, _: tried.append(now["actions"][0]) or True)
    assert_allclose(tried[0], first, rtol=1e-5)
    assert min(np.abs(each - first).max() for each in tried[1:]) > 0.01
    search: Any = model.searches[0].search
    mixing = spread_over_time(DEMONSTRATIONS, 0.9) * 0.3
    assert_allclose(search.space.directions, noise_directions(0.7 * mixing, 5))
    assert (search.radius, search.settings) == (0.4, ACNMPCritic(pull=0.1))
    acnmp = ACNMPExploration(latent=0.0, noise=0.7, n_bases=5, shaped=0.9, radius=0.4)
    twin: Any = ACNMP(
        "MlpPolicy", Reach(2.0), demonstrations=DEMONSTRATIONS, exploration=acnmp
    )._new_search(np.array([2.0], np.float32))
    assert_array_equal(twin.space.directions, search.space.directions)


@EVERY
def test_what_was_solved_joins_what_is_regressed_on(regression: Any) -> None:
    model = build(Reach(2.0), regression)
    before = model.policy.known.answer(np.array([[1.9]]))[0]
    model.learn(60)
    assert model.searches[0].solution is not None
    assert len(model.policy.known.trajectories) == len(DEMONSTRATIONS) + 1
    assert_array_equal(model.policy.known.trajectories[-1].numpy(), model.searches[0].solution)
    after = model.policy.known.answer(np.array([[1.9]]))[0]
    assert abs(after[-1, 0] - 1.9) < abs(before[-1, 0] - 1.9)


def test_a_stream_is_answered_better_and_better() -> None:
    env = Reach(low=1.0, high=3.0)
    model = build(env, "nearest", n_contexts=2)
    contexts = np.linspace(1.0, 3.0, 30, dtype=np.float32)[:, None]

    def miss() -> float:
        answered = model.policy.known.answer(contexts)
        return float(np.abs(answered[:, -1, 0] - contexts[:, 0]).mean())

    untaught = miss()
    model.learn(300)
    assert len(model.replay_buffer) > 5
    assert miss() < 0.2 * untaught


@EVERY
def test_a_loaded_model_answers_the_same_and_goes_on(regression: Any, tmp_path: Path) -> None:
    """The contract tests resume a run; this one asks for contexts that no rollout was made in."""
    model = build(Reach(2.0), regression).learn(60)
    asked = np.linspace(-1, 2, 9)[:, None]
    model.save(tmp_path / "model")
    loaded = BO.load(tmp_path / "model")
    assert_array_equal(loaded.policy.known.answer(asked), model.policy.known.answer(asked))
    other = build(Reach(2.0), regression)
    other.policy.known.answer(asked)  # fitted to the demonstrations alone
    other.policy.load_state_dict(model.policy.state_dict())
    assert_array_equal(other.policy.known.answer(asked), model.policy.known.answer(asked))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResumeWarning)  # what was assimilated is not loaded
        again = BO.load(tmp_path / "model", env=Reach(2.0)).learn(3)
    assert again.demonstrations == DEMONSTRATIONS


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"policy_kwargs": {"regression": "cubic"}},
            r"regression is 'cubic'; it must be 'nearest' or ",
        ),
        ({"demonstrations": None}, "BO learns from demonstrations first"),
        ({"exploration": ShapedExploration(noise=0.0)}, "a ShapedExploration with noise > 0"),
        ({"exploration": ACNMPExploration()}, "exploration is ACNMPExploration.*without a network"),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    known: dict[str, Any] = {"demonstrations": DEMONSTRATIONS, **settings}
    with pytest.raises(ConfigurationError, match=message):
        BO("MlpPolicy", Reach(0.0), **known)


def test_a_policy_that_knows_nothing_says_so() -> None:
    env: Any = Reach(0.0)
    with pytest.raises(ConfigurationError, match=r"knows no trajectory; call policy\.known\.learn"):
        BOPolicy(env.observation_space, env.action_space).predict(np.zeros(1, np.float32))


# -- how far a search among drawn contexts explores --------------------------------------------


def linear(error: float, n: int = 12) -> Demonstrations:
    """Demonstrations that are linear in the context, but for an error of that size."""
    rng = np.random.default_rng(0)
    contexts = rng.uniform(-1.0, 1.0, (n, 2))
    plain = np.linspace(0.0, 1.0, 30)[None, :, None] * (contexts @ [1.0, -2.0])[:, None, None]
    return Demonstrations(contexts, plain + error * rng.standard_normal((n, 1, 1)))


def test_a_search_among_drawn_contexts_explores_as_far_as_demonstrations_err() -> None:
    settings, scale = ShapedExploration(), (0.2,)
    shares = [nearer_scale(settings, scale, linear(error))[0] / 0.2 for error in (0.0, 0.05, 1.0)]
    assert shares[0] == pytest.approx(LEAST_SHARE)
    assert shares[1] == pytest.approx(0.05 / (settings.radius * 0.2), rel=0.4)
    assert shares[2] == 1.0
    assert nearer_scale(settings, scale, linear(0.0, FEWEST - 1)) == scale
    assert nearer_scale(ShapedExploration(foretold=False), scale, linear(0.0)) == scale


@pytest.mark.parametrize("algorithm", [BO, ACNMP])
def test_only_there_and_only_where_no_scale_was_given(algorithm: Any) -> None:
    contexts = np.linspace(-1.5, 1.5, 8)[:, None]
    shown = Demonstrations(contexts, np.stack([np.linspace([0.0], 3 * c, 20) for c in contexts]))
    quick: dict[str, Any] = {} if algorithm is BO else {"pretraining": CNMPPretraining(5)}

    def spread(pinned: bool, **given: Any) -> float:
        arguments = {"demonstrations": shown, "seed": 0, **quick, **given}
        model: Any = algorithm("MlpPolicy", Ending(-1.0, 1.0), **arguments)
        if algorithm is ACNMP:
            model.pretrain()
        model._pinned = pinned
        search = model._new_search(np.array([0.5], np.float32))
        return float(np.abs(search.space.directions).mean())

    whole = spread(True)
    assert spread(False) == pytest.approx(LEAST_SHARE * whole, rel=0.5)
    assert spread(False, exploration_scale=Ending.exploration_scale) == pytest.approx(whole)
    settings = ACNMPExploration if algorithm is ACNMP else ShapedExploration
    assert spread(False, exploration=settings(foretold=False)) == pytest.approx(whole)


@pytest.mark.parametrize(("radius", "n_rollouts"), [(0.15, 4), (0.7, 7)])
def test_a_region_shrinks_before_it_begins_anew_however_small_it_was(
    radius: float, n_rollouts: int
) -> None:
    space = Subspace(np.zeros((10, 1)), np.random.default_rng(0).normal(size=(4, 10, 1)))
    search = CriticSearch(space, radius, ACNMPCritic(n_candidates=50), None, [np.ones((10, 1))])
    rng, since = np.random.default_rng(0), []
    for reward in range(0, -12, -1):  # no rollout is better than the one before
        tried = search.ask(1, rng).astype(np.float32)
        none = np.zeros((1, 1), np.float32)
        search.tell(Generation(none, tried, np.array([float(reward)]), np.array([False])))
        since.append(search.n_restarts)
    assert since.index(1) + 1 == n_rollouts
