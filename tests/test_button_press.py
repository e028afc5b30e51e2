"""The button press and its proxy skills: two arms, their kinematics, experts and recordings."""

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmark_envs import MujocoTask, TaskError, make_task
from benchmark_envs.tasks.planar_arms import ARMS, PEG, PlanarArm, tip_pose

SKILLS = ("nmp/ArmReach-v0", "nmp/ArmPush-v0", "nmp/PegInsertion-v0", "nmp/ButtonPress-v0")
EACH_ARM = pytest.mark.parametrize("arm", list(ARMS))


def make(task_id: str, arm: str) -> MujocoTask:
    task = make_task(task_id, n_threads=1, arm=arm)
    assert isinstance(task, MujocoTask)
    return task


def recording(name: str) -> np.ndarray:
    """Joint angles of the thesis's recordings, or a skip that says why not."""
    beside = Path(__file__).parents[2] / "shared" / "refdata"
    folder = Path(os.environ.get("SB3_NMP_REFDATA", beside)) / "acnmp" / "transfer"
    if not folder.is_dir():
        pytest.skip(
            f"the thesis's recordings are not in {folder}; SB3_NMP_REFDATA names the folder that "
            "holds acnmp/transfer"
        )
    return np.load(folder / f"{name}_joints.npy")


@EACH_ARM
@pytest.mark.parametrize("task_id", SKILLS)
def test_both_arms_do_every_skill(task_id: str, arm: str) -> None:
    task, rng = make(task_id, arm), np.random.default_rng(5)
    contexts = np.stack([task.sample_context(rng) for _ in range(4)])
    expert = np.stack([task.demonstrate(context) for context in contexts])
    assert expert.shape == (4, 300, int(arm[0]))
    rollouts = task.simulate(contexts, expert)
    assert rollouts.successes.all()
    assert (rollouts.rewards > -0.5 * task.tolerance).all()  # type: ignore[attr-defined]
    assert np.abs(rollouts.executed - expert).max() < 0.02  # nothing stopped the arm


@EACH_ARM
def test_kinematics_are_those_of_the_model_and_its_inverse(arm: str) -> None:
    task, arms = make("nmp/ArmReach-v0", arm), PlanarArm.named(arm)
    data, rng = mujoco.MjData(task.model), np.random.default_rng(0)
    for _ in range(5):
        joints = rng.uniform(-2, 2, arms.n_joints)
        data.qpos[:] = joints
        mujoco.mj_forward(task.model, data)
        hand, pose = data.body("hand"), arms.tool_pose(joints)
        assert hand.xpos[:2] == pytest.approx(pose[:2], abs=1e-9)
        ahead = hand.xmat.reshape(3, 3)[:2, 0]
        assert ahead == pytest.approx([np.cos(pose[2]), np.sin(pose[2])], abs=1e-9)
    poses = np.column_stack([np.linspace(0.1, 0.34, 9), np.full(9, 0.05), np.linspace(-1, 1, 9)])
    assert arms.tool_pose(arms.joints_at(poses)) == pytest.approx(poses, abs=1e-5)


def test_all_elbows_bend_alike() -> None:
    arm = PlanarArm.named("4dof")
    joints = arm.joints_at(tip_pose(np.array([[0.3, 0.1], [0.45, 0.0]]), np.array([0.2, 0.0]), PEG))
    bends = joints[:, 1:3] + np.array(arm.offsets[1:3])
    assert bends[:, 0] == pytest.approx(bends[:, 1])
    assert (bends > 0).all()
    with pytest.raises(TaskError, match="is the least"):
        arm.joints_at(np.array([[0.001, 0.0, 0.0]]))


def test_unknown_arms_are_refused() -> None:
    with pytest.raises(TaskError, match="no arm '7dof'; there are 3dof, 4dof"):
        make_task("nmp/ButtonPress-v0", arm="7dof")


@EACH_ARM
def test_a_peg_beside_the_gap_is_stopped_by_the_wall_and_touches_nothing(arm: str) -> None:
    task = make("nmp/ButtonPress-v0", arm)
    arms, goal = PlanarArm.named(arm), task.sample_context(np.random.default_rng(0))
    for side in (-0.07, 0.07):
        towards = np.linspace([0.36, -0.12 + side], [0.46, -0.15 + side], 40)
        joints = arms.joints_at(tip_pose(towards, np.full(40, -0.3), PEG))
        start = np.linspace(arms.start, joints[0], 150)
        whole = np.concatenate([start, np.repeat(joints, 4, axis=0)[10:]])
        rollouts = task.simulate(goal, whole)
        assert rollouts.outcomes["touched"].tolist() == [0.0]
        assert rollouts.rewards[0] == pytest.approx(-np.hypot(0.045, 0.022), abs=1e-4)
        assert np.abs(rollouts.executed - whole).max() > 0.1, "the wall is solid"


def test_the_reward_is_the_cubes_final_distance() -> None:
    task = make("nmp/ButtonPress-v0", "4dof")
    goal = task.sample_context(np.random.default_rng(0))
    half = task.demonstrate(goal)
    half[240:] = half[240]  # stops underway
    rollouts = task.simulate(goal, half)
    left = np.linalg.norm(rollouts.paths["object"][0, -1] - goal)
    assert rollouts.rewards[0] == pytest.approx(-left)
    assert rollouts.outcomes["touched"].tolist() == [1.0]
    assert 0.015 < left < 0.049
    assert not rollouts.successes[0]


def test_a_peg_that_misses_the_slot_is_stopped() -> None:
    task, there = make("nmp/PegInsertion-v0", "3dof"), np.array([0.44, 0.10])
    turned = np.array([[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]]) @ there
    rollouts = task.simulate(there, task.demonstrate(turned))  # as if the slot were 45 mm aside
    assert not rollouts.successes[0]
    assert np.abs(rollouts.executed[0] - task.demonstrate(turned)).max() > 0.1


def test_the_thesis_recording_of_the_button_press_solves_ours() -> None:
    task = make("nmp/ButtonPress-v0", "3dof")
    rollouts = task.simulate(
        task.sample_context(np.random.default_rng(0)), recording("button_3dof")
    )
    assert rollouts.successes[0]
    assert rollouts.rewards[0] > -0.008


def test_the_fitted_arm_ends_the_recorded_skills_where_the_other_one_does() -> None:
    ends = []
    for arm in ARMS.values():
        pose = arm.tool_pose(recording(f"proxy_{arm.name}")[:, -1])
        ahead = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=1)
        ends.append((pose[:, :2] + 0.053 * ahead, pose[:, 2]))
    apart = np.linalg.norm(ends[0][0] - ends[1][0], axis=1)
    assert np.sqrt(np.mean(apart**2)) < 0.006
    insertions = slice(8, 12)
    assert np.abs(ends[0][1] - ends[1][1])[insertions].max() < np.radians(6)
