"""Arms given as MJCF: what is read from the file, the expert, the bandit, and limits."""

import importlib.util
import pickle
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stable_baselines3.common.env_checker import check_env

from benchmark_envs import InvalidTrajectoryError, TaskError, TrajectoryEnv
from benchmark_envs.robots import PEG_ARM, Arm, ArmTask, MotionLimits, ViaPose
from benchmark_envs.robots.motion_limits import derivative
from benchmark_envs.robots.via_poses import check_way, smooth_way
from sb3_nmp import CNMPArchitecture, Demonstrations, SkillTransfer, TransferTraining

START = [0, -0.3, 1.6, 0, 1.7, 0]
DOWN = [0, 0, -1]
CONTEXTS = np.array([[0.42, -0.1], [0.5, 0.0], [0.55, 0.12]])


def asset(package: str, path: str) -> Path:
    found = importlib.util.find_spec(package)
    if found is None or found.origin is None:
        pytest.skip(f"{package} is not installed")
    return Path(found.origin).parent / path


def into_hole(hole: np.ndarray) -> list[ViaPose]:
    above = ViaPose([*hole, 0.12], at=0.5, axis=DOWN, counts=False)
    return [above, ViaPose([*hole, 0.012], at=0.9, axis=DOWN)]


def peg_task(**more: Any) -> ArmTask:
    settings: dict[str, Any] = {
        "context_names": ["hole x [m]", "hole y [m]"], "context_low": [0.35, -0.25],
        "context_high": [0.6, 0.25], "placed": {"hole": lambda hole: [*hole, 0.0]},
        "tolerance": 0.005, "n_time_points": 60, "n_threads": 1,
    }  # fmt: skip
    return ArmTask(Arm(PEG_ARM, tip="peg_tip", start=START), into_hole, **settings | more)


@pytest.fixture(scope="module")
def task() -> ArmTask:
    pytest.importorskip("mink", reason="the extra 'robots' is not installed")
    return peg_task()


@pytest.fixture(scope="module")
def shown(task: ArmTask) -> np.ndarray:
    return np.stack([task.demonstrate(context) for context in CONTEXTS])


# -- the file --------------------------------------------------------------------------------------


def test_the_tip_is_where_the_links_say() -> None:
    arm = Arm(PEG_ARM, tip="peg_tip", start=START)
    upright = arm.tip_pose(np.zeros(6))
    np.testing.assert_allclose(
        upright, [[0, 0, 0.08 + 0.1 + 0.35 + 0.32 + 0.03 + 0.07 + 0.14], [0, 0, 1]], atol=1e-12
    )
    forward = arm.tip_pose([0.3, np.pi / 2, 0, 0, 0, 0])
    ahead = np.array([np.cos(0.3), np.sin(0.3), 0])
    np.testing.assert_allclose(forward, [[*(0.91 * ahead[:2]), 0.18], ahead], atol=1e-12)


def test_an_arm_of_a_package_without_position_servos_becomes_one_with_them() -> None:
    arm = Arm(asset("gymnasium", "envs/mujoco/assets/pusher_v5.xml"), tip="tip_arml")
    assert (arm.n_joints, arm.frame) == (7, "geom")
    assert arm.kinematic.nq == 7, "the object's two slides are no joints of the arm"
    model, n_steps = arm.simulated(0.02, watched=["object"])
    assert (model.nu, model.nq) == (7, 11), "two things slide in two directions"
    assert n_steps * model.opt.timestep == pytest.approx(0.02)
    assert [model.sensor(i).name for i in (0, 1, 7, 8, 9)] == [
        "clock", arm.joints[0], arm.joints[-1], "tip", "object",
    ]  # fmt: skip
    np.testing.assert_allclose(arm.start, (arm.low + arm.high) / 2)


def test_joints_that_are_not_named_are_held() -> None:
    arm = Arm(PEG_ARM, tip="flange", joints=["elbow", "turn"], ranges={"turn": (-0.5, 0.5)})
    assert arm.joints == ("turn", "elbow"), "from the base on"
    assert (arm.kinematic.nq, arm.low[0], arm.high[0]) == (2, -0.5, 0.5)


# -- the bandit and its expert ---------------------------------------------------------------------


def test_the_expert_puts_the_peg_into_the_hole_wherever_it_is(
    task: ArmTask, shown: np.ndarray
) -> None:
    rollouts = task.simulate(CONTEXTS, shown)
    assert rollouts.successes.all() and not rollouts.clipped.any()
    ends = rollouts.paths["tip"][:, 53]  # 0.9 of 60 time points
    misses = np.linalg.norm(ends - [[*c, 0.012] for c in CONTEXTS], axis=1)
    np.testing.assert_allclose(rollouts.rewards, -misses, atol=1e-6)
    assert np.all(shown >= task.arm.low) and np.all(shown <= task.arm.high)
    tips = np.array([task.arm.tip_pose(joints) for joints in shown[:, 30]])
    np.testing.assert_allclose(tips[:, 1], [DOWN] * 3, atol=0.02)


def test_the_block_is_solid(task: ArmTask, shown: np.ndarray) -> None:
    """The peg of another hole stands on the block; beside the block it goes down."""
    near, far = CONTEXTS[0] + [0.0, 0.02], CONTEXTS[0] + [0.0, 0.1]
    rollouts = task.simulate([near, far], shown[[0, 0]])
    heights = rollouts.paths["tip"][:, 53, 2]
    assert not rollouts.successes.any()
    assert heights[0] > 0.06 > 0.02 > heights[1]


def test_servos_follow_and_the_same_input_gives_the_same_rollout(
    task: ArmTask, shown: np.ndarray
) -> None:
    once, again = (task.simulate(CONTEXTS, shown) for _ in range(2))
    assert np.abs(once.executed[:, -1] - shown[:, -1]).max() < 0.01
    assert np.array_equal(once.executed, again.executed)
    other: ArmTask = pickle.loads(pickle.dumps(Sealed(task))).open()
    assert np.array_equal(other.simulate(CONTEXTS[0], shown[:1]).executed[0], once.executed[0])


class Sealed:
    """A task without what pickle cannot carry, its functions; they are given anew."""

    def __init__(self, task: ArmTask) -> None:
        self.arm = task.arm

    def open(self) -> ArmTask:
        made = peg_task()
        made.arm = self.arm
        return made


@pytest.mark.filterwarnings("ignore:We recommend you to use a symmetric and normalized Box")
def test_it_is_an_environment(task: ArmTask, shown: np.ndarray) -> None:
    env = TrajectoryEnv(task, context=CONTEXTS[0])
    check_env(env, skip_render_check=True)
    env.reset(seed=0)
    _, reward, done, _, info = env.step(shown[0].astype(np.float32))
    assert done and info["is_success"] and reward > -0.005
    assert not task.simulate(CONTEXTS[0], task.initial_trajectory(CONTEXTS[0])).successes[0]


def test_the_expert_rests_in_each_pose_and_goes_straight() -> None:
    way = [ViaPose([1, 0, 0], at=0.5), ViaPose([1, 2, 0], at=0.8)]
    times = np.linspace(0, 1, 1001)
    at, axes = smooth_way(np.zeros((2, 3)), way, times)
    speed = np.linalg.norm(np.gradient(at, times, axis=0), axis=1)
    assert axes is None
    np.testing.assert_allclose(at[[500, 800, 1000]], [[1, 0, 0], [1, 2, 0], [1, 2, 0]], atol=1e-12)
    assert speed[[0, 500, 850]].max() < 0.03 < 1 < speed[[250, 650]].min()
    assert np.all(at[:500, 1] == 0) and np.all(at[500:, 0] == 1)
    turned = [replace(each, axis=axis) for each, axis in zip(way, ([1, 0, 0], DOWN), strict=True)]
    axes = smooth_way(np.array([[0, 0, 0], [0, 1, 0]]), turned, times)[1]
    assert axes is not None
    np.testing.assert_allclose(axes[[0, 500, 800]], [[0, 1, 0], [1, 0, 0], DOWN], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1)


def test_a_skill_goes_from_an_arm_of_a_package_to_ours(task: ArmTask) -> None:
    """Reaches of two arms with 7 and 6 joints; one that only the first shows is translated."""
    pusher = Arm(asset("gymnasium", "envs/mujoco/assets/pusher_v5.xml"), tip="tip_arml")
    tasks = [reach_task(arm) for arm in (pusher, task.arm)]
    proxies = np.array([[x, y] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
    new = np.array([[0.5, -0.6], [-0.4, 0.5]])
    source, target = (Demonstrations.from_task(each, proxies) for each in tasks)
    model = SkillTransfer(
        source, target, training=TransferTraining(n_steps=200), seed=0,
        architecture=CNMPArchitecture(encoder_arch=(32,), decoder_arch=(32,), n_members=1),
    ).fit()  # fmt: skip
    told = model.translate(Demonstrations.from_task(tasks[0], new))
    truth = Demonstrations.from_task(tasks[1], new).trajectories
    nearest = target.trajectories[[np.abs(proxies - c).sum(axis=1).argmin() for c in new]]
    errors = [np.sqrt(np.mean((each - truth) ** 2)) for each in (told.trajectories, nearest)]
    assert told.trajectory_shape == (40, 6)
    assert errors[0] < 0.05
    assert errors[0] < 0.5 * errors[1]
    misses = -tasks[1].simulate(new, told.trajectories).rewards
    assert misses.max() < 0.05


def reach_task(arm: Arm) -> ArmTask:
    middle = arm.tip_position(arm.start)

    def way(context: np.ndarray) -> list[ViaPose]:
        return [ViaPose(middle + np.array([*(0.08 * context), -0.05]))]

    return ArmTask(
        arm, way, context_names=["x", "y"], context_low=[-1, -1], context_high=[1, 1],
        n_time_points=40, n_threads=1,
    )  # fmt: skip


# -- limits ----------------------------------------------------------------------------------------


def test_derivatives_are_those_of_a_known_motion() -> None:
    dt, rate = 1e-3, 3.0
    path = np.sin(rate * dt * np.arange(2001))[None, :, None]
    for order in (1, 2, 3):
        found = np.abs(derivative(path, dt, order)[0, order:-order]).max()
        assert found == pytest.approx(rate**order, rel=1e-4)
    assert derivative(np.ones((1, 9, 1)), dt, 3).max() == 0


def test_violations_are_named_and_slowing_down_as_told_mends_them() -> None:
    t = np.linspace(0, 1, 400)
    blend = t**4 * (35 - 84 * t + 70 * t**2 - 20 * t**3)
    paths = np.stack([blend[:, None] * [0.2, 0.1], blend[:, None] * [1.0, 0.1]])
    limits, dt = MotionLimits([1.0, 5.0], 4.0, 60.0), 1.0 / 399
    shown = Demonstrations(np.zeros((2, 1)), paths)
    found = limits.violations(shown, dt, ["turn [rad]", "lift [m]"])
    assert [(v.quantity, v.name, v.unit, v.trajectory) for v in found] == [
        ("velocity", "turn", "rad/s", 1), ("acceleration", "turn", "rad/s²", 1),
    ]  # fmt: skip
    assert found[0].value == pytest.approx(2.1875, rel=1e-3)
    assert found[0].time == pytest.approx(0.5, abs=0.01)
    slower = max(v.slower for v in found)
    assert limits.violations(paths, dt * slower * 1.0001) == []
    assert limits.violations(paths, dt * slower * 0.999) != []
    for single in ({"acceleration": 1.0}, {"jerk": 1.0}):
        strict = MotionLimits(**single)
        [worst, *_] = sorted(strict.violations(paths, dt), key=lambda v: -v.slower)
        assert strict.violations(paths, dt * worst.slower * 1.0001) == []
        assert strict.violations(paths, dt * worst.slower * 0.999) != []
    with pytest.raises(TaskError, match=r"q1: velocity 2.19 /s at 0.5 s .* 2.19 times as long"):
        limits.check(paths, dt)


def test_a_motion_that_begins_or_ends_abruptly_breaks_a_limit() -> None:
    ramp = np.linspace(0, 1, 11)[:, None]
    limits = MotionLimits(velocity=1.01, acceleration=5.0)
    begins, ends = np.vstack([ramp, ramp[-1:]]), np.vstack([ramp[:1], ramp])
    assert [v.time for v in limits.violations(begins, 0.1)] == pytest.approx([0.0])
    assert limits.violations(ramp * 0.4, 0.1) == []
    assert len(limits.violations(ends, 0.1)) == 1


def test_the_expert_keeps_limits_or_says_what_it_breaks(task: ArmTask) -> None:
    hurried = peg_task(limits=MotionLimits(velocity=[9, 1.0, 9, 9, 9, 9]))
    with pytest.raises(TaskError, match=r"shoulder: velocity .* rad/s .* the limit is 1\..* times"):
        hurried.demonstrate(CONTEXTS[0])
    calm = peg_task(limits=MotionLimits(velocity=[9, 1.0, 9, 9, 9, 9]), duration=6.0)
    assert calm.simulate(CONTEXTS[0], calm.demonstrate(CONTEXTS[0])).successes[0]


# -- wrong use -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"path": "nowhere.xml"}, "no MJCF file 'nowhere.xml'"),
        ({"tip": "claw"}, "no site, body or geom 'claw'; there are peg_tip"),
        ({"tip": "table"}, "no joint lies between the world and 'table'"),
        ({"joints": ["knee"]}, "'knee' is no joint between .*; there are turn, shoulder"),
        ({"joints": ["turn", "turn"]}, "name each once"),
        ({"start": [0.0, 1.0]}, r"start has shape \(2,\); 6 numbers"),
        ({"start": [9.0, 0, 1, 0, 0, 0]}, r"'turn' begins at 9; its range is \[-2.8, 2.8\]"),
        ({"ranges": {"knee": (0, 1)}}, "ranges names 'knee'"),
        ({"ranges": {"turn": (1, -1)}}, r"range is \[1, -1\]"),
        ({"path": None}, "path is None; it must be the path of an MJCF file"),
        ({"joints": "turn"}, "joints is 'turn'; it must be a list of texts"),
        ({"joints": 3}, "joints is 3; it must be a list of texts"),
        ({"start": [9.0, 0, 1, 0, 0, 0]}, r"give another start, or ranges=\{'turn': \(a, b\)\}"),
        ({"start": [np.nan, 0, 1, 0, 0, 0]}, r"start is \[nan, .* 6 finite numbers"),
        ({"start": "home"}, "start is 'home'; it must be 6 finite numbers"),
        ({"start": [[0], [1, 2]]}, r"start is \[\[0\], \[1, 2\]\]; it must be 6 finite"),
        ({"ranges": {"turn": 1}}, r"range of 'turn' has shape \(\); 2 numbers"),
        ({"ranges": {"turn": ("a", "b")}}, r"range of 'turn' is \('a', 'b'\); .* 2 finite"),
        ({"ranges": {"turn": (-np.inf, np.inf)}}, r"is \(-inf, inf\); it must be 2 finite"),
        ({"ranges": [(0, 1)]}, r"ranges is \[\(0, 1\)\]; it must be a dictionary"),
        ({"axis": [0, 0, 0]}, r"axis is \[0, 0, 0\]; it must be a direction"),
        ({"axis": [0, 1]}, r"axis has shape \(2,\); 3 numbers"),
        ({"axis": "z"}, "axis is 'z'; it must be 3 finite numbers"),
    ],
)
def test_arms_that_cannot_be(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(TaskError, match=message):
        Arm(**{"path": PEG_ARM, "tip": "peg_tip"} | arguments)


def test_a_file_that_is_no_mjcf_and_joints_without_range(tmp_path: Path) -> None:
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody><geom/></worldbody></mujoco>")
    with pytest.raises(TaskError, match=r"cannot make a model of .* size 0 must be positive"):
        Arm(broken, tip="x")
    broken.write_text("no xml")
    with pytest.raises(TaskError, match="MuJoCo cannot read"):
        Arm(broken, tip="x")
    joint = "<body><joint name='j' type='{}'/><geom name='tip' size='.1' mass='1'/></body>"
    for kind, message in (
        ("slide", "has no range; give ranges"),
        ("ball", "no hinge and no slide"),
    ):
        broken.write_text(f"<mujoco><worldbody>{joint.format(kind)}</worldbody></mujoco>")
        with pytest.raises(TaskError, match=message):
            Arm(broken, tip="tip")
    broken.write_text(f"<mujoco><worldbody>{joint.format('hinge')}</worldbody></mujoco>")
    around = Arm(broken, tip="tip")
    assert (around.low[0], around.high[0]) == (-np.pi, np.pi)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"context_low": [0.35]}, "context_low is .* a number for each of"),
        ({"context_low": [0.7, -0.25]}, "the low one must be smaller"),
        ({"placed": {"slot": lambda c: c}}, "placed names 'slot', which is no body"),
        ({"watched": ["ball"]}, "no body 'ball' to be watched; there are"),
        ({"duration": 0.0}, "duration is 0.0 s"),
        ({"tolerance": -1.0}, "positive numbers are needed"),
        ({"tolerance": "a"}, "tolerance is 'a' m; finite and positive numbers"),
        ({"duration": "1"}, "duration is '1' s"),
        ({"duration": np.inf}, "duration is inf s"),
        ({"n_time_points": 10.5}, "n_time_points is 10.5; it must be a whole number >= 2"),
        ({"n_threads": "two"}, "n_threads is 'two'; it must be a whole number >= 0"),
        ({"context_low": "a"}, "context_low is 'a'; it must be a number for each of"),
        ({"context_low": [-np.inf, 0.0]}, r"context_low is \[-inf, 0.0\] .* finite"),
        ({"context_names": "hole x [m]"}, "context_names is 'hole x .* a list of texts"),
        ({"watched": "hole"}, "watched is 'hole'; it must be a list of texts"),
        ({"placed": ["hole"]}, r"placed is \['hole'\]; it must be a dictionary"),
        ({"placed": {"hole": [0, 0, 0]}}, r"placed\['hole'\] is \[0, 0, 0\]; .* a function of"),
        (
            {"placed": {"hole": lambda c: c}},
            r"placed\['hole'\] returns has shape \(2,\); 3 numbers",
        ),
        ({"placed": {"hole": lambda c: [0, 0, np.nan]}}, "3 finite numbers"),
        ({"limits": 3.0}, "limits is 3.0; it must be MotionLimits or None"),
        ({"limits": MotionLimits(velocity=[1, 2])}, r"velocity has shape \(2,\); give one number"),
        (
            {"context_low": [4.0, 4.0], "context_high": [5.0, 5.0]},
            r"out of reach in the context \[4.0, 4.0\].* peg_tip comes at most 1\.",
        ),
    ],
)
def test_tasks_that_cannot_be(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(TaskError, match=message):
        peg_task(**arguments)


@pytest.mark.parametrize(
    ("way", "message"),
    [
        ([], "at least one"),
        ([ViaPose([0, 0, 0], at=0.5), ViaPose([0, 0, 0], at=0.5)], "the times must rise"),
        ([ViaPose([0, 0, 0], at=1.5)], r"lie in \(0, 1\]"),
        ([ViaPose([0, 0])], "position is .* 3 finite numbers"),
        ([ViaPose([0, 0, 0], at=0.5, axis=DOWN), ViaPose([0, 0, 0])], "to all or none"),
        ([ViaPose([0, 0, 0], counts=False)], "no via-pose counts"),
        (ViaPose([0, 0, 0]), "the way is ViaPose.* a list of ViaPose"),
        (None, "the way is None; it must be a list"),
        ([ViaPose("abc")], "position is 'abc'; it must be 3 finite numbers"),
        ([ViaPose([0, 0, 0], axis=[0, 0, 0])], r"axis is \[0, 0, 0\]; give a direction"),
        ([ViaPose([0, 0, 0], at="1")], "at is '1'; it must be a number > 0"),  # type: ignore[arg-type]
        ([ViaPose([0, 0, 0], at=np.nan)], "at is nan; it must be a number > 0"),
        ([ViaPose([0, 0, 0], tolerance=-1.0)], "tolerance is -1.0; it must be a number > 0"),
    ],
)
def test_ways_that_lead_nowhere(way: Any, message: str) -> None:
    with pytest.raises(TaskError, match=message):
        check_way(way)


@pytest.mark.parametrize(
    ("way", "message"),
    [
        ([ViaPose([0.5, 0, 0.1])], "way is .* a function of the context"),
        (lambda hole: [ViaPose([hole[5], 0, 0])], r"way raised IndexError .* shape \(2,\)"),
        (lambda hole: None, "the way is None"),
    ],
)
def test_a_way_is_asked_before_any_work_begins(way: Any, message: str) -> None:
    with pytest.raises(TaskError, match=message):
        ArmTask(
            Arm(PEG_ARM, tip="peg_tip", start=START), way, context_names=["x [m]", "y [m]"],
            context_low=[0.35, -0.25], context_high=[0.6, 0.25],
        )  # fmt: skip


def test_the_reach_is_an_upper_bound_and_joints_of_another_number_are_refused() -> None:
    arm = Arm(PEG_ARM, tip="peg_tip", start=START)
    base, reach = arm.reach()
    drawn = np.random.default_rng(0).uniform(arm.low, arm.high, (300, arm.n_joints))
    far = [float(np.linalg.norm(arm.tip_position(joints) - base)) for joints in drawn]
    assert 0.9 * reach < max(far) <= reach
    with pytest.raises(TaskError, match=r"joints has shape \(1,\); 6 numbers"):
        arm.tip_position([0.0])


def test_what_is_out_of_reach_and_an_expert_that_is_not_installed(
    task: ArmTask, monkeypatch: pytest.MonkeyPatch
) -> None:
    far = peg_task(context_high=[1.5, 0.25])
    with pytest.raises(TaskError, match=r"comes no nearer to \[1.4, 0.0, .* out of the reach"):
        far.demonstrate([1.4, 0.0])
    monkeypatch.setitem(sys.modules, "mink", None)
    with pytest.raises(TaskError, match=r"pip install sb3-nmp\[robots\]"):
        peg_task().demonstrate(CONTEXTS[0])


@pytest.mark.parametrize(
    ("limits", "path", "message"),
    [
        ({"velocity": 0.0}, None, "velocity is 0.0; it must be positive"),
        ({"jerk": [1.0, -1.0]}, None, "jerk is .* must be positive"),
        ({"velocity": [1.0] * 3}, np.zeros((5, 2)), r"shape \(3,\); give one number, or one for"),
        ({"velocity": 1.0}, np.zeros(5), r"shape \(5,\); \(N, T, D\)"),
        ({"velocity": 1.0}, np.full((5, 2), np.nan), "trajectory 0 holds nan at time point 0"),
        ({"velocity": "fast"}, None, "velocity is 'fast'; it must be positive"),
        ({"velocity": 1.0}, "a", "trajectory is 'a'; it must be numbers"),
    ],
)
def test_limits_that_cannot_be_checked(limits: Any, path: Any, message: str) -> None:
    with pytest.raises((TaskError, InvalidTrajectoryError), match=message):
        MotionLimits(**limits).violations(path, 0.1)
    with pytest.raises(TaskError, match=r"dt is 0.0"):
        MotionLimits(velocity=1.0).violations(np.zeros((5, 2)), 0.0)
    with pytest.raises(TaskError, match="1 names were given for 2"):
        MotionLimits(velocity=1.0).violations(np.zeros((5, 2)), 0.1, ["a"])
