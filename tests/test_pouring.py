"""The pouring task: conservation of mass, physics, rewards, the expert and its calibration."""

import gymnasium as gym
import numpy as np
import pytest

from benchmark_envs import (
    InvalidContextError,
    RenderingUnavailableError,
    TaskError,
    make_task,
)
from benchmark_envs.tasks.pouring import (
    DEMONSTRATED,
    EXTRAPOLATION_CONTEXTS,
    FASTEST,
    HIGHEST,
    LOWEST,
    SUBSTEPS,
    TOLERANCE,
    PouringTask,
    T,
    demonstration_contexts,
)
from benchmark_envs.tasks.pouring_expert import (
    AMOUNTS,
    FRACTIONS,
    PEAKS,
    TRIED,
    calibrate,
    peak_tilt,
    plan,
)
from benchmark_envs.tasks.pouring_grains import (
    CUP,
    CUP_HEIGHT,
    CUP_RADIUS,
    GRAINS,
    RADIUS,
    RECEIVER,
    WALL,
    count_inside,
    grain_positions,
    settle,
    shares,
)

TIMES = 0.016 * np.arange(1, T + 1, dtype=np.float64)  # s; of the set-points


def pouring(n_threads: int | None = None) -> PouringTask:
    task = make_task("nmp/Pouring-v1", n_threads=n_threads)
    assert isinstance(task, PouringTask)
    return task


@pytest.fixture(scope="module")
def task() -> PouringTask:
    return pouring()


def violent(n: int, seed: int = 0) -> np.ndarray:
    """White noise over the whole space, and jumps between its ends; shape (n, T, 1)."""
    rng = np.random.default_rng(seed)
    noise = rng.uniform(LOWEST, HIGHEST, (n, T, 1))
    knots = rng.choice([LOWEST, HIGHEST], (n, 8, 1)).repeat(T // 8, axis=1)
    return np.where(np.arange(n)[:, None, None] % 2 == 0, noise, knots)


def tilts(*degrees: float) -> np.ndarray:
    """The expert's plans with given peaks; shape (n, T, 1)."""
    return np.stack([plan(np.radians(peak), TIMES) for peak in degrees])


# -- the grains ----------------------------------------------------------------------------------


def test_mass_is_conserved_exactly_by_violent_trajectories(task: PouringTask) -> None:
    initial = np.array([500.0, 733.3, 900.1, 1111.1, 1249.9, 1500.0])
    contexts = np.column_stack([initial, np.full(6, 123.4)])
    rollouts = task.simulate(contexts, violent(6))
    assert not rollouts.diverged.any() and rollouts.clipped.all()
    amounts = rollouts.outcomes
    assert set(amounts) == {"poured", "kept", "spilled"}
    assert all((amount >= 0).all() for amount in amounts.values())
    assert (amounts["poured"] > 0).any() and (amounts["kept"] > 0).any()
    assert (amounts["spilled"] > 0).any()
    total = amounts["poured"] + amounts["kept"] + amounts["spilled"]
    np.testing.assert_array_equal(total, rollouts.contexts[:, 0])


def test_shares_add_up_without_rounding() -> None:
    rng = np.random.default_rng(0)
    amounts = rng.uniform(500, 1500, 2000)
    counts = np.round(amounts / 10).astype(int)
    poured = rng.integers(0, counts + 1)
    kept = rng.integers(0, counts - poured + 1)
    kept[::2] = (counts - poured)[::2]  # nothing spilled
    a, b, c = shares(amounts, counts, poured, kept)
    for total in (a + b + c, c + b + a, a + c + b):
        np.testing.assert_array_equal(total, amounts)
    np.testing.assert_allclose(a, amounts * poured / counts, atol=1e-6)
    np.testing.assert_allclose(b, amounts * kept / counts, atol=2e-6)
    assert (c[::2] == 0).all() and (c[1::2][(poured + kept < counts)[1::2]] > 0).all()
    assert (a[poured == 0] == 0).all() and (a[poured == counts] == amounts[poured == counts]).all()


def test_no_grain_passes_through_a_wall(task: PouringTask) -> None:
    """Grains leave and enter the cups over their rims alone."""
    trajectory = violent(2)[1:]
    controls = task._controls(np.array([[1500.0, 100.0]]), task._follow(trajectory))[0]
    states = task.executor.states(task._at_rest(GRAINS), controls)
    grains = grain_positions(task.model, states, GRAINS)
    wrist = states[:, 1, None]
    offset = grains - (CUP - [0, 0, CUP[2] - 0.3])
    x = offset[..., 0] * np.cos(wrist) - offset[..., 2] * np.sin(wrist)
    z = offset[..., 0] * np.sin(wrist) + offset[..., 2] * np.cos(wrist) + 0.3 - CUP[2]
    for near, height in (
        (np.hypot(x, offset[..., 1]), z),
        (np.hypot(*(grains[..., :2] - RECEIVER[:2]).transpose(2, 0, 1)), grains[..., 2] - 0.03),
    ):
        below = (height > 0) & (height < CUP_HEIGHT - RADIUS)
        inside, outside = below & (near < CUP_RADIUS), below & (near >= CUP_RADIUS + WALL)
        assert not (inside[:-1] & outside[1:]).any() and not (outside[:-1] & inside[1:]).any()
        # the middle of a wall is reached by none
        assert not (below & (np.abs(near - CUP_RADIUS - WALL / 2) < WALL / 4)).any()


@pytest.mark.parametrize("n", [50, 87, 150])
def test_the_settled_grains_are_at_rest(task: PouringTask, n: int) -> None:
    state = task._at_rest(n)
    states = task.executor.states(state, np.zeros((100, 1)))
    before = grain_positions(task.model, state[None], n)
    after = grain_positions(task.model, states, n)
    assert np.abs(after - before).max() < 5e-4
    assert count_inside(before, CUP)[0] == n and count_inside(before, RECEIVER)[0] == 0
    gaps = np.linalg.norm(before[0][:, None] - before[0], axis=2) + np.eye(n)
    assert gaps.min() > 1.9 * RADIUS, "none lies in another"
    assert before[..., 2].max() < CUP[2] + CUP_HEIGHT - RADIUS, "the cup holds them"


def test_settling_is_deterministic_and_done_once(task: PouringTask) -> None:
    one, two = settle(pouring(1).executor), settle(pouring(2).executor)
    np.testing.assert_array_equal(one, two)
    assert one.shape == (GRAINS, 3) and (np.diff(one[:, 2]) >= 0).all()
    assert task._at_rest(90) is task._at_rest(90)


def test_a_time_point_is_two_steps(task: PouringTask) -> None:
    assert task.model.opt.timestep * SUBSTEPS == task.dt
    np.testing.assert_array_equal(task.times, TIMES)


def test_counting_tells_inside_from_beside_above_and_below() -> None:
    places = RECEIVER + np.array([[0, 0, 0.01], [0.05, 0, 0.1], [0.07, 0, 0.1], [0, 0, 0.2]])
    below = RECEIVER - [[0, 0, 0.02]]
    positions = np.concatenate([places, below, np.full((1, 3), -np.inf)])[None]
    assert count_inside(positions, RECEIVER).tolist() == [2]


# -- pouring -------------------------------------------------------------------------------------


def test_an_upright_cup_pours_nothing_and_a_full_tilt_nearly_all(task: PouringTask) -> None:
    contexts = np.array([[500.0, 50.0], [1400.0, 1322.0]]).repeat(2, axis=0)
    trajectories = np.concatenate([np.zeros((1, T, 1)), tilts(105)] * 2)
    rollouts = task.simulate(contexts, trajectories)
    np.testing.assert_array_equal(rollouts.outcomes["kept"][::2], contexts[::2, 0])
    np.testing.assert_array_equal(rollouts.rewards[::2], -contexts[::2, 1])
    assert (rollouts.outcomes["poured"][1::2] > 0.9 * contexts[1::2, 0]).all()


def test_a_higher_peak_and_a_fuller_cup_pour_more(task: PouringTask) -> None:
    trajectories = tilts(70, 76, 82, 88, 94)
    for_900, for_1400 = (
        task.simulate([amount, 100.0], trajectories).outcomes["poured"] for amount in (900, 1400)
    )
    assert (np.diff(for_900) > 0).all() and (np.diff(for_1400) > 0).all()
    assert (for_1400 > for_900).all()


def test_a_cup_turned_too_far_spills(task: PouringTask) -> None:
    trajectory = np.full((T, 1), HIGHEST)  # at 126 degrees the stream falls short of the receiver
    spilled = task.simulate([1400.0, 1322.0], trajectory).outcomes["spilled"][0]
    assert spilled > 100


def test_the_wrist_follows_within_a_milliradian_and_no_faster_than_it_can(
    task: PouringTask,
) -> None:
    smooth = tilts(95)
    rollouts = task.simulate([900.0, 400.0], smooth)
    assert np.abs(rollouts.executed - smooth).max() < 1e-3 and not rollouts.clipped[0]
    jump = np.full((1, T, 1), 1.0)
    rollouts = task.simulate([900.0, 400.0], jump)
    assert rollouts.clipped[0] and rollouts.info(0)["clipped"]
    np.testing.assert_array_equal(rollouts.trajectories, jump)
    expected = np.minimum(FASTEST * np.arange(1, T + 1), 1.0)
    np.testing.assert_allclose(rollouts.executed[0, :, 0], expected, atol=0.02)


def test_one_and_two_threads_batches_and_singles_give_the_same_bits(task: PouringTask) -> None:
    contexts = np.array([[900.0, 300.0], [1400.0, 1322.0], [870.0, 200.0]])
    trajectories = np.concatenate([tilts(84, 92), violent(1)])
    one, two = (pouring(n).simulate(contexts, trajectories) for n in (1, 2))
    for i in range(3):
        alone = task.simulate(contexts[i], trajectories[i])
        for other in (one[i], two[i]):
            np.testing.assert_array_equal(alone.executed, other.executed)
            assert alone.rewards[0] == other.rewards[0]
            assert alone.info(0)["poured"] == other.info(0)["poured"]


# -- rewards and contexts ------------------------------------------------------------------------


def test_the_reward_is_minus_the_error_and_success_ends_at_27_grams(task: PouringTask) -> None:
    trajectory = tilts(84)[0]
    poured = task.simulate([900.0, 300.0], trajectory).outcomes["poured"][0]
    targets = poured + np.array([-28.0, -26.0, 0.0, 26.0, 28.0])
    contexts = np.column_stack([np.full(5, 900.0), targets])
    rollouts = task.simulate(contexts, np.stack([trajectory] * 5))
    np.testing.assert_array_equal(rollouts.outcomes["poured"], poured)
    np.testing.assert_allclose(rollouts.rewards, [-28, -26, 0, -26, -28])
    np.testing.assert_allclose(rollouts.terms["excess"], [-28, -26, 0, 0, 0])
    np.testing.assert_allclose(rollouts.terms["short"], [0, 0, 0, -26, -28])
    assert rollouts.successes.tolist() == [False, True, True, True, False]
    assert TOLERANCE == 27.0


def test_the_environment_reports_what_was_poured_kept_and_spilled() -> None:
    env = gym.make("nmp/Pouring-v1", context=[900, 300])
    env.reset(seed=0)
    _, reward, _, _, info = env.step(tilts(84)[0].astype(np.float32))
    assert info["poured"] + info["kept"] + info["spilled"] == 900.0
    assert reward == pytest.approx(-abs(info["poured"] - 300))


def test_more_than_the_cup_holds_or_contains_is_refused(task: PouringTask) -> None:
    with pytest.raises(
        InvalidContextError, match=r"initial amount \[g\]\) is 1600, .* \[500, 1500\]"
    ):
        task.simulate([1600.0, 300.0], np.zeros((T, 1)))
    with pytest.raises(InvalidContextError, match=r"is 10, but must lie in \[50, 1500\]"):
        task.check_context([900.0, 10.0])
    with pytest.raises(
        InvalidContextError, match=r"pour is 950 g, but the cup holds 900 g: .* 950 to 1500 g"
    ):
        gym.make("nmp/Pouring-v1", context=[900, 950])
    np.testing.assert_array_equal(task.check_context([900, 900]), [900, 900])


# -- the expert ----------------------------------------------------------------------------------


def test_the_expert_pours_drawn_amounts_within_15_grams(task: PouringTask) -> None:
    rng = np.random.default_rng(7)
    contexts = np.stack([task.sample_context(rng) for _ in range(14)])
    assert (contexts >= DEMONSTRATED[0]).all() and (contexts <= DEMONSTRATED[1]).all()
    rollouts = task.simulate(contexts, np.stack([task.demonstrate(c) for c in contexts]))
    assert (rollouts.rewards >= -15).mean() >= 0.95
    assert rollouts.successes.all() and not rollouts.clipped.any()


def test_the_expert_solves_the_extrapolation_and_repeats_itself(task: PouringTask) -> None:
    context = EXTRAPOLATION_CONTEXTS[0]
    expert = task.demonstrate(context)
    assert task.simulate(context, expert).successes[0]
    expert[:] = 0.0  # the caller's to change, not the cache
    np.testing.assert_array_equal(task.demonstrate(context), pouring(1).demonstrate(context))


def test_the_expert_says_what_it_cannot_pour(monkeypatch: pytest.MonkeyPatch) -> None:
    task = pouring()
    monkeypatch.setattr("benchmark_envs.tasks.pouring.REFINEMENTS", 2)
    monkeypatch.setattr(
        "benchmark_envs.tasks.pouring.peak_tilt",
        lambda *_: np.radians(75),  # too low, whatever the aim
    )
    with pytest.raises(TaskError, match=r"cannot pour 1400 of 1400 g within 27 g: .* 95 %"):
        task.demonstrate([1400.0, 1400.0])


def test_calibrate_turns_a_known_relation_around(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmark_envs.tasks.pouring_expert.TRIED", np.arange(70.0, 100.5, 0.5))

    def pour(amounts: np.ndarray, trajectories: np.ndarray) -> np.ndarray:
        peak = np.degrees(trajectories.max(axis=(1, 2)))
        return amounts * (peak - 75.0) / 20.0 + 5.0 * (-1.0) ** np.arange(len(peak))  # scatters

    measured = calibrate(pour, TIMES, np.array([500.0, 900.0]))
    np.testing.assert_allclose(measured, np.tile(75.0 + 20.0 * FRACTIONS, (2, 1)), atol=0.1)


@pytest.mark.parametrize("row", [0, 5])
def test_the_calibrated_peaks_pour_their_shares_but_for_the_scatter(
    task: PouringTask, row: int
) -> None:
    """One degree pours some 40 g; single avalanches scatter by 18 g, in other ways by MuJoCo's
    version.
    """
    assert PEAKS.shape == (len(AMOUNTS), len(FRACTIONS))
    assert (np.diff(PEAKS, axis=1) > 0).all() and PEAKS.max() < TRIED[-1]
    rollouts = task.simulate([AMOUNTS[row], 50.0], tilts(*PEAKS[row]))
    errors = rollouts.outcomes["poured"] - AMOUNTS[row] * FRACTIONS
    assert abs(errors.mean()) < 20 and errors.std() < 30


def test_the_aim_rises_with_the_target_and_falls_with_the_content() -> None:
    targets = np.linspace(50, 850, 30)
    assert (np.diff([peak_tilt(900, target) for target in targets]) >= 0).all()
    amounts = np.linspace(500, 1500, 30)
    assert (np.diff([peak_tilt(amount, 200) for amount in amounts]) < 0).all()
    assert np.degrees(peak_tilt(900.0, 360.0)) == pytest.approx(PEAKS[2, 6])


def test_a_plan_begins_and_ends_upright_at_a_speed_that_the_wrist_has() -> None:
    angles = plan(np.radians(110), TIMES)
    assert angles.shape == (T, 1) and angles[0] == 0 and abs(angles[-1, 0]) < 1e-12
    assert angles.max() == pytest.approx(np.radians(110))
    assert np.abs(np.diff(angles, axis=0)).max() < FASTEST


def test_there_are_sixteen_demonstrations_and_the_extrapolation_lies_outside() -> None:
    contexts = demonstration_contexts()
    assert contexts.shape == (16, 2) and len(np.unique(contexts, axis=0)) == 16
    np.testing.assert_array_equal([contexts.min(axis=0), contexts.max(axis=0)], DEMONSTRATED)
    assert (EXTRAPOLATION_CONTEXTS > DEMONSTRATED[1]).all()
    np.testing.assert_array_equal(EXTRAPOLATION_CONTEXTS[0], [1400, 1322])


# -- pictures ------------------------------------------------------------------------------------


def test_frames_show_marbles_that_move_to_the_receiver(task: PouringTask) -> None:
    try:
        frames = task.frames([500.0, 300.0], tilts(92)[0], 120, 90)
    except RenderingUnavailableError as error:
        pytest.skip(str(error))
    assert len(frames) == 105  # 25 a second for 4.2 s
    assert all(frame.shape == (90, 120, 3) and frame.std() > 10 for frame in frames)

    def orange(frame: np.ndarray, columns: slice) -> int:
        red, _, blue = np.moveaxis(frame[:, columns].astype(int), -1, 0)
        return int(np.sum(red > blue + 60))

    left, right = slice(0, 60), slice(60, 120)
    assert orange(frames[0], left) > orange(frames[-1], left)
    assert orange(frames[0], right) < orange(frames[-1], right)
