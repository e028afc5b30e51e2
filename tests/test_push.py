"""The push task: replay of the thesis's recordings, rewards, the expert and the numbered split."""

import os
from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
import pytest

from benchmark_envs import TaskError, UnknownTaskError, leave_one_out, make_task
from benchmark_envs.tasks.push import (
    BEARINGS,
    CYLINDER,
    DISTANCES,
    EXTRAPOLATION_TARGETS,
    FARTHEST,
    START,
    TARGETS,
    PushTask,
    T,
)
from benchmark_envs.tasks.push_expert import (
    HEADINGS,
    hand_pose,
    inverse_kinematics,
    pocket_pose,
    progress,
    two_moves,
)

RECORDED = [0, 1, 2, 3, 4, 5, 6, 8]  # the targets whose recordings are left


def push(reward: str = "path", n_threads: int | None = None) -> PushTask:
    task = make_task("nmp/Push-v0", reward=reward, n_threads=n_threads)
    assert isinstance(task, PushTask)
    return task


@pytest.fixture(scope="module")
def task() -> PushTask:
    return push()


@pytest.fixture(scope="module")
def goal_task() -> PushTask:
    return push("goal")


def recordings() -> tuple[np.ndarray, np.ndarray]:
    """Joint angles (8, T, 3) and the cylinder's paths (8, T, 2), or a skip that says why not."""
    beside = Path(__file__).parents[2] / "shared" / "refdata"
    folder = Path(os.environ.get("SB3_NMP_REFDATA", beside)) / "acnmp" / "push"
    if not folder.is_dir():
        pytest.skip(
            f"the thesis's recordings are not in {folder}; SB3_NMP_REFDATA names the folder that "
            "holds acnmp/push"
        )
    paths = np.load(folder / "obj_trajectories.npy")[:, :, :2]
    return np.load(folder / "joint_trajectories.npy"), paths


# -- physics -------------------------------------------------------------------------------------


def test_the_recordings_replay_within_a_millimetre(goal_task: PushTask) -> None:
    joints, paths = recordings()
    rollouts = goal_task.simulate(TARGETS[RECORDED], joints)
    error = np.linalg.norm(rollouts.paths["object"] - paths, axis=2)
    assert error.mean() <= 1e-3 and error[:, -1].mean() <= 1e-3
    assert error[:, -1].max() <= 2e-3
    assert rollouts.successes.all() and not rollouts.clipped.any()


def test_the_expert_moves_as_the_recordings_do(task: PushTask) -> None:
    joints, paths = recordings()
    expert = np.stack([task.demonstrate(target) for target in TARGETS[RECORDED]])
    assert np.sqrt(np.mean((expert - joints) ** 2, axis=(1, 2))).max() < 0.1  # rad
    moved = task.simulate(TARGETS[RECORDED], expert).paths["object"]
    assert np.linalg.norm(moved - paths, axis=2).mean(axis=1).max() < 0.02  # m


def test_the_kinematics_agree_with_the_model(task: PushTask) -> None:
    data = mujoco.MjData(task.model)
    for joints in np.random.default_rng(0).uniform(-2, 2, (20, 3)):
        for name, value in zip(("joint_1", "joint_2", "joint_3"), joints, strict=True):
            data.joint(name).qpos[0] = value
        mujoco.mj_kinematics(task.model, data)
        body, pose = data.body("hand"), hand_pose(joints)
        np.testing.assert_allclose(body.xpos[:2], pose[:2], atol=1e-9)
        along = body.xmat.reshape(3, 3)[:2, 0]
        np.testing.assert_allclose(along, [np.cos(pose[2]), np.sin(pose[2])], atol=1e-9)


def test_a_held_start_leaves_the_cylinder_where_it_is(task: PushTask) -> None:
    rollouts = task.simulate(TARGETS[0], task.initial_trajectory(TARGETS[0]))
    np.testing.assert_allclose(rollouts.paths["object"][0], np.tile(CYLINDER, (T, 1)), atol=1e-9)
    np.testing.assert_allclose(rollouts.executed[0], np.tile(START, (T, 1)), atol=1e-9)


def test_the_arm_follows_the_expert_within_a_hundredth_of_a_radian(task: PushTask) -> None:
    rollouts = task.simulate(TARGETS, np.stack([task.demonstrate(t) for t in TARGETS]))
    assert np.abs(rollouts.executed - rollouts.trajectories).max() < 0.01


@pytest.mark.parametrize("reward", ["path", "goal"])
def test_one_and_two_threads_give_the_same_bits(reward: str) -> None:
    expert = np.stack([push().demonstrate(target) for target in TARGETS])
    noisy = expert + 0.05 * np.sin(np.linspace(0, np.pi, T))[:, None]
    one, two = (push(reward, n).simulate(TARGETS, noisy) for n in (1, 2))
    np.testing.assert_array_equal(one.rewards, two.rewards)
    np.testing.assert_array_equal(one.paths["object"], two.paths["object"])
    np.testing.assert_array_equal(expert[3], push(n_threads=2).demonstrate(TARGETS[3]))


# -- rewards -------------------------------------------------------------------------------------


def test_the_path_reward_is_minus_the_summed_squared_distance_to_the_experts_path(
    task: PushTask,
) -> None:
    expert = np.stack([task.demonstrate(target) for target in TARGETS])
    reference = task.simulate(TARGETS, expert)
    np.testing.assert_array_equal(reference.rewards, 0.0)
    # each target is tried with its neighbour's trajectory
    swapped = task.simulate(TARGETS, np.roll(expert, 1, axis=0))
    expected = np.zeros((10, T))
    for i in range(10):
        for t in range(T):
            dx, dy = reference.paths["object"][i - 1, t] - reference.paths["object"][i, t]
            expected[i, t] = -min(dx * dx + dy * dy, FARTHEST**2)
    assert swapped.step_rewards is not None
    np.testing.assert_allclose(swapped.step_rewards, expected, atol=1e-12)
    np.testing.assert_allclose(swapped.rewards, expected.sum(axis=1), atol=1e-9)
    np.testing.assert_array_equal(swapped.terms["path"], swapped.rewards)
    assert (expected == -(FARTHEST**2)).any() and not swapped.successes.all()


def test_the_goal_reward_is_minus_the_final_distance(goal_task: PushTask) -> None:
    expert = goal_task.demonstrate(TARGETS[4])
    rollouts = goal_task.simulate(TARGETS, np.stack([expert] * 10))
    end = rollouts.paths["object"][:, -1]
    distance = np.hypot(*(end - rollouts.contexts).T)
    np.testing.assert_allclose(rollouts.rewards, -distance, atol=1e-12)
    assert rollouts.step_rewards is None
    np.testing.assert_array_equal(rollouts.successes, distance <= 0.03)
    assert rollouts.successes.sum() == 1 and rollouts.successes[4]


@pytest.mark.parametrize(("shift", "solved"), [(0.02, True), (0.04, False)])
def test_success_ends_at_three_centimetres(goal_task: PushTask, shift: float, solved: bool) -> None:
    end = goal_task.simulate(TARGETS[5], goal_task.demonstrate(TARGETS[5])).paths["object"][0, -1]
    rollouts = goal_task.simulate(end + np.array([0, shift]), goal_task.demonstrate(TARGETS[5]))
    assert rollouts.successes[0] == solved


def test_the_experts_solution_is_computed_once_a_context(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[np.ndarray] = []
    refine = PushTask._refine

    def counted(self: PushTask, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        calls.append(target)
        return refine(self, target)

    monkeypatch.setattr(PushTask, "_refine", counted)
    task = push()
    for target in TARGETS[[0, 1, 0, 1]]:
        trajectory = task.demonstrate(target)
        task.simulate(np.stack([target] * 3), np.stack([trajectory] * 3))
        trajectory[:] = 0.0  # the caller's to change, not the cache
    assert len(calls) == 2


def test_the_cache_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmark_envs.tasks.push.CACHED_SOLUTIONS", 2)
    task = push()
    first = task.demonstrate(TARGETS[0])
    for target in TARGETS[:4]:
        task.demonstrate(target)
    assert len(task._solutions) == 2
    np.testing.assert_array_equal(task.demonstrate(TARGETS[0]), first)


def test_an_unknown_reward_is_refused_with_the_list() -> None:
    with pytest.raises(TaskError, match="no reward 'sparse' of PushTask; there are path, goal"):
        make_task("nmp/Push-v0", reward="sparse")
    with pytest.raises(TaskError, match=r"no reward '\['goal'\]' of PushTask"):
        make_task("nmp/Push-v0", reward=["goal"])
    assert push("goal").settings == {"reward": "goal"}


def test_the_environment_reports_step_rewards_and_the_cylinders_path() -> None:
    env = gym.make("nmp/Push-v0", context=TARGETS[1])
    env.reset(seed=0)
    _, reward, _, _, info = env.step(np.tile(START, (T, 1)).astype(np.float32))
    assert info["step_rewards"].shape == (T,) and info["path_object"].shape == (T, 2)
    assert info["step_rewards"].sum() == pytest.approx(reward)


# -- the expert ----------------------------------------------------------------------------------


def test_the_expert_ends_within_two_centimetres_of_all_ten_targets(goal_task: PushTask) -> None:
    expert = np.stack([goal_task.demonstrate(target) for target in TARGETS])
    rollouts = goal_task.simulate(TARGETS, expert)
    assert rollouts.successes.all() and not rollouts.clipped.any()
    assert rollouts.rewards.min() >= -0.02


def test_the_expert_solves_drawn_targets(goal_task: PushTask) -> None:
    rng = np.random.default_rng(7)
    contexts = np.stack([goal_task.sample_context(rng) for _ in range(60)])
    rollouts = goal_task.simulate(contexts, np.stack([goal_task.demonstrate(c) for c in contexts]))
    assert rollouts.successes.mean() >= 0.95
    assert (rollouts.rewards >= -0.02).mean() >= 0.95


def test_drawn_targets_surround_the_arc_of_the_ten(task: PushTask) -> None:
    rng = np.random.default_rng(0)
    drawn = np.stack([task.sample_context(rng) for _ in range(200)])
    distance = np.linalg.norm(drawn, axis=1)
    assert distance.min() >= DISTANCES[0] and distance.max() <= DISTANCES[1]
    for target in TARGETS:
        assert DISTANCES[0] <= np.linalg.norm(target) <= DISTANCES[1]
        assert BEARINGS[0] <= np.degrees(np.arctan2(target[1], target[0])) <= BEARINGS[1]
        assert np.linalg.norm(drawn - target, axis=1).min() < 0.05


@pytest.mark.parametrize("target", [(0.44, 0.44), (0.0, 0.05), (-0.3, 0.44)])
def test_a_target_out_of_reach_is_named_with_the_reachable_region(
    task: PushTask, goal_task: PushTask, target: tuple[float, float]
) -> None:
    message = rf"cannot push the cylinder to \[{target[0]}, {target[1]}\] m.*-60 to 140 degrees"
    with pytest.raises(TaskError, match=message):
        task.demonstrate(target)
    with pytest.raises(TaskError, match=message):  # the path reward asks the expert
        task.simulate(target, task.initial_trajectory(target))
    rollouts = goal_task.simulate(target, goal_task.initial_trajectory(target))
    assert not rollouts.successes[0]


def test_the_expert_is_no_linear_function_of_the_target(goal_task: PushTask) -> None:
    """A linear map fitted to 80 demonstrations still misses targets among them."""
    rng = np.random.default_rng(3)
    contexts = np.stack([goal_task.sample_context(rng) for _ in range(80)])
    expert = np.stack([goal_task.demonstrate(context) for context in contexts])
    inputs = np.column_stack([contexts, np.ones(80)])
    weights = np.linalg.lstsq(inputs, expert.reshape(80, -1), rcond=None)[0]
    rollouts = goal_task.simulate(contexts, (inputs @ weights).reshape(expert.shape))
    assert rollouts.successes.mean() < 0.5


def test_inverse_kinematics_undoes_the_kinematics() -> None:
    rng = np.random.default_rng(0)
    for joints in rng.uniform([-0.5, 0.3, -1.5], [2.5, 2.5, 1.5], (50, 3)):
        found = inverse_kinematics(hand_pose(joints))
        assert found is not None
        np.testing.assert_allclose(found, joints, atol=1e-9)
    assert inverse_kinematics(np.array([0.001, 0.0, 0.0])) is None
    far = inverse_kinematics(np.array([1.0, 1.0, 0.3]))
    assert far is not None
    np.testing.assert_allclose(hand_pose(far)[:2], np.full(2, 0.3535 / np.sqrt(2)), atol=1e-9)


def test_the_pocket_pose_has_the_cylinder_in_the_pocket() -> None:
    pose = pocket_pose(CYLINDER, 0.4, 0.05, -0.01)
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    np.testing.assert_allclose(pose[:2] + turn @ [0.05, -0.01], CYLINDER, atol=1e-12)


def test_the_two_moves_meet_at_the_contact_and_stop_there() -> None:
    contact, end = START + 0.5, START + np.array([2.0, -1.0, 0.3])
    moves = two_moves(START, contact, end, T)
    speed = np.linalg.norm(np.diff(moves, axis=0), axis=1)
    k = int(np.argmin(np.linalg.norm(moves - contact, axis=1)))
    np.testing.assert_allclose(moves[k], contact)
    np.testing.assert_allclose(moves[-1], end)
    assert max(speed[0], speed[k], speed[-1]) < 0.05 * np.median(speed)
    share = progress(100)
    assert share.shape == (100,) and share[-1] == pytest.approx(1.0) and (np.diff(share) > 0).all()


def test_the_headings_are_sorted_by_bearing() -> None:
    assert (np.diff(HEADINGS[:, 0]) > 0).all()


# -- the numbered split --------------------------------------------------------------------------


def test_leave_one_out_gives_nine_targets_and_the_tenth() -> None:
    for number in range(10):
        train, test = leave_one_out("nmp/Push-v0", target=number)
        assert train.shape == (9, 2) and test.shape == (2,)
        np.testing.assert_array_equal(test, TARGETS[number])
        np.testing.assert_array_equal(np.insert(train, number, test, axis=0), TARGETS)
        test[:] = 0.0
        assert TARGETS[number].any(), "a copy was given"


def test_leave_one_out_names_the_numbers_that_exist() -> None:
    for number in (10, -1):
        with pytest.raises(TaskError, match=f"no target {number}; .* numbered 0 to 9"):
            leave_one_out("nmp/Push-v0", target=number)
    with pytest.raises(TaskError, match="nmp/Bottles-v0 has no numbered targets"):
        leave_one_out("nmp/Bottles-v0", target=0)
    with pytest.raises(UnknownTaskError):
        leave_one_out("nmp/Shove-v0", target=0)


def test_the_extrapolation_targets_are_the_ends_of_the_arc() -> None:
    bearings = np.degrees(np.arctan2(TARGETS[:, 1], TARGETS[:, 0]))
    ends = (int(np.argmin(bearings)), int(np.argmax(bearings)))
    assert ends == EXTRAPOLATION_TARGETS
