"""ACNMP: the CNMP, exploration, critic, advantages, the two ways to learn, and bad input."""

import json
import zipfile
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th

from sb3_nmp import (
    ACNMP,
    ACNMPAdaptation,
    ACNMPCritic,
    ACNMPExploration,
    CNMPArchitecture,
    CNMPPretraining,
    ConfigurationError,
    Demonstrations,
    InvalidDataError,
)
from sb3_nmp.acnmp.exploration import directions
from sb3_nmp.acnmp.losses import advantages, policy_gradient_loss
from sb3_nmp.acnmp.search import PolicySearch
from sb3_nmp.bayesian.critic import Critic, normal_scores, two_sided, varying_costs
from sb3_nmp.bayesian.gaussian_process import GaussianProcess, Hypotheses
from sb3_nmp.bayesian.search import CriticSearch, Subspace, views
from sb3_nmp.bayesian.shaped_noise import noise_directions, spread_over_time
from sb3_nmp.common.context_search import ContextSearch
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.cnmp_training import pretrain

T = 20
TIMES = np.linspace(0.0, 1.0, T)
SIZES: dict[str, Any] = {
    "representation_dim": 4,
    "encoder_arch": (16,),
    "decoder_arch": (32,),
    "n_frequencies": 2,
}
SMALL = CNMPArchitecture(**SIZES)
QUICK = CNMPPretraining(n_steps=300)


def expert(contexts: np.ndarray) -> np.ndarray:
    """Start at 0 and end at the context, bent in between: shape (N, T, 1)."""
    c = np.asarray(contexts).reshape(-1, 1)
    return (c * TIMES + 0.3 * np.sin(np.pi * TIMES) * (1 + c**2))[..., None]


class Reach(gym.Env[Any, Any]):
    """End where the context says; an instant toy with the interface of a trajectory bandit."""

    def __init__(
        self,
        context: float | None = None,
        low: float = -1.0,
        high: float = 1.0,
        tolerance: float = 0.05,
    ) -> None:
        self.tolerance = tolerance
        self.observation_space = gym.spaces.Box(-3, 3, (1,), np.float32)
        self.action_space = gym.spaces.Box(-9, 9, (T, 1), np.float32)
        self.exploration_scale = np.array([0.3])
        self.pinned, self.range = context, (low, high)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        drawn = self.np_random.uniform(*self.range) if self.pinned is None else self.pinned
        given = (options or {}).get("context", [drawn])
        self.context = np.array(given, np.float32)
        return self.context, {}

    def step(self, action: Any) -> Any:
        error = abs(float(action[-1, 0] - self.context[0]))
        steps = np.zeros(T)
        steps[-1] = -error
        info = {"is_success": error < self.tolerance, "step_rewards": steps, "reward_end": -error}
        return self.context, -error, True, False, info


SHOWN = np.linspace(-1, 1, 7)[:, None]


@pytest.fixture(scope="module")
def demonstrations() -> Demonstrations:
    return Demonstrations(SHOWN, expert(SHOWN))


@pytest.fixture(scope="module")
def cnmp(demonstrations: Demonstrations) -> CNMP:
    th.manual_seed(0)
    untrained = CNMP(1, (T, 1), SMALL)
    return pretrain(demonstrations, CNMPPretraining(1000), np.random.default_rng(0), untrained)


@pytest.fixture(scope="module")
def latent(demonstrations: Demonstrations) -> CNMP:
    """A network whose representation alone tells trajectories apart."""
    th.manual_seed(0)
    untrained = CNMP(1, (T, 1), replace(CNMPArchitecture.preset("latent"), **SIZES))
    return pretrain(demonstrations, CNMPPretraining(1000), np.random.default_rng(0), untrained)


def build(demonstrations: Demonstrations, env: gym.Env[Any, Any], **more: Any) -> ACNMP:
    settings = {"pretraining": QUICK, "policy_kwargs": {"cnmp": SMALL}, "seed": 0, **more}
    return ACNMP("MlpPolicy", env, demonstrations=demonstrations, **settings)


def test_parameters_of_a_trained_network_are_not_trained_anew(
    demonstrations: Demonstrations, monkeypatch: pytest.MonkeyPatch
) -> None:
    trained = build(demonstrations, Reach(0.0)).pretrain()
    fresh = build(demonstrations, Reach(0.0))
    fresh.set_parameters(trained.get_parameters())  # type: ignore[arg-type]  # SB3 types it so
    monkeypatch.setattr(ACNMP, "pretrain", lambda self: pytest.fail("it trains anew"))
    fresh.learn(1)
    with pytest.raises(pytest.fail.Exception, match="it trains anew"):
        build(demonstrations, Reach(0.0)).learn(1)


def hypotheses(*views: np.ndarray) -> Hypotheses:
    return Hypotheses(views, ACNMPCritic().lengths, ACNMPCritic().noises)


def generation(trajectories: np.ndarray, rewards: np.ndarray, **more: Any) -> Generation:
    n = len(rewards)
    successes = more.pop("successes", np.zeros(n, bool))
    return Generation(
        np.zeros((n, 1), np.float32), trajectories.astype(np.float32), rewards, successes, **more
    )


# -- the CNMP ------------------------------------------------------------------------------------


def test_the_cnmp_interpolates_between_demonstrations(cnmp: CNMP) -> None:
    between = np.array([[-0.5], [0.2], [0.8]])
    error = cnmp.trajectories(between) - expert(between)
    assert np.sqrt((error**2).mean()) < 0.05


def test_via_points_pull_the_trajectory(cnmp: CNMP, demonstrations: Demonstrations) -> None:
    """Shown a point of another demonstration, the answer moves towards it."""
    context, other = np.array([[0.0]]), expert(np.array([0.67]))[0]
    free = cnmp.trajectories(context)[0]
    pulled = cnmp.trajectories(context, ([TIMES[10]], [other[10]]))[0]
    assert abs(pulled[10] - other[10]) < abs(free[10] - other[10])
    model = build(demonstrations, Reach(0.0)).pretrain()
    answer, _ = model.predict(np.zeros(1), deterministic=True, via_points=([0.5], [[0.7]]))
    assert answer.shape == (T, 1)
    for points, message in (
        (([1.5], [[0.0]]), "must lie in"),
        (([0.5], [[0.0, 1.0]]), "need"),
        (([], np.zeros((0, 1))), "O >= 1"),
        (([0.5], [[np.nan]]), "finite"),
    ):
        with pytest.raises(InvalidDataError, match=message):
            model.predict(np.zeros(1), deterministic=True, via_points=points)


def test_samples_differ_and_the_mean_does_not(demonstrations: Demonstrations) -> None:
    model = build(demonstrations, Reach(0.0)).pretrain()
    means = [model.predict(np.zeros(1), deterministic=True)[0] for _ in range(2)]
    samples = [model.predict(np.zeros(1))[0] for _ in range(2)]
    np.testing.assert_array_equal(means[0], means[1])
    assert not np.array_equal(samples[0], samples[1])


def test_the_representation_tells_demonstrations_apart(
    latent: CNMP, demonstrations: Demonstrations
) -> None:
    """Without the context in the decoder, all that differs goes through the latent space."""
    codes = latent.encode_whole(demonstrations)
    condition = latent.condition(th.zeros(len(SHOWN), 1))
    with th.no_grad():
        decoded = latent.mean(condition, codes).numpy()
    assert np.sqrt(((decoded - demonstrations.trajectories) ** 2).mean()) < 0.1


@pytest.mark.parametrize(
    ("settings", "given", "rule"),
    [
        (ACNMPCritic, {"pull": "x"}, "pull is 'x'; it must be a number"),
        (ACNMPCritic, {"pull": np.inf}, "pull is inf; it must be >= 0 and finite"),
        (ACNMPCritic, {"lengths": 3.0}, "lengths is 3.0; it must be a tuple"),
        (ACNMPCritic, {"n_moments": 0}, "n_moments is 0; it must be >= 1"),
        (ACNMPCritic, {"n_rounds": -1}, "n_rounds is -1; it must be >= 0"),
        (ACNMPCritic, {"n_refinements": 0}, "n_refinements is 0; it must be >= 1"),
        (ACNMPCritic, {"refinement_scale": 0.0}, "refinement_scale is 0.0; it must be > 0"),
        (ACNMPCritic, {"candidate_scales": ()}, "candidate_scales is .*at least one value"),
        (ACNMPCritic, {"terms": "yes"}, "terms is 'yes'; it must be True or False"),
        (ACNMPExploration, {"radius": "x"}, "radius is 'x'; it must be a number"),
        (ACNMPAdaptation, {"keep_answers": "yes"}, "keep_answers is 'yes'; it must be True"),
        (ACNMPAdaptation, {"n_final_steps": -1}, "n_final_steps is -1; it must be >= 0"),
    ],
)
def test_settings_of_a_wrong_kind_or_size_are_refused(
    settings: type, given: dict[str, Any], rule: str
) -> None:
    with pytest.raises(ConfigurationError, match=rule):
        settings(**given)


def test_settings_outside_their_range_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="n_steps is -1"):
        CNMPPretraining(n_steps=-1)
    with pytest.raises(ConfigurationError, match="learning_rate is 0"):
        CNMPPretraining(learning_rate=0)
    with pytest.raises(ConfigurationError, match=r"latent is -1.*>= 0"):
        ACNMPExploration(latent=-1)
    with pytest.raises(ConfigurationError, match="nothing is explored"):
        ACNMPExploration(latent=0, noise=0)
    with pytest.raises(ConfigurationError, match="radius is 0"):
        ACNMPExploration(radius=0)
    with pytest.raises(ConfigurationError, match=r"pull is -1; it must be >= 0"):
        ACNMPCritic(pull=-1)
    with pytest.raises(ConfigurationError, match="at least one value"):
        ACNMPCritic(lengths=())
    with pytest.raises(ConfigurationError, match="n_remembered is 1; it must be >= 2"):
        ACNMPCritic(n_remembered=1)
    with pytest.raises(ConfigurationError, match=r"shaped is 1.5; it must be in \[0, 1\]"):
        ACNMPExploration(shaped=1.5)
    with pytest.raises(ConfigurationError, match=r"advantage is 'best'; it must be 'to_go' or"):
        ACNMPAdaptation(advantage="best")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ConfigurationError, match="n_training_steps is -1"):
        ACNMPAdaptation(n_training_steps=-1)


# -- exploration ---------------------------------------------------------------------------------


def test_directions_have_the_scale_asked_for(latent: CNMP, demonstrations: Demonstrations) -> None:
    def found(**settings: float) -> np.ndarray:
        off: dict[str, Any] = {"latent": 0.0, "noise": 0.0, **settings}
        return directions(ACNMPExploration(**off), (0.2,), latent, demonstrations, np.array([0.3]))

    def rms(direction: np.ndarray) -> float:
        return float(np.sqrt((direction**2).mean()))

    latents = found(latent=0.5)
    assert latents.shape == (3, T, 1)
    assert rms(latents[0]) == pytest.approx(0.1)
    assert rms(latents[1]) < rms(latents[0])
    contexts = found(context=2.0)
    assert contexts.shape == (1, T, 1)
    assert rms(contexts[0]) == pytest.approx(0.4)
    noise = found(noise=1.0)
    assert noise.shape == (8, T, 1)
    assert np.sqrt((noise**2).sum(axis=0).mean()) == pytest.approx(0.2, rel=0.05)


def test_shaped_noise_is_small_where_the_demonstrations_agree(
    demonstrations: Demonstrations,
) -> None:
    shape = spread_over_time(demonstrations, 0.8)[:, 0, 0]
    assert 0 < shape[0] < 0.5 < 1 < shape[-1]
    assert np.mean(shape**2) == pytest.approx(1.0)
    np.testing.assert_allclose(spread_over_time(demonstrations[:1], 0.8), np.ones((T, 1, 1)))
    np.testing.assert_allclose(spread_over_time(demonstrations, 0.0), np.ones((T, 1, 1)))


def test_shaped_noise_moves_dimensions_together_as_the_demonstrations_do() -> None:
    rng = np.random.default_rng(0)
    one = rng.standard_normal((50, T, 1))
    joined = Demonstrations(np.zeros((50, 1)), np.concatenate([one, -one, 0 * one], axis=2))
    unit = rng.standard_normal((4000, 3))
    for share, expected in ((0.0, 0.0), (0.5, -0.5), (1.0, -1.0)):
        noise = np.einsum("nd,tde->nte", unit, spread_over_time(joined, share))
        x, y, constant = noise.transpose(2, 0, 1).reshape(3, -1)
        assert np.corrcoef(x, y)[0, 1] == pytest.approx(expected, abs=0.05)
        assert np.corrcoef(x, constant)[0, 1] == pytest.approx(0.0, abs=0.05)
        np.testing.assert_allclose([x.std(), y.std(), constant.std()], 1.0, atol=0.05)


# -- the critic and the search -------------------------------------------------------------------


def test_the_critic_predicts_a_smooth_function() -> None:
    rng = np.random.default_rng(0)
    points, fresh = rng.standard_normal((60, 3)), 0.5 * rng.standard_normal((50, 3))

    def value(x: np.ndarray) -> np.ndarray:
        return -((x - 0.5) ** 2).sum(axis=1)

    critic = GaussianProcess.fit(points, value(points), hypotheses(np.eye(3)))
    mean, std = critic.predict(fresh)
    assert np.corrcoef(mean, value(fresh))[0, 1] > 0.98
    _, far = critic.predict(10 + fresh)
    assert far.min() > std.max()
    believer = critic.condition_on_mean(fresh[0])
    assert believer.predict(fresh[:1])[1][0] < std[0]
    assert believer.predict(fresh[:1])[0][0] == pytest.approx(mean[0], abs=1e-2)


def test_the_critic_looks_at_the_moment_that_a_cost_depends_on() -> None:
    rng = np.random.default_rng(3)
    directions = noise_directions(np.tile(0.3 * np.eye(2), (100, 1, 1)), 6)
    points, fresh = rng.standard_normal((2, 12, 12))

    def cost_at_the_end(x: np.ndarray) -> np.ndarray:
        return -np.sum((np.tensordot(x, directions[:, -1], axes=1) - 0.2) ** 2, axis=1)

    every, *moments = views(directions, 9)
    values = cost_at_the_end(points)
    critic = GaussianProcess.fit(points, values, hypotheses(every, *moments))
    assert critic.view is moments[-1]
    whole = GaussianProcess.fit(points, values, hypotheses(every))
    errors = [np.abs(each.predict(fresh)[0] - cost_at_the_end(fresh)) for each in (critic, whole)]
    assert errors[0].mean() < errors[1].mean() / 3


def test_costs_that_add_up_to_the_reward_are_predicted_apart() -> None:
    rng = np.random.default_rng(1)
    costs = {"a": -rng.random(9), "b": -rng.random(9), "zero": np.zeros(9)}
    rollouts = generation(np.zeros((9, T, 1)), costs["a"] + costs["b"], terms=costs)
    assert len(varying_costs(rollouts)) == 2
    assert len(Critic.fit(rng.random((9, 2)), rollouts, hypotheses(np.eye(2))).squares) == 2
    unrelated = generation(np.zeros((9, T, 1)), rng.random(9), terms=costs)
    assert varying_costs(unrelated) == {}
    assert Critic.fit(rng.random((9, 2)), unrelated, hypotheses(np.eye(2))).whole is not None
    assert normal_scores(np.array([3.0, 1.0, 2.0])).argmax() == 0


def test_a_critic_of_the_sum_alone_does_not_see_the_terms() -> None:
    """Other terms of the same sum change what the critic asks for only where it may see them."""
    rng = np.random.default_rng(0)
    space = Subspace(np.zeros((T, 1)), rng.standard_normal((3, T, 1)))
    tried, costs = rng.standard_normal((9, T, 1)), rng.random(9)
    shares = rng.random((2, 9))

    def asked(critic: ACNMPCritic, share: np.ndarray) -> np.ndarray:
        search = CriticSearch(space, 0.7, critic)
        terms = {"a": -costs * share, "b": -costs * (1 - share)}
        search.tell(generation(tried, -costs, terms=terms))
        return search.ask(2, np.random.default_rng(1))

    blind, seeing = ACNMPCritic(terms=False), ACNMPCritic()
    np.testing.assert_array_equal(asked(blind, shares[0]), asked(blind, shares[1]))
    assert np.abs(asked(seeing, shares[0]) - asked(seeing, shares[1])).max() > 1e-3
    assert np.abs(asked(seeing, shares[0]) - asked(blind, shares[0])).max() > 1e-3


def test_the_believer_keeps_the_means_and_is_what_a_fit_to_the_means_would_be() -> None:
    rng = np.random.default_rng(0)
    points, fresh = rng.standard_normal((20, 3)), rng.standard_normal((5, 3))
    process = GaussianProcess.fit(points, np.sin(points).sum(axis=1), hypotheses(np.eye(3)))
    believer = process.condition_on_mean(fresh[0])
    np.testing.assert_allclose(believer.predict(fresh)[0], process.predict(fresh)[0])
    joined = np.concatenate([points, fresh[:1]])
    again = GaussianProcess.fit(joined, np.arange(21.0), process.chosen)
    expected = again.predict(fresh)[1] * np.sqrt(process.variance / again.variance)
    np.testing.assert_allclose(believer.predict(fresh)[1], expected, rtol=1e-6)


def test_a_long_search_is_fitted_to_its_best_and_newest_and_seldom_chooses_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(0)
    space = Subspace(np.zeros((T, 1)), rng.standard_normal((3, T, 1)))
    search = CriticSearch(space, 0.7, ACNMPCritic(n_remembered=20, n_candidates=30))
    seen: list[tuple[np.ndarray, int]] = []
    fit = GaussianProcess.fit

    def watched(points: np.ndarray, values: np.ndarray, known: Hypotheses) -> GaussianProcess:
        seen.append((points, len(known.views)))
        return fit(points, values, known)

    monkeypatch.setattr(GaussianProcess, "fit", watched)
    for _ in range(30):
        search.tell(generation(rng.standard_normal((2, T, 1)), rng.random(2)))
        search.ask(1, rng)
    assert [len(points) for points, _ in seen] == [min(2 * n, 20) for n in range(1, 31)]
    best = search.points[search.rewards.argsort()[-10:]]
    assert {*map(tuple, best), *map(tuple, search.points[-5:])} <= {*map(tuple, seen[-1][0])}
    chosen_anew = [2 * n for n, (_, n_views) in enumerate(seen, 1) if n_views > 1]
    assert chosen_anew[:5] == [2, 4, 6, 8, 10]
    assert [n for n in chosen_anew if n > 40] == [42, 48, 54, 60]  # a tenth more each time


def test_too_little_and_too_much_are_two_sides_of_one_error() -> None:
    rng = np.random.default_rng(2)
    points = rng.standard_normal((8, 1))
    error = 3 * points[:, 0] - 2  # zero at 2 / 3
    short, excess, other = np.maximum(-error, 0), np.maximum(error, 0), 1 + rng.random(8)
    alone, signed = two_sided({"short": short, "other": other, "excess": excess})
    np.testing.assert_array_equal(signed["excess - short"], error)
    assert [*alone] == ["other"] and alone["other"] is other
    assert two_sided({"short": short, "longer": short + 0.1})[1] == {}
    terms = {"short": -short, "excess": -excess}
    rollouts = generation(np.zeros((8, T, 1)), -np.abs(error), terms=terms)
    critic = Critic.fit(points, rollouts, hypotheses(np.eye(1)))
    tried = np.linspace(-2, 2, 401)[:, None]
    best = tried[critic.draw_upper_bounds(tried, rng).argmax(), 0]
    assert best == pytest.approx(2 / 3, abs=0.05)


def test_what_was_chosen_for_an_error_serves_no_other() -> None:
    """Where too much is paid first, two errors are two others afterwards."""
    rng = np.random.default_rng(4)
    points = rng.standard_normal((21, 2))
    points[-1] = 0.0, 3.0
    signed = np.minimum(points[:, 1], 1.0)  # of all but the last at most 1, so never too much
    signed[-1] = 2.0
    terms = {
        "short": -np.maximum(1.0 - signed, 0.0),
        "far": -(5.0 + points[:, 0]),
        "excess": -np.maximum(signed - 1.0, 0.0),
    }
    rollouts = generation(np.zeros((21, T, 1)), np.sum([*terms.values()], axis=0), terms=terms)
    along = hypotheses(np.diag([1.0, 0.0]), np.diag([0.0, 1.0]))
    before = Critic.fit(points[:20], rollouts[:20], along)
    assert {*before.chosen} == {"short", "far"}
    reused, fresh = (Critic.fit(points, rollouts, along, known) for known in (before.chosen, None))
    assert [*reused.chosen] == ["far", "excess - short"]
    for one, other in zip(reused.chosen.values(), fresh.chosen.values(), strict=True):
        assert one.views[0] is other.views[0]
    kept = Critic.fit(points[:19], rollouts[:19], along, before.chosen)
    assert kept.chosen["far"].views[0] is before.chosen["far"].views[0]


def test_the_critics_search_begins_with_the_greedy_trajectory_and_knows_its_coordinates() -> None:
    rng = np.random.default_rng(0)
    space = Subspace(np.ones((T, 1)), rng.standard_normal((3, T, 1)))
    search = CriticSearch(space, 0.7)
    tried = search.ask(5, rng)
    np.testing.assert_array_equal(tried[0], space.origin)
    search.tell(generation(tried, -np.arange(5.0)))
    np.testing.assert_allclose(space.trajectories(search.points), tried, atol=1e-6)
    again = search.ask(4, rng)
    assert again.shape == (4, T, 1)
    assert not np.array_equal(again[0], space.origin)


def test_a_search_in_which_nothing_succeeds_begins_anew() -> None:
    """A trust region that has shrunk around a failure opens again; around a success it does not."""
    space = Subspace(np.zeros((T, 1)), np.eye(T)[:3, :, None])

    def radii(succeeds: bool) -> list[float]:
        search, found = CriticSearch(space, 0.7), []
        for k in range(12):
            tried = np.full((1, T, 1), 0.1 * k)
            worse = np.array([-float(k)])  # never better than the first one
            search.tell(generation(tried, worse, successes=np.array([succeeds])))
            found.append(search.region.radius)
        return found

    failing, solved = radii(False), radii(True)
    least = ACNMPCritic().restart_radius
    assert min(failing) >= least
    assert failing.count(0.7) >= 3  # the first two, and those that began anew
    assert solved == sorted(solved, reverse=True)
    assert solved[-1] < least


def test_a_search_in_which_nothing_succeeds_starts_elsewhere_and_forgets() -> None:
    rng = np.random.default_rng(0)
    space = Subspace(np.zeros((T, 1)), np.eye(T)[:3, :, None])
    others = [np.full((T, 1), 2.0), np.full((T, 1), 3.0)]
    search, started = CriticSearch(space, 0.7, elsewhere=[*others]), []
    for k in range(16):
        tried = search.ask(1, rng)
        if len(search.points) == 0:
            started.append(tried[0])
        search.tell(generation(tried, np.array([-float(k)])))
    for start, expected in zip(started, [space.origin, *others], strict=True):
        np.testing.assert_array_equal(start, expected)
    assert search.rewards.max() < -7  # of the last start; the very first rollout earned the most
    assert len(search.rewards) == len(search.points)
    assert sum(len(part.rewards) for part in search.rollouts) == 16  # the network learns from all


def test_a_pinned_search_may_start_from_the_nearest_demonstrations(
    demonstrations: Demonstrations,
) -> None:
    context = demonstrations.contexts[1]
    model = build(demonstrations, Reach(float(context[0]))).learn(1)
    search = model.searches[0].search
    assert isinstance(search, CriticSearch)
    apart = np.abs(demonstrations.contexts - context)[:, 0]
    nearest = demonstrations.trajectories[np.argsort(apart)[:3]]
    np.testing.assert_allclose(search.elsewhere, nearest)
    assert model._shown_nearest(context, nearest[0].astype(np.float64))[0] == pytest.approx(
        nearest[1]
    )
    model._pinned = False  # where contexts are drawn, there is none
    assert model._shown_nearest(context, nearest[0].astype(np.float64)) == []


def test_the_trust_region_grows_with_success_and_shrinks_without() -> None:
    rng = np.random.default_rng(0)
    space = Subspace(np.zeros((T, 1)), rng.standard_normal((3, T, 1)))
    settings = ACNMPCritic(growth=2.0, shrinkage=0.5, radius_limits=(0.3, 1.0))
    search = CriticSearch(space, 0.8, settings)
    radii = []
    for rewards in ([-3.0, -2.0], [-1.0, -2.0], [-4.0, -4.0], [-4.0, -4.0], [0.0, -4.0]):
        search.tell(generation(search.ask(2, rng), np.array(rewards)))
        radii.append(search.region.radius)
    assert radii == [0.8, 1.0, 0.5, 0.3, 0.6]


def test_the_policys_search_stays_around_the_answer_that_it_follows() -> None:
    rng = np.random.default_rng(0)
    space = Subspace(np.ones((T, 1)), rng.standard_normal((3, T, 1)))
    search = PolicySearch(space, ACNMPExploration(retry_answer=True))
    for answer in (1.0, 5.0):
        search.follow(np.full((T, 1), answer))
        for _ in range(2):
            tried = search.ask(4, rng)
            search.tell(generation(tried, -np.arange(4.0)))
            np.testing.assert_array_equal(tried[0], np.full((T, 1), answer))
            coordinates = search.space.coordinates(tried[1:])
            np.testing.assert_allclose(search.space.trajectories(coordinates), tried[1:])
    assert len(search.rollouts) == 4


def test_the_critic_finds_the_optimum_with_fewer_rollouts_than_chance() -> None:
    def best(kind: Any, seed: int) -> float:
        rng = np.random.default_rng(seed)
        along = np.linalg.qr(rng.standard_normal((T, 6)))[0].T[..., None]
        goal = np.tensordot(rng.standard_normal(6), along, axes=1)
        search = kind(Subspace(np.zeros((T, 1)), along))
        for _ in range(8):
            tried = search.ask(5, rng)
            search.tell(generation(tried, -((tried - goal) ** 2).sum(axis=(1, 2))))
        return -max(part.rewards.max() for part in search.rollouts)

    with_critic = np.median([best(lambda space: CriticSearch(space, 0.7), s) for s in range(5)])
    around = partial(PolicySearch, settings=ACNMPExploration())
    without = np.median([best(around, seed) for seed in range(5)])
    assert with_critic < 0.2 * without


def test_the_pull_keeps_the_search_where_the_reward_tells_nothing() -> None:
    def wandered(pull: float, seed: int) -> list[float]:
        rng = np.random.default_rng(seed)
        along = np.linalg.qr(rng.standard_normal((T, 6)))[0].T[..., None]
        search = CriticSearch(Subspace(np.zeros((T, 1)), along), 0.7, ACNMPCritic(pull=pull))
        for _ in range(12):
            tried = search.ask(2, rng)
            error = np.abs(tried[..., 0] @ along[0, :, 0] - 1.0)
            search.tell(generation(tried, -error, terms={"a": -error / 2, "b": -error / 2}))
        best = search.points[search.rewards.argmax()]
        return [abs(best[0] - 1.0), float(np.linalg.norm(best[1:]))]

    pulled, free = (
        np.median([wandered(pull, seed) for seed in range(7)], axis=0) for pull in (1.0, 0.0)
    )
    assert max(pulled[0], free[0]) < 0.2
    assert pulled[1] < 0.5 * free[1]


# -- the policy gradient -------------------------------------------------------------------------


def test_advantages_follow_their_definitions() -> None:
    steps = np.array([[-1.0, -2.0, -3.0], [-1.0, 0.0, 0.0]])
    rollouts = generation(np.zeros((2, 3, 1)), steps.sum(axis=1), step_rewards=steps)
    to_go = advantages("to_go", rollouts)
    raw = np.array([[-6.0, -5.0, -3.0], [-1.0, 0.0, 0.0]])
    centred = raw - raw.mean(axis=0)
    np.testing.assert_allclose(to_go, centred / centred.std())
    step = advantages("step", rollouts)
    assert step[0, 0] == 0  # no difference at the first step
    assert step[1, 2] > step[1, 1] > 0
    np.testing.assert_allclose(advantages("place", rollouts).sum(axis=0), 1.0)
    failed = generation(np.zeros((2, 3, 1)), steps.sum(axis=1))
    assert (advantages("place", failed)[1] > advantages("place", failed)[0]).all()
    solved = replace(failed, successes=np.array([True, False]))  # though of less reward
    np.testing.assert_array_equal(advantages("place", solved), [[1.0] * 3, [0.0] * 3])
    without = generation(np.zeros((2, 3, 1)), steps.sum(axis=1))
    for kind in ("to_go", "step"):
        np.testing.assert_allclose(advantages(kind, without), [[-1] * 3, [1] * 3])


def test_the_loss_has_the_policy_gradient() -> None:
    rng = np.random.default_rng(0)
    mean = th.tensor(rng.standard_normal((T, 2)), requires_grad=True)
    tried, weights = th.tensor(rng.standard_normal((3, T, 2))), th.tensor(rng.random((3, T)))
    policy_gradient_loss(mean, tried, weights).backward()
    expected = (weights[..., None] * (mean - tried)).sum(dim=0) / T
    th.testing.assert_close(mean.grad, expected.detach())


# -- learning ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"search": "policy", "adaptation": ACNMPAdaptation.preset("to_go"), "population_size": 5},
        {"adaptation": ACNMPAdaptation(supervised=False)},
    ],
    ids=["critic", "policy gradient", "RL only"],
)
def test_it_adapts_to_a_context_outside_the_demonstrations(
    demonstrations: Demonstrations, settings: dict[str, Any]
) -> None:
    env = Reach(2.0)
    model = build(demonstrations, env, **settings).pretrain()
    context = np.array([2.0], np.float32)
    before = model.predict(context, deterministic=True)[0]
    model.learn(100)
    after = model.predict(context, deterministic=True)[0]
    assert abs(after[-1, 0] - 2.0) < abs(before[-1, 0] - 2.0)
    if not settings:
        assert abs(after[-1, 0] - 2.0) < 0.05
        learned = model.policy.generalise(th.as_tensor(context[None])).detach().numpy()[0]
        assert abs(learned[-1, 0] - 2.0) < abs(before[-1, 0] - 2.0)  # assimilated
        assert len(model.training_set()) == len(demonstrations) + 1


def test_a_stream_that_the_policy_solves_triggers_no_search(
    demonstrations: Demonstrations,
) -> None:
    shown = CNMPPretraining(1500)
    env = Reach(tolerance=0.2)
    model = build(demonstrations, env, pretraining=shown, population_size=4).pretrain()
    before = {key: value.clone() for key, value in model.policy.cnmp.state_dict().items()}
    model.learn(40)
    assert (model.num_timesteps, model.searches, len(model.replay_buffer)) == (40, [], 0)
    for key, value in model.policy.cnmp.state_dict().items():
        assert th.equal(value, before[key])


def test_a_stream_outside_the_demonstrations_teaches_the_policy(
    demonstrations: Demonstrations,
) -> None:
    env = Reach(low=1.2, high=2.2)
    model = build(
        demonstrations,
        env,
        adaptation=ACNMPAdaptation(n_assimilation_steps=200),
        reward_threshold=-0.02,  # a success may be off by 0.05, and nothing is learned from it
    ).pretrain()
    fresh = np.linspace(1.25, 2.15, 20, dtype=np.float32)[:, None]

    def error() -> float:
        ends = model.policy.generalise(th.as_tensor(fresh)).detach().numpy()[:, -1, 0]
        return float(np.abs(ends - fresh[:, 0]).mean())

    before = error()
    model.learn(300)
    assert len(model.replay_buffer) >= 1
    assert error() < 0.3 * before


def test_the_mean_of_the_best_successes_is_assimilated() -> None:
    """One success may graze what it must not touch; a search goes on until there are enough."""
    space = Subspace(np.zeros((T, 1)), np.eye(T)[:3, :, None])
    told = generation(
        np.arange(5.0)[:, None, None] * np.ones((T, 1)),
        np.array([-1.0, -5.0, -2.0, -3.0, 0.0]),
        successes=np.array([True, True, True, True, False]),
    )
    for n_kept, mean in ((1, 0.0), (3, 5 / 3), (5, 7 / 5)):
        search = ContextSearch(np.zeros(1, np.float32), CriticSearch(space, 0.7), n_kept)
        assert search.take(told)
        assert search.is_over(-np.inf, 10) == (n_kept < 5)  # four succeeded
        assert not search.take(told[1:2])  # a success, but no better one
        assert search.reward == -1.0
        assert search.solution is not None
        np.testing.assert_allclose(search.solution, np.full((T, 1), mean), rtol=1e-6)
        assert search.is_over(-np.inf, 10)
        assert not search.is_over(-0.5, 10)
        assert search.is_over(-0.5, 0)


def test_a_saved_model_names_its_demonstrations_and_refuses_others(
    demonstrations: Demonstrations, tmp_path: Path
) -> None:
    model = build(demonstrations, Reach(2.0)).learn(2)
    model.save(tmp_path / "model.zip")
    with zipfile.ZipFile(tmp_path / "model.zip") as archive:
        saved = json.loads(archive.read("sb3_nmp.json"))
    assert demonstrations.digest in json.dumps(saved)
    assert '"demonstrations"' not in json.dumps(saved)
    loaded = ACNMP.load(tmp_path / "model.zip", env=Reach(2.0))
    assert loaded.predict(np.array([0.1]), deterministic=True)[0].shape == (T, 1)
    assert loaded.learn(5).demonstrations == demonstrations
    with pytest.raises(InvalidDataError, match="are not those"):
        ACNMP.load(tmp_path / "model.zip", env=Reach(2.0), demonstrations=demonstrations[:3])


# -- bad input -----------------------------------------------------------------------------------


def test_thresholds_tell_where_a_search_begins_and_ends(demonstrations: Demonstrations) -> None:
    # Every rollout succeeds, so what is searched is due to the thresholds alone.
    env = Reach(low=1.2, high=2.2, tolerance=9.0)
    model = build(demonstrations, env, reward_threshold=(-0.03, -0.015)).learn(200)
    assert len(model.replay_buffer) > 0
    assert model.replay_buffer.rewards.min() >= -0.015
    assert model.n_given_up == 0


def test_bad_input_is_refused_before_training(demonstrations: Demonstrations) -> None:
    env = Reach(2.0)
    with pytest.raises(ConfigurationError, match="learns from demonstrations first"):
        ACNMP("MlpPolicy", env)
    with pytest.raises(ConfigurationError, match=r"is a ndarray; it must be Demonstrations"):
        ACNMP("MlpPolicy", env, demonstrations=np.zeros((3, T, 1)))  # pyright: ignore
    wrong_context = Demonstrations(np.zeros((2, 3)), np.zeros((2, T, 1)))
    with pytest.raises(InvalidDataError, match=r"contexts have 3 entries.*contexts of 1"):
        build(wrong_context, env)
    wrong_length = Demonstrations(np.zeros((2, 1)), np.zeros((2, T + 1, 1)))
    with pytest.raises(InvalidDataError, match=r"\(21, 1\).*\(20, 1\)"):
        build(wrong_length, env)
    with pytest.raises(
        ConfigurationError, match="search is 'best'; it must be 'critic' or 'policy'"
    ):
        build(demonstrations, env, search="best")
    with pytest.raises(ConfigurationError, match="max_generations is 0"):
        build(demonstrations, env, max_generations=0)
    with pytest.raises(ConfigurationError, match=r"begins below -0.1 must not end with less"):
        build(demonstrations, env, reward_threshold=(-0.1, -0.2))


def test_an_environment_that_ignores_the_context_option_is_told_so(
    demonstrations: Demonstrations,
) -> None:
    class Deaf(Reach):
        def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
            return super().reset(seed=seed)

    with pytest.raises(ConfigurationError, match="must take options"):
        build(demonstrations, Deaf(low=1.2, high=2.2)).learn(50)
