"""Movement primitives: linearity, fits, distributions, and other implementations as oracles."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from baselines import DMP, PDFiltered, Primitive, ProMP, WeightDistribution
from sb3_nmp.common.exceptions import ConfigurationError, InvalidDataError
from sb3_nmp.common.pd_controller import PDController

PRIMITIVES: list[Primitive] = [
    ProMP(8, 60),
    ProMP(2, 20),
    DMP(8, 60),
    DMP(2, 20),
    PDFiltered(ProMP(8, 60), PDController()),
]
START, GOAL = np.array([0.5, -0.4, 1.0]), np.array([0.5, 0.4, 2.0])


def weights_of(primitive: Primitive, n: int, scale: float = 1.0) -> np.ndarray:
    return np.random.default_rng(0).normal(0, scale, (n, primitive.n_bases, 3))


@pytest.mark.parametrize("primitive", PRIMITIVES, ids=repr)
class TestEveryPrimitive:
    def test_trajectories_have_the_shape_n_t_d(self, primitive: Primitive) -> None:
        shape = primitive.trajectories(weights_of(primitive, 5), START, GOAL).shape
        assert shape == (5, primitive.n_time_points, 3)

    def test_trajectories_are_affine_in_the_weights(self, primitive: Primitive) -> None:
        a, b = weights_of(primitive, 2)[:, None]
        mixed = primitive.trajectories(0.3 * a + 0.7 * b, START, GOAL)
        parts = [primitive.trajectories(w, START, GOAL) for w in (a, b)]
        assert_allclose(mixed, 0.3 * parts[0] + 0.7 * parts[1], atol=1e-10)

    def test_a_rollout_does_not_depend_on_its_batch(self, primitive: Primitive) -> None:
        weights = weights_of(primitive, 7)
        batch = primitive.trajectories(weights, START, GOAL)
        for i in range(7):
            alone = primitive.trajectories(weights[i : i + 1], START, GOAL)[0]
            assert_allclose(batch[i], alone, rtol=1e-12, atol=1e-12)

    def test_no_weights_are_nearer_to_a_trajectory_than_its_fit(self, primitive: Primitive) -> None:
        y = np.cumsum(np.random.default_rng(2).normal(0, 0.1, (primitive.n_time_points, 3)), axis=0)
        error = y - primitive.trajectories(primitive.fit(y)[None], y[0], y[-1])[0]
        bases = primitive.response().weights
        scale = np.linalg.norm(bases, axis=0)[:, None] * np.linalg.norm(y)
        assert np.abs(bases.T @ error / scale).max() < 1e-5  # the normal equations

    def test_start_and_goal_may_differ_between_rollouts(self, primitive: Primitive) -> None:
        weights = weights_of(primitive, 2)
        starts, goals = np.stack([START, START + 1])[:, None], np.stack([GOAL, GOAL - 1])[:, None]
        batch = primitive.trajectories(weights, starts, goals)
        second = primitive.trajectories(weights[1:], START + 1, GOAL - 1)[0]
        assert_allclose(batch[1], second, atol=1e-12)

    def test_weight_std_gives_the_asked_scale_of_exploration(self, primitive: Primitive) -> None:
        sigma = np.array([0.1, 0.2, 0.4])
        noise = np.random.default_rng(1).standard_normal((4000, primitive.n_bases, 3))
        drawn = primitive.trajectories(noise * primitive.weight_std(sigma), START, GOAL)
        assert_allclose(np.sqrt(drawn.var(axis=0).mean(axis=0)), sigma, rtol=0.05)

    def test_wrong_shapes_are_refused(self, primitive: Primitive) -> None:
        with pytest.raises(InvalidDataError, match="weights have shape"):
            primitive.trajectories(np.zeros((1, primitive.n_bases + 1, 3)), START, GOAL)
        with pytest.raises(InvalidDataError, match="time points"):
            primitive.fit(np.zeros((primitive.n_time_points + 1, 3)))


class TestProMP:
    def test_bases_add_up_to_one(self) -> None:
        assert_allclose(ProMP(9).bases(np.linspace(0, 1, 33)).sum(axis=1), 1.0)

    def test_bases_are_finite_far_from_every_centre(self) -> None:
        assert np.isfinite(ProMP(5, width=0.01).bases(np.linspace(0, 1, 33))).all()

    def test_fit_finds_the_weights_of_its_own_trajectory(self) -> None:
        promp = ProMP(8, 60)
        weights = weights_of(promp, 1)
        y = promp.trajectories(weights, START, GOAL)[0]
        assert_allclose(promp.fit(y), weights[0], atol=1e-4)

    def test_distribution_recovers_a_gaussian_over_weights(self) -> None:
        promp, rng = ProMP(5, 50), np.random.default_rng(0)
        true = WeightDistribution(rng.normal(size=(5, 2)), np.diag(rng.uniform(0.1, 1, 10)))
        found = promp.distribution(promp.trajectories(true.sample(rng, 3000), [0, 0], [0, 0]))
        assert_allclose(found.mean, true.mean, atol=0.1)
        assert_allclose(found.covariance, true.covariance, atol=0.1)

    def test_conditioning_meets_the_via_points_and_reduces_the_variance(self) -> None:
        promp = ProMP(7, 40)
        prior = WeightDistribution(np.zeros((7, 2)), np.eye(14))
        times, points = [0.0, 0.5, 1.0], np.array([[0.5, 1.0], [-1.0, 0.3], [0.0, 2.0]])
        posterior = promp.condition(prior, times, points, std=1e-4)
        assert_allclose(promp.bases(times) @ posterior.mean, points, atol=1e-3)
        drawn = promp.bases(times) @ posterior.sample(np.random.default_rng(0), 50)
        assert_allclose(drawn, np.broadcast_to(points, drawn.shape), atol=2e-3)
        assert np.linalg.eigvalsh(prior.covariance - posterior.covariance).min() > -1e-9

    def test_conditioning_refuses_points_of_the_wrong_dimension(self) -> None:
        prior = WeightDistribution(np.zeros((7, 2)), np.eye(14))
        with pytest.raises(InvalidDataError, match=r"\(O, D\)"):
            ProMP(7).condition(prior, [0.5], [[1.0, 2.0, 3.0]])

    def test_equals_another_implementation(self) -> None:
        oracle = pytest.importorskip("movement_primitives.promp")
        k, d, n = 7, 2, 40
        # Its bases overlap by 0.7: their standard deviation is 1 / (K sqrt(-8 log 0.7)).
        promp = ProMP(k, n, width=(k - 1) / (k * np.sqrt(-8 * np.log(0.7))))
        other: Any = oracle.ProMP(d, k)
        times, weights = np.linspace(0, 1, n), np.random.default_rng(0).normal(size=(k, d))
        expected = other.trajectory_from_weights(times, weights.T.ravel())
        assert_allclose(promp.trajectories(weights[None], [0, 0], [0, 0])[0], expected, atol=1e-10)
        assert_allclose(promp.fit(expected).T.ravel(), other.weights(times, expected), atol=1e-4)

        covariance = np.diag(np.random.default_rng(1).uniform(0.5, 2, k * d))
        permuted = covariance.reshape(k, d, k, d).transpose(1, 0, 3, 2).reshape(k * d, k * d)
        other.from_weight_distribution(weights.T.ravel(), permuted)
        point = np.array([0.3, -0.7])
        conditioned = other.condition_position(point, 1e-4 * np.eye(d), t=0.4)
        mine = promp.condition(
            WeightDistribution(weights, covariance), [0.4], point[None], std=0.01
        )
        assert_allclose(mine.mean.T.ravel(), conditioned.weight_mean, atol=1e-8)
        variances = np.diag(mine.covariance).reshape(k, d).T.ravel()
        assert_allclose(variances, np.diag(conditioned.weight_cov), atol=1e-8)


class TestDMP:
    def test_starts_at_rest_and_ends_at_the_goal(self) -> None:
        dmp = DMP(8, 500)
        y = dmp.trajectories(weights_of(dmp, 4, 30.0), START, GOAL)
        assert_allclose(y[:, 0], np.broadcast_to(START, (4, 3)))
        assert np.abs(y[:, 1] - y[:, 0]).max() < 1e-3
        assert np.abs(y[:, -1] - GOAL).max() < 0.02

    def test_without_weights_it_is_the_critically_damped_spring(self) -> None:
        dmp = DMP(5, 200)
        t = np.linspace(0, 1, 200)[:, None]
        expected = GOAL + (START - GOAL) * (1 + 12.5 * t) * np.exp(-12.5 * t)
        assert_allclose(dmp.trajectories(np.zeros((1, 5, 3)), START, GOAL)[0], expected, atol=1e-5)

    def test_equals_another_implementation(self) -> None:
        pytest.importorskip("pytransform3d")
        oracle = pytest.importorskip("movement_primitives.dmp")
        n, k = 1001, 6
        other: Any = oracle.DMP(3, execution_time=1.0, dt=1 / (n - 1), n_weights_per_dim=k)
        weights = np.random.default_rng(0).normal(0, 50, (k, 3))
        other.forcing_term.weights_[:] = weights.T
        other.configure(start_y=START, goal_y=GOAL)
        expected = other.open_loop()[1]
        mine = DMP(k, n).trajectories(weights[None], START, GOAL)[0]
        # It evaluates the force one step of 0.001 late.
        assert_allclose(mine, expected[:n], atol=1e-2 * np.ptp(expected))
        assert np.ptp(expected) > 0.5


def test_the_pd_filter_starts_and_ends_as_told() -> None:
    primitive = PDFiltered(ProMP(10, 200), PDController())
    y = primitive.trajectories(weights_of(primitive, 4), START, GOAL)
    direct = PDController()(
        ProMP(10, 200).trajectories(weights_of(primitive, 4), 0, 0), START, GOAL
    )
    assert_allclose(y, direct, atol=1e-10)
    assert_allclose(y[:, 0], np.broadcast_to(START, (4, 3)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ProMP(1), "n_bases is 1"),
        (lambda: ProMP(5, 1), "n_time_points is 1"),
        (lambda: ProMP(5, 20, 0.0), r"width is 0\.0"),
        (lambda: DMP(1), "n_bases is 1"),
        (lambda: DMP(alpha=0), "alpha is 0"),
        (lambda: DMP(overlap=1.0), r"overlap is 1\.0"),
        (lambda: ProMP("8"), "n_bases is '8'; it must be a whole number"),  # type: ignore[arg-type]
        (lambda: ProMP(5, 20.5), r"n_time_points is 20\.5; it must be a whole"),  # type: ignore[arg-type]
        (lambda: ProMP(5, 20, "wide"), r"width is 'wide'; .*number"),  # type: ignore[arg-type]
        (lambda: ProMP(5, 20, np.inf), r"width is inf; .*\(0, inf\)"),
        (lambda: DMP(alpha="stiff"), "alpha is 'stiff'; .*number"),  # type: ignore[arg-type]
    ],
)
def test_bad_settings_are_refused_with_their_value(make: Any, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        make()


def test_a_weight_distribution_refuses_a_covariance_that_does_not_fit() -> None:
    with pytest.raises(InvalidDataError, match=r"need \(4, 4\)"):
        WeightDistribution(np.zeros((2, 2)), np.eye(3))
