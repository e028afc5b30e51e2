"""Noise, PD controller, buffer, elites and ranks: properties that the algorithms rely on."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch as th
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from baselines.ga.ga import crossover_pairs
from sb3_nmp.common.buffer import TrajectoryBuffer, scale_rewards, selection_weights
from sb3_nmp.common.elites import EliteMemory
from sb3_nmp.common.exceptions import ConfigurationError, FileFormatError, InvalidDataError
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.operators import blend
from sb3_nmp.common.pd_controller import PDController
from sb3_nmp.models.neural_process import NeuralProcess

REWARDS = arrays(np.int64, st.integers(1, 60), elements=st.integers(-999, 999)).map(
    lambda rewards: rewards / 8
)


# -- noise -----------------------------------------------------------------------------------------


def test_noise_has_the_given_standard_deviation_at_every_time_and_dimension() -> None:
    noise = SmoothNoise((0.15, 0.03)).sample(np.random.default_rng(0), 20_000, (50, 2))
    np.testing.assert_allclose(noise.std(axis=0), np.tile([0.15, 0.03], (50, 1)), rtol=0.04)
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=0.01)


def test_fewer_bases_give_smoother_noise() -> None:
    def roughness(n_bases: int) -> float:
        noise = SmoothNoise(1.0, n_bases).sample(np.random.default_rng(0), 200, (200, 1))
        return float(np.abs(np.diff(noise, axis=1)).mean())

    assert roughness(5) < roughness(10) < roughness(20)


@pytest.mark.parametrize(
    ("arguments", "rule"),
    [
        ({"sigma": -0.1}, "finite and >= 0"),
        ({"sigma": math.nan}, "finite and >= 0"),
        ({"sigma": 0.1, "n_bases": 1}, "at least 2"),
        ({"sigma": 0.1, "width": 0.0}, "> 0"),
    ],
)
def test_noise_settings_outside_their_range_are_refused(arguments: dict, rule: str) -> None:
    with pytest.raises(ConfigurationError, match=rule):
        SmoothNoise(**arguments)


# -- PD controller (Eq. 6.3) -----------------------------------------------------------------------


def simulate_pd(
    pd: PDController, desired: np.ndarray, start: np.ndarray, goal: np.ndarray
) -> np.ndarray:
    """Eq. 6.3, one time point after the other."""
    n = len(desired)
    step, x, previous = pd.duration / (n - 1), start.copy(), None
    path = [x.copy()]
    for k in range(n - 1):
        t = k / (n - 1)
        error = 3 * t**20 * (goal - x) + (1 - t**20) * (desired[k] - x)
        change = 0 if previous is None else error - previous
        x, previous = x + step * (pd.kp * error - pd.kd * change), error
        path.append(x.copy())
    return np.array(path)


def test_the_matrix_form_equals_the_controller_run_in_time() -> None:
    rng = np.random.default_rng(0)
    desired = rng.normal(size=(3, 40, 2)).cumsum(axis=1)
    start, goal = rng.normal(size=2), rng.normal(size=2)
    for pd in (PDController(), PDController(5.0, 0.3, 4.0)):
        expected = [simulate_pd(pd, tau, start, goal) for tau in desired]
        np.testing.assert_allclose(pd(desired, start, goal), expected, atol=1e-12)


def test_the_controller_starts_at_the_start_and_ends_near_the_goal() -> None:
    desired = np.zeros((1, 200, 2))
    path = PDController()(desired, np.array([1.0, 0.0]), np.array([0.3, -0.3]))[0]
    np.testing.assert_array_equal(path[0], [1.0, 0.0])
    assert np.abs(path[100]).max() < 0.01, "in between it follows the desired trajectory"
    assert np.linalg.norm(path[-1] - [0.3, -0.3]) < 0.05


def test_controller_gains_outside_their_range_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="kp is 0"):
        PDController(kp=0.0)


# -- ranks and selection ---------------------------------------------------------------------------


@given(REWARDS)
@settings(max_examples=50, deadline=None)
def test_ranks_depend_on_the_order_alone(rewards: np.ndarray) -> None:
    ranked = scale_rewards(rewards, "rank")
    assert ranked.max() == 1.0
    assert ranked.min() == -1.0 or len(np.unique(rewards)) == 1
    i, j = np.unravel_index(np.arange(len(rewards) ** 2), (len(rewards),) * 2)
    np.testing.assert_array_equal(np.sign(ranked[i] - ranked[j]), np.sign(rewards[i] - rewards[j]))
    np.testing.assert_allclose(scale_rewards(np.exp(rewards / 50) - 7, "rank"), ranked)


@given(REWARDS, st.floats(0.01, 100))
@settings(max_examples=50, deadline=None)
def test_selection_weights_are_probabilities_that_favour_the_better(
    rewards: np.ndarray, temperature: float
) -> None:
    weights = selection_weights(rewards, temperature)
    assert weights.sum() == pytest.approx(1.0)
    assert (np.diff(weights[np.argsort(rewards)]) >= -1e-15).all()


def test_selection_weights_fall_by_e_every_temperature_places() -> None:
    weights = selection_weights(np.array([5.0, -2.0, 9.0, 1.0]), 2.0)
    np.testing.assert_allclose(weights[[0, 3, 1]] / weights[2], np.exp([-0.5, -1.0, -1.5]))
    np.testing.assert_allclose(selection_weights(np.array([-1.0, 0.3, 1.0]), math.inf), 1 / 3)


def test_standardised_rewards_have_mean_0_and_standard_deviation_1() -> None:
    scaled = scale_rewards(np.array([-8.0, -2.0, -0.2, -0.1]), "standardize")
    assert scaled.mean() == pytest.approx(0.0)
    assert scaled.std() == pytest.approx(1.0)
    np.testing.assert_array_equal(scale_rewards(np.full(3, -8.0), "standardize"), 0.0)


# -- crossover -------------------------------------------------------------------------------------


def test_crossover_gives_both_children_of_two_different_parents() -> None:
    before, after, cuts = crossover_pairs(np.random.default_rng(0), 5, 40, 100)
    assert (before != after).all()
    np.testing.assert_array_equal(before[::2], after[1::2])
    np.testing.assert_array_equal(after[::2], before[1::2])
    np.testing.assert_array_equal(cuts[::2], cuts[1::2])
    assert cuts.min() >= 1 and cuts.max() <= 99
    children = blend(np.zeros((2, 100, 2)), np.ones((2, 100, 2)), np.array([30, 100]))
    assert children[0, :30].max() == 0.0 and children[0, 30:].min() == 1.0
    assert children[1].max() == 0.0


# -- replay buffer ---------------------------------------------------------------------------------


def filled(n: int, capacity: int | None = None, n_elites: int = 0) -> TrajectoryBuffer:
    rng = np.random.default_rng(0)
    buffer = TrajectoryBuffer(2, (5, 1), capacity, n_elites)
    buffer.add(rng.normal(size=(n, 2)), rng.normal(size=(n, 5, 1)), np.arange(n)[::-1] * 1.0)
    return buffer


def test_a_full_buffer_drops_the_oldest_but_keeps_its_elites() -> None:
    assert len(filled(10)) == 10
    np.testing.assert_array_equal(filled(10, 4).rewards, [3, 2, 1, 0])
    np.testing.assert_array_equal(filled(10, 4, 2).rewards, [9, 8, 1, 0])
    np.testing.assert_array_equal(filled(10, 4, 4).rewards, [9, 8, 7, 6])


def test_a_saved_buffer_is_loaded_unchanged(tmp_path: Path) -> None:
    buffer, other = filled(10), filled(3)
    buffer.save(tmp_path / "buffer.npz")
    other.load(tmp_path / "buffer.npz")
    for name in ("contexts", "trajectories", "rewards"):
        np.testing.assert_array_equal(getattr(other, name), getattr(buffer, name))
    assert [path.name for path in tmp_path.iterdir()] == ["buffer.npz"]


def test_files_that_are_not_buffers_are_refused(tmp_path: Path) -> None:
    buffer = filled(3)
    np.savez(tmp_path / "other.npz", weights=np.ones(3))
    objects = np.array([{}])
    np.savez(tmp_path / "pickled.npz", contexts=objects, trajectories=objects, rewards=objects)
    (tmp_path / "text.npz").write_text("no archive")
    for name in ("other", "pickled", "text"):
        with pytest.raises(FileFormatError, match="is not a trajectory buffer"):
            buffer.load(tmp_path / f"{name}.npz")
    filled(2).save(tmp_path / "good.npz")
    narrow = TrajectoryBuffer(3, (5, 1))
    with pytest.raises(InvalidDataError, match="contexts have shape"):
        narrow.load(tmp_path / "good.npz")
    assert len(buffer) == 3, "a refused file changes nothing"


def test_rollouts_that_do_not_fit_the_buffer_are_refused() -> None:
    buffer = filled(3)
    with pytest.raises(InvalidDataError, match=r"trajectories have shape \(1, 4, 1\)"):
        buffer.add(np.zeros((1, 2)), np.zeros((1, 4, 1)), np.zeros(1))
    with pytest.raises(InvalidDataError, match="rewards hold a value that is not finite"):
        buffer.add(np.zeros((1, 2)), np.zeros((1, 5, 1)), np.array([np.nan]))
    with pytest.raises(ConfigurationError, match="cannot keep 5 elites"):
        TrajectoryBuffer(2, (5, 1), capacity=4, n_elites=5)


# -- elites ----------------------------------------------------------------------------------------


def test_elites_keep_the_best_of_each_context_and_survive_saving() -> None:
    memory = EliteMemory(1, (3, 1), capacity=2)
    contexts = np.array([[0.0], [0.0], [1.0], [0.0]])
    trajectories = np.arange(4.0)[:, None, None] * np.ones((4, 3, 1))
    memory.update(contexts, trajectories, np.array([1.0, 3.0, 0.0, 2.0]))
    index = memory.find(th.tensor([0.0]))
    assert index is not None
    assert float(memory.trajectories[index, 0, 0]) == 1.0
    assert float(memory.rewards[index]) == 3.0
    assert memory.find(th.tensor([0.5])) is None

    other = EliteMemory(1, (3, 1))
    other.load_state_dict(memory.state_dict())
    assert th.equal(other.trajectories, memory.trajectories)

    memory.update(np.array([[2.0]]), trajectories[:1], np.array([0.0]))
    assert len(memory.rewards) == 2, "the capacity is kept"


# -- neural process --------------------------------------------------------------------------------


def network(n_frequencies: int = 2) -> NeuralProcess:
    return NeuralProcess(2, 3, 4, [16], [16], n_frequencies, 0.1, th.nn.Tanh)


def test_the_encoding_does_not_depend_on_the_order_of_the_points() -> None:
    net, times, values = network(), th.rand(2, 6), th.randn(2, 6, 2)
    condition, order = th.randn(2, 3), th.randperm(6)
    one = net.encode(times, values, condition).latent
    two = net.encode(times[:, order], values[:, order], condition).latent
    th.testing.assert_close(one.mean, two.mean)
    th.testing.assert_close(one.stddev, two.stddev)


def test_the_gradient_reaches_every_parameter_and_shapes_are_as_told() -> None:
    net = network()
    latent = net.encode(th.rand(5, 6), th.randn(5, 6, 2), th.randn(5, 3)).latent
    assert latent.mean.shape == (5, 1, 4), "of one category"
    shared = net.decode(th.rand(7), latent.rsample()[:, 0], th.randn(5, 3))
    own = net.decode(th.rand(5, 7), latent.rsample()[:, 0], th.randn(5, 3))
    assert shared.mean.shape == own.mean.shape == (5, 7, 2)
    (shared.mean.square().sum() + own.mean.square().sum()).backward()
    assert all(p.grad is not None and bool(p.grad.abs().sum() > 0) for p in net.parameters())


def test_without_frequencies_time_enters_as_it_is() -> None:
    times = th.rand(4, 3)
    assert th.equal(network(0).features(times), times[..., None])
