"""Several ways in one context: found by the hill-valley test, kept apart, returned by `modes`."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines import GA
from benchmark_envs import make_task
from benchmark_envs.tasks.bottles import BOTTLES
from sb3_nmp import RCNMP, ConfigurationError, RCNMPTraining
from sb3_nmp.common.buffer import TrajectoryBuffer
from sb3_nmp.common.niches import Niches, View, _shares, midway

ENV_ID = "nmp/Bottles-v0"
INITIAL = np.zeros((10, 1))


def rollouts(*heights: tuple[float, float, bool]) -> TrajectoryBuffer:
    """Flat trajectories at some height, with reward and success."""
    buffer = TrajectoryBuffer(1, (10, 1))
    for height, reward, success in heights:
        buffer.add(
            np.zeros((1, 1)), np.full((1, 10, 1), height), np.array([reward]), np.array([success])
        )
    return buffer


def test_the_first_way_is_that_of_the_best_success() -> None:
    niches = Niches(2)
    buffer = rollouts((0.0, -8.0, False), (1.0, -2.0, True), (1.2, -1.0, True))
    niches.take(buffer, INITIAL, 0, 1)
    assert (niches.best, niches.born) == ([2], [0])
    assert niches.labels(buffer, INITIAL).tolist() == [-1, 0, 0]
    assert niches.to_test(buffer, INITIAL, 1) is None, "no success lies elsewhere"


@pytest.mark.parametrize("valley", [True, False])
def test_a_valley_midway_tells_two_ways_apart(valley: bool) -> None:
    niches = Niches(2)
    buffer = rollouts((1.0, -1.0, True), (-0.6, -1.5, True))
    niches.take(buffer, INITIAL, 0, 1)
    midway = niches.to_test(buffer, INITIAL, 1)
    assert midway is not None
    np.testing.assert_allclose(midway, 0.2, atol=1e-6)
    buffer.add(
        np.zeros((1, 1)), midway[None], np.array([-9.0 if valley else -0.5]), np.array([not valley])
    )
    niches.take(buffer, INITIAL, 2, 2)
    if valley:
        assert (niches.best, niches.born) == ([0, 1], [0, 2])
        assert niches.labels(buffer, INITIAL).tolist() == [0, 1, -1]
    else:
        assert niches.best == [2], "what lies midway is of the way, and better"
        assert set(niches.labels(buffer, INITIAL)) == {0}
        assert niches.to_test(buffer, INITIAL, 2) is None, "no success is tested twice"


def test_ways_are_tested_again_and_become_one_where_the_valley_is_gone() -> None:
    niches = Niches(3)
    heights = [(0.3, -1.0, True), (-1.0, -1.5, True), (1.0, -0.7, True)]
    buffer = rollouts(*heights)
    niches.best, niches.born = [0, 1, 2], [0, 2, 4]
    due = [niches.to_test(buffer, INITIAL, generation) for generation in range(4, 14)]
    # the third way beside the first is due 1, 2, 4 and 8 generations after it was found; the second
    # beside the third after 4 and 8 (4 is later than the third's first, which goes first)
    heights_due = [None if each is None else round(float(each[0, 0]), 3) for each in due]
    assert heights_due == [-0.35, 0.65, 0.65, None, 0.65, None, -0.35, None, 0.65, None]
    midway = niches.to_test(buffer, INITIAL, 5)
    assert midway is not None and niches.doubtful == (0, 2)
    buffer.add(np.zeros((1, 1)), midway[None], np.array([-0.9]), np.array([True]))
    niches.take(buffer, INITIAL, 3, 6)
    assert (niches.best, niches.born) == ([2, 1], [0, 2]), "the better best, the older birth"
    assert niches.doubtful is None
    assert niches.labels(buffer, INITIAL).tolist() == [0, 1, 0, 0]
    assert niches.views(buffer, INITIAL, 20, 6)[-1].fresh == 0.5, "one is missing again"


def test_ways_stay_apart_while_the_valley_is_there() -> None:
    niches = Niches(2)
    buffer = rollouts((1.0, -1.0, True), (-1.0, -1.5, True))
    niches.best, niches.born = [0, 1], [0, 2]
    midway = niches.to_test(buffer, INITIAL, 3)
    assert midway is not None and not midway.any()
    buffer.add(np.zeros((1, 1)), midway[None], np.array([-9.0]), np.array([False]))
    niches.take(buffer, INITIAL, 2, 4)
    assert (niches.best, niches.born, niches.doubtful) == ([0, 1], [0, 2], None)


def around_a_corner(pace: float) -> NDArray[np.float64]:
    """The way along two sides of a square, begun slowly if the pace is above 1, shape (60, 2)."""
    passed = 2.0 * np.linspace(0.0, 1.0, 60) ** pace
    return np.stack([np.minimum(passed, 1.0), np.maximum(passed - 1.0, 0.0)], axis=-1)


def test_midway_between_two_paces_of_a_path_is_the_path() -> None:
    slow, quick = around_a_corner(2.0), around_a_corner(0.5)
    between = midway(slow, quick)
    off = np.minimum(np.abs(between[:, 1]), np.abs(between[:, 0] - 1.0))
    assert off.max() < 0.02
    plain = 0.5 * (slow + quick)
    assert np.minimum(plain[:, 1], 1.0 - plain[:, 0]).max() > 0.2, "it cuts the corner"
    np.testing.assert_array_equal(between[[0, -1]], slow[[0, -1]])
    passed = between.sum(axis=-1)
    assert (np.diff(passed) >= 0).all()
    assert (quick.sum(axis=-1)[20] > passed[20]) and (passed[20] > slow.sum(axis=-1)[20])
    np.testing.assert_allclose(midway(quick, slow), between, atol=1e-12)
    np.testing.assert_array_equal(midway(slow[:1], quick[:1]), slow[:1])


def test_what_is_tested_is_midway_in_time_too() -> None:
    initial, paths = np.zeros((60, 2)), np.stack([around_a_corner(2.0), around_a_corner(0.5)])
    buffer = TrajectoryBuffer(1, (60, 2))
    mirrored = paths * np.array([1.0, -1.0])
    buffer.add(np.zeros((2, 1)), mirrored, np.array([-1.0, -2.0]), np.ones(2, bool))
    niches = Niches(2, best=[0, 1], born=[0, 1])
    again = niches.to_test(buffer, initial, 2)
    assert again is not None and niches.doubtful == (0, 1)
    np.testing.assert_allclose(again, midway(*mirrored), atol=1e-6)
    niches = Niches(2, best=[0], born=[0])
    far = 0.1 * mirrored[1]
    buffer = TrajectoryBuffer(1, (60, 2))
    buffer.add(
        np.zeros((2, 1)), np.stack([mirrored[0], far]), np.array([-1.0, -2.0]), np.ones(2, bool)
    )
    first = niches.to_test(buffer, initial, 1)
    assert first is not None and niches.pending == 1
    np.testing.assert_allclose(first, midway(mirrored[0], far), atol=1e-6)


def test_midway_pairs_points_as_a_library_does() -> None:
    library: Any = pytest.importorskip(
        "dtaidistance.dtw_ndim", reason="the extra 'contrib' is not installed"
    )
    rng = np.random.default_rng(0)
    one, other = np.cumsum(rng.normal(size=(2, 80, 3)), axis=1)
    best = library.warping_path(one, other, inner_dist="euclidean")
    at, there = np.array(best).T
    expected = np.stack(
        [np.interp(np.arange(80), 0.5 * (at + there), x) for x in 0.5 * (one[at] + other[there]).T],
        axis=-1,
    )
    np.testing.assert_allclose(midway(one, other), expected, atol=1e-12)


def test_members_are_shared_out_and_each_sees_its_own_way() -> None:
    niches = Niches(3)
    heights = [(1.0, -1.0, True), (-1.0, -1.5, True), (0.1, -3.0, False), (0.0, -9.0, False)]
    buffer = rollouts(*heights)
    niches.best, niches.born = [0, 1], [0, 4]
    views = niches.views(buffer, INITIAL, 20, 6)
    assert [(view.n, view.age, view.fresh) for view in views] == [
        (5, 6, 0.0),
        (5, 2, 0.0),
        (10, 0, 0.5),
    ]
    assert [int(view.rewards.argmax()) for view in views] == [0, 1, 2]
    assert [view.successes.tolist() for view in views[:2]] == [
        [True, False, False, False],
        [False, True, False, False],
    ]
    assert not views[2].successes.any()
    niches.n_modes = 2
    assert [view.n for view in niches.views(buffer, INITIAL, 19, 6)] == [10, 9]


def test_a_way_has_the_more_members_the_fewer_rollouts_it_has_had() -> None:
    niches = Niches(2)
    buffer = rollouts((-1.0, -1.5, True), *[(1.0 + i / 100, -1.0, True) for i in range(8)])
    niches.best, niches.born = [1, 0], [0, 4]
    seen = {view.way: view.n for view in niches.views(buffer, INITIAL, 18, 6)}
    assert seen == {0: 2, 1: 16}, "1 to 8"
    assert [view.way for view in niches.views(buffer, INITIAL, 4, 6)] == [1], "none is left"
    assert [sum(_shares(n, [3, 40, 7])) for n in range(30)] == list(range(30))
    assert _shares(10, [0, 5]) == [8, 2], "a way whose rollouts are others' now counts as one"


def passes_at_larger_x(trajectories: NDArray[np.floating]) -> NDArray[np.bool_]:
    at = np.abs(trajectories[..., 1] - BOTTLES[1]).argmin(axis=-1)
    return np.take_along_axis(trajectories[..., 0], at[..., None], -1)[..., 0] > 0.5


def test_one_run_finds_both_ways_through_the_bottles(tmp_path: Path) -> None:
    model = GA("MlpPolicy", ENV_ID, seed=1000, n_modes=2, n_candidates=10, n_explorers=1).learn(260)
    context = BOTTLES.astype(np.float32)[None]
    trajectories, rewards = model.policy.modes(context)
    assert trajectories.shape == (1, 2, 200, 2) and rewards.shape == (1, 2)
    assert set(passes_at_larger_x(trajectories[0])) == {True, False}
    rollouts = make_task(ENV_ID).simulate(BOTTLES, trajectories[0])
    assert rollouts.successes.all()
    np.testing.assert_allclose(rollouts.rewards, rewards[0], atol=1e-3)
    answer, _ = model.predict(context, deterministic=True)
    np.testing.assert_allclose(answer[0], trajectories[0, rewards[0].argmax()], atol=1e-6)
    model.save(tmp_path / "model.zip")
    again, _ = GA.load(tmp_path / "model.zip").policy.modes(context)
    np.testing.assert_array_equal(again, trajectories)


def test_the_networks_search_takes_turns_too() -> None:
    settings: dict[str, Any] = {"training": RCNMPTraining(5), "n_candidates": 3}
    make: Any = RCNMP
    model = make("MlpPolicy", ENV_ID, seed=0, n_modes=2, **settings).learn(60)
    shares = model._shares()
    assert shares.shape == (60,) and shares.sum() == pytest.approx(1.0)


def test_parents_from_the_network_are_of_the_way_that_is_bettered() -> None:
    make: Any = RCNMP
    model = make("MlpPolicy", ENV_ID, seed=0, n_modes=2, training=RCNMPTraining(5)).learn(20)
    line = model.initial.mean(axis=0)
    bent = line + np.array([0.1, 0.0])
    model.replay_buffer.trajectories[:2] = np.stack([bent, 2 * line - bent])
    model._niches.best, model._niches.born = [0, 1], [0, 0]

    def bend(codes: NDArray[np.float32]) -> NDArray[np.float64]:
        """To the side that the first latent says; none at all where it is large."""
        side = np.where(np.abs(codes[:, 0]) < 6, np.sign(codes[:, 0]), 0.0)
        return line + side[:, None, None] * (bent - line)

    model._decode = bend
    successes = model.replay_buffer.successes
    views = model._niches.views(model.replay_buffer, line, 20, 3)
    assert [view.way for view in views] == [0, 1]
    for view, sign in zip(views, (1.0, -1.0), strict=True):
        latents, are_of_use = model._draw_latents(50, view)
        assert are_of_use
        assert (np.sign(latents[..., 0]) == sign).all()
        assert len(np.unique(latents[..., 0])) > 20, "they are drawn, not one of them repeated"
    model._decode = lambda codes: np.repeat(bent[None], len(codes), axis=0)
    assert not model._draw_latents(5, views[1])[1]
    assert (model._draw_parents(20, 16, views[1]).rows >= 0).all(), "stored rollouts are left"
    both = View(model.replay_buffer.rewards, successes, 20, 3)
    assert set(np.sign(model._draw_latents(50, both)[0][..., 0].ravel())) == {1.0, -1.0}


@pytest.mark.parametrize("settings", [{"n_modes": 11}, {"n_modes": 0}, {"buffer_size": 100}])
def test_a_wrong_number_of_modes_is_refused(settings: dict[str, Any]) -> None:
    make: Any = RCNMP
    with pytest.raises(ConfigurationError, match=r"n_modes is .* at most half the population"):
        make("MlpPolicy", ENV_ID, **{"n_modes": 2, **settings})


def test_modes_are_asked_for_too_early() -> None:
    with pytest.raises(ConfigurationError, match="train with n_modes above 1"):
        RCNMP("MlpPolicy", ENV_ID).policy.modes(BOTTLES[None])
