"""Via-points of ACNMP: met, in the demonstrated shape, or refused, or missed with a warning."""

import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th

from sb3_nmp import (
    ACNMP,
    CNMPArchitecture,
    CNMPPretraining,
    Demonstrations,
    InvalidDataError,
    ViaPointWarning,
)
from sb3_nmp.models.via_points import Prior, checked, principal_deviations
from tests.test_acnmp import Reach

T, D = 40, 2
TIMES = np.linspace(0.0, 1.0, T)
SMALL = CNMPArchitecture(
    representation_dim=4, encoder_arch=(16,), decoder_arch=(32,), n_frequencies=2
)
SHOWN = np.linspace(-1, 1, 9)[:, None]


def expert(contexts: np.ndarray) -> np.ndarray:
    """Two dimensions of one bent shape each, from 0 to the context: shape (N, T, 2)."""
    c = np.asarray(contexts).reshape(-1, 1)
    way = 0.5 * np.sin(2 * np.pi * TIMES) + c * TIMES**2
    return np.stack([way, c * np.sin(np.pi * TIMES)], axis=-1)


class Bounded(Reach):
    """The toy with other bounds on its trajectories."""

    def __init__(self, low: float | np.ndarray = -9.0, high: float | np.ndarray = 9.0) -> None:
        super().__init__()
        least, most = (np.broadcast_to(end, (T, D)).astype(np.float32) for end in (low, high))
        self.action_space = gym.spaces.Box(least, most)


def build(low: float | np.ndarray = -9.0, high: float | np.ndarray = 9.0, **more: Any) -> ACNMP:
    settings = {"pretraining": CNMPPretraining(300), "policy_kwargs": {"cnmp": SMALL}, **more}
    shown = Demonstrations(SHOWN, expert(SHOWN))
    env = Bounded(low, high)
    return ACNMP("MlpPolicy", env, demonstrations=shown, seed=0, **settings).pretrain()


@pytest.fixture(scope="module")
def model() -> ACNMP:
    return build()


def at(trajectories: np.ndarray, times: list[float]) -> np.ndarray:
    """Interpolate trajectories (N, T, D) at times: shape (N, O, D)."""
    return np.array(
        [[np.interp(times, TIMES, way[:, d]) for d in range(D)] for way in trajectories]
    ).swapaxes(1, 2)


def distance_from_shapes(trajectory: np.ndarray) -> float:
    """Return the root mean square distance from the span of the demonstrations."""
    shown = expert(SHOWN)
    flat = (shown - shown.mean(axis=0)).reshape(len(shown), -1)
    _, lengths, axes = np.linalg.svd(flat, full_matrices=False)
    axes = axes[lengths > 1e-6 * lengths[0]]
    deviation = (trajectory - shown.mean(axis=0)).ravel()
    return float(np.sqrt(np.mean((deviation - axes.T @ (axes @ deviation)) ** 2)))


POINTS = [
    ([0.5], [[0.3, -0.4]]),
    ([0.313, 0.777], [[0.6, 0.2], [-0.2, 0.1]]),
    ([0.2, 0.55, 1.0], [[0.5, 0.3], [0.1, -0.5], [0.7, 0.0]]),
    ([0.0], [[0.2, 0.2]]),
]


@pytest.mark.parametrize("points", POINTS)
@pytest.mark.parametrize("deterministic", [True, False])
def test_points_inside_are_met_in_every_context(
    model: ACNMP, points: tuple[list[float], list[list[float]]], deterministic: bool
) -> None:
    contexts = np.array([[-0.8], [0.1], [0.9]], np.float32)
    found, _ = model.predict(contexts, deterministic=deterministic, via_points=points)
    assert np.abs(at(found, points[0]) - points[1]).max() < 0.002
    single, _ = model.predict(contexts[0], deterministic=True, via_points=points)
    assert single.shape == (T, D)
    np.testing.assert_allclose(at(single[None], points[0])[0], points[1], atol=0.002)


def test_points_far_outside_are_met_as_far_as_the_action_space_goes(model: ACNMP) -> None:
    points = ([0.3, 0.8], [[8.9, -8.9], [-8.9, 8.9]])
    found, _ = model.predict(np.zeros((1, 1)), deterministic=True, via_points=points)
    assert np.abs(at(found, points[0]) - points[1]).max() < 0.02
    assert np.abs(found).max() <= 9.0


def test_the_rest_keeps_the_demonstrated_shape(model: ACNMP) -> None:
    """Moved half as far again as any demonstration goes, the answer is still one of their kind."""
    free, _ = model.predict(np.zeros(1), deterministic=True)
    moment = TIMES[30]
    wanted = expert(np.array([[1.5]]))[:, 30]
    found, _ = model.predict(np.zeros(1), deterministic=True, via_points=([moment], wanted))
    assert distance_from_shapes(found) < distance_from_shapes(free) + 0.03
    assert np.abs(found - expert(np.array([[1.5]]))[0]).max() < 0.2
    assert np.abs(found[0]).max() < 0.1


def test_a_point_pair_in_quick_succession_does_not_throw_the_rest_far_off(model: ACNMP) -> None:
    points = ([TIMES[20], TIMES[21]], [[0.0, 0.3], [0.5, -0.3]])
    found, _ = model.predict(np.zeros(1), deterministic=True, via_points=points)
    free, _ = model.predict(np.zeros(1), deterministic=True)
    assert np.abs(at(found[None], points[0])[0] - points[1]).max() < 0.01
    assert np.abs(found - free).max() < 1.0


def test_samples_through_points_differ_elsewhere(model: ACNMP) -> None:
    points = POINTS[0]
    samples = [model.predict(np.zeros(1), via_points=points)[0] for _ in range(2)]
    assert np.abs(samples[0] - samples[1]).max() > 1e-3


def test_a_saved_model_passes_them_too(model: ACNMP, tmp_path: Path) -> None:
    model.save(tmp_path / "model")
    loaded = ACNMP.load(tmp_path / "model")
    before, after = (
        each.predict(np.zeros(1), deterministic=True, via_points=POINTS[1])[0]
        for each in (model, loaded)
    )
    np.testing.assert_array_equal(before, after)
    assert model.policy.cnmp.deviations.abs().max() > 0.1


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (
            ([0.5, 0.5], [[0.0, 0.0], [0.5, 0.0]]),
            r"via-points 0 and 1, at times 0.5 and 0.5.*agree",
        ),
        (([0.5, 0.2, 0.51], [[0.0, 0.0], [0.0, 0.0], [0.0, 0.5]]), "via-points 0 and 2.*leave one"),
        (
            ([0.5], [[0.0, 9.5]]),
            r"via-point 0 at time 0.5 has the value 9.5 in dimension 1.*-9 to 9",
        ),
        ("abc", "via_points is 'abc'; it must be a pair of arrays of numbers"),
        (3, "via_points is 3; it must be a pair"),
        ((["a"], [[0.0, 0.0]]), "must be a pair of arrays of numbers"),
    ],
)
def test_what_contradicts_or_is_not_allowed_is_refused(
    model: ACNMP, points: Any, message: str
) -> None:
    with pytest.raises(InvalidDataError, match=message):
        model.predict(np.zeros(1), deterministic=True, via_points=points)


def test_the_same_point_twice_is_one_point(model: ACNMP) -> None:
    once, _ = model.predict(np.zeros(1), deterministic=True, via_points=([0.5], [[0.2, 0.2]]))
    points = ([0.5, 0.5], [[0.2, 0.2], [0.2, 0.2]])
    twice, _ = model.predict(np.zeros(1), deterministic=True, via_points=points)
    np.testing.assert_allclose(once, twice, atol=1e-4)


def test_what_the_action_space_forbids_is_told_with_its_size() -> None:
    """Between two steps whose bounds differ, a point may be allowed beside one of them alone."""
    high = np.full((T, D), 9.0)
    high[20] = 1.0
    bounded, moment = build(high=high), float(TIMES[20] + 0.25 / (T - 1))
    with pytest.warns(ViaPointWarning, match=r"point 0 is missed by .* dimension 0, \d+% of the"):
        found, _ = bounded.predict(np.zeros(1), via_points=([moment], [[8.0, 0.0]]))
    assert found[20, 0] == 1.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bounded.predict(np.zeros(1), via_points=([moment], [[0.9, 0.0]]))


def test_conditioning_follows_gaussian_algebra() -> None:
    """The mean minimises the distance in the prior's metric; the deviation left is that of e."""
    rng = np.random.default_rng(0)
    shown = rng.normal(size=(4, 12, 2)).cumsum(axis=1)
    shapes = th.as_tensor(principal_deviations(shown))
    flat = (shown - shown.mean(axis=0)).reshape(4, -1)
    covariance = shapes.flatten(1).T @ shapes.flatten(1)
    np.testing.assert_allclose(covariance.numpy(), flat.T @ flat / 4, atol=1e-12)
    prior = Prior(shapes, th.tensor([1.0, 2.0]))
    points = checked(([0.25, 0.9], [[1.0, 0.0], [0.0, 3.0]]), 12, th.ones(2))
    given = prior.given(points)
    everywhere = prior.covariance(th.eye(12).double(), th.eye(12).double())
    at_points = np.kron(given.at.numpy(), np.eye(2))
    precise = np.linalg.inv(everywhere.numpy() + 1e-12 * np.eye(24))
    precise += at_points.T @ np.diag(np.tile([1e8, 0.25e8], 2)) @ at_points
    left = np.sqrt(np.diag(np.linalg.inv(precise)) / np.diag(everywhere.numpy()))
    np.testing.assert_allclose(given.remaining.numpy().ravel(), left, atol=2e-3)
    moved = given.moved(th.zeros(12, 2, dtype=th.float64))
    wanted = np.linalg.solve(precise, at_points.T @ (np.tile([1e8, 0.25e8], 2) * [1, 0, 0, 3]))
    np.testing.assert_allclose(moved.numpy().ravel(), wanted, atol=1e-3)
