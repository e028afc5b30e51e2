"""The pick-and-place task: kinematics, contacts, rewards, limits, and the expert's habit."""

from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest

from benchmark_envs import InvalidContextError, TaskError, make_task
from benchmark_envs.tasks.pick_and_place import (
    FASTEST,
    JOINTS,
    SUBSTEPS,
    TIME_POINT,
    PickAndPlaceTask,
)
from benchmark_envs.tasks.pick_and_place_expert import (
    CLEARANCE,
    EXTRAPOLATION_CONTEXTS,
    GRASP_DEPTH,
    HABITUAL_HEIGHT,
    HOME,
    TOOL_LENGTH,
    carry_height,
    demonstration_contexts,
    inverse_kinematics,
    needed_height,
    tool_path,
    tool_position_at_home,
)
from benchmark_envs.tasks.pick_and_place_layout import OBJECT, PLACE, Layout
from benchmark_envs.tasks.pick_and_place_measures import CARRY, CLOSES, OPENS, T, avoidance_error
from sb3_nmp.common.noise import SmoothNoise

# of the UR10, as Universal Robots publishes them: d and a in m, alpha in degrees
DH = (
    (0.1273, 0.0, 90.0),
    (0.0, -0.612, 0.0),
    (0.0, -0.5723, 0.0),
    (0.163941, 0.0, 90.0),
    (0.1157, 0.0, -90.0),
    (0.0922, 0.0, 0.0),
)
TALL = EXTRAPOLATION_CONTEXTS[1]


def pick(n_threads: int | None = None) -> PickAndPlaceTask:
    task = make_task("nmp/PickAndPlace-v1", n_threads=n_threads)
    assert isinstance(task, PickAndPlaceTask)
    return task


@pytest.fixture(scope="module")
def task() -> PickAndPlaceTask:
    return pick()


def denavit_hartenberg(joints: np.ndarray) -> np.ndarray:
    """The flange's pose in the base's frame, shape (4, 4)."""
    pose = np.eye(4)
    for q, (d, a, alpha) in zip(joints, DH, strict=True):
        c, s = np.cos(q), np.sin(q)
        ca, sa = np.cos(np.radians(alpha)), np.sin(np.radians(alpha))
        pose = pose @ np.array(
            [
                [c, -s * ca, s * sa, a * c],
                [s, c * ca, -c * sa, a * s],
                [0.0, sa, ca, d],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
    return pose


def planned(points: np.ndarray) -> np.ndarray:
    """Trajectories whose tool follows paths of shape (..., T, 3)."""
    return inverse_kinematics(points)


def raised(context: np.ndarray, change: float, phase: slice) -> np.ndarray:
    """The expert's trajectory with the tool shifted up, smoothly, around a phase."""
    path = tool_path(context, T)
    inside = np.zeros(T)
    inside[phase] = 1.0
    path[:, 2] += change * np.convolve(inside, np.ones(15) / 15, mode="same")
    return planned(path)


# -- the model -----------------------------------------------------------------------------------


def test_the_kinematics_are_those_of_the_public_figures(task: PickAndPlaceTask) -> None:
    data = mujoco.MjData(task.model)
    for joints in [HOME, *np.random.default_rng(0).uniform(-3, 3, (20, 6))]:
        for name, value in zip(JOINTS, joints, strict=True):
            data.joint(name).qpos[0] = value
        mujoco.mj_kinematics(task.model, data)
        pose, flange = denavit_hartenberg(joints), data.body("gripper")
        np.testing.assert_allclose(flange.xpos, pose[:3, 3], atol=1e-12)
        np.testing.assert_allclose(flange.xmat.reshape(3, 3), pose[:3, :3], atol=1e-12)
        tool = pose[:3, 3] + TOOL_LENGTH * pose[:3, 2]
        np.testing.assert_allclose(data.site("tool").xpos, tool, atol=1e-12)


def test_the_context_sets_the_heights_in_the_model(task: PickAndPlaceTask) -> None:
    for context in (TALL, np.array([0.02, 0.04])):
        model = task._model(context)
        np.testing.assert_allclose(2 * model.geom("object").size[2], context[0])
        np.testing.assert_allclose(2 * model.geom("tower").size[2], context[1])
        assert model.body("object").mass[0] == pytest.approx(0.15)
    assert task._model(TALL) is task._model(TALL.copy())
    assert task.model.opt.timestep * SUBSTEPS == pytest.approx(TIME_POINT)


def test_the_cache_of_models_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmark_envs.tasks.pick_and_place.CACHED_MODELS", 2)
    task, contexts = pick(), demonstration_contexts()[:4]
    trajectories = np.stack([task.demonstrate(context) for context in contexts])
    rollouts = task.simulate(contexts, trajectories)
    assert len(task._models) == 2 and rollouts.successes.all()


def test_a_mixed_batch_gives_the_same_bits_as_single_rollouts_on_one_and_two_threads() -> None:
    contexts = np.array([[0.02, 0.11], [0.09, 0.11], [0.05, 0.06], [0.09, 0.02]])
    one, two = pick(1), pick(2)
    wanted = np.stack([one.demonstrate(context) for context in contexts])
    wanted[:2] += 0.05 * np.sin(np.linspace(0, np.pi, T))[:, None]  # some hit or miss
    batch = two.simulate(contexts, wanted)
    assert 0 < batch.successes.sum() < 4
    for i in reversed(range(4)):
        alone = one.simulate(contexts[i], wanted[i])
        assert alone.rewards[0] == batch.rewards[i]
        np.testing.assert_array_equal(alone.executed[0], batch.executed[i])
        for name in ("object", "tower", "tool"):
            np.testing.assert_array_equal(alone.paths[name][0], batch.paths[name][i])


# -- contacts ------------------------------------------------------------------------------------


def test_a_held_home_pose_leaves_everything_where_it_is(task: PickAndPlaceTask) -> None:
    rollouts = task.simulate(TALL, task.initial_trajectory(TALL))
    for name, place in (("object", [*OBJECT, 0.045]), ("tower", [0.62, 0.0, 0.055])):
        np.testing.assert_allclose(rollouts.paths[name][0], np.tile(place, (T, 1)), atol=5e-4)
    np.testing.assert_allclose(rollouts.executed[0], np.tile(HOME, (T, 1)), atol=1e-5)
    assert not any(happened.any() for happened in rollouts.outcomes.values())


def test_a_gripper_that_closes_beside_or_over_the_object_leaves_it_standing(
    task: PickAndPlaceTask,
) -> None:
    context = np.array([0.06, 0.04])
    aside = tool_path(context, T)
    aside[:, 0] += 0.06  # half an object, half a finger and more
    above = raised(context, 0.05, slice(0, CLOSES.stop + 30))
    rollouts = task.simulate(context, np.stack([planned(aside), above]))
    assert not rollouts.outcomes["grasped"].any() and not rollouts.successes.any()
    height = rollouts.paths["object"][..., 2]
    np.testing.assert_allclose(height, 0.03, atol=1e-3)
    np.testing.assert_allclose(rollouts.paths["object"][:, -1, :2], [OBJECT, OBJECT], atol=5e-3)
    assert (rollouts.terms["grasp"] < -0.04).all()


def test_an_object_is_held_through_the_carry_and_falls_if_the_gripper_opens_above_the_place(
    task: PickAndPlaceTask,
) -> None:
    context = np.array([0.06, 0.04])
    high = raised(context, 0.10, slice(OPENS.start - 40, T))
    rollouts = task.simulate(context, high)
    path = rollouts.paths["object"][0]
    held = path[CARRY] - rollouts.paths["tool"][0, CARRY]
    assert np.ptp(held, axis=0).max() < 0.005
    assert path[OPENS.start, 2] > 0.12 and path[-1, 2] < 0.05, "it fell"
    assert rollouts.outcomes["grasped"][0] and rollouts.terms["place"][0] < -0.09


def test_a_carry_at_the_habitual_height_hits_a_tall_tower_which_moves(
    task: PickAndPlaceTask,
) -> None:
    path = tool_path(TALL, T)
    path[CARRY, 2] = np.minimum(path[CARRY, 2], HABITUAL_HEIGHT)
    rollouts = task.simulate(TALL, planned(path))
    tower = rollouts.paths["tower"][0]
    assert rollouts.outcomes["touched_tower"][0] and not rollouts.successes[0]
    assert np.linalg.norm(tower[-1] - tower[0]) > 0.01, "the tower is a free body"
    assert rollouts.outcomes["grasped"][0], "it was picked up as ever"


def test_no_object_can_be_gripped_deeper_than_the_stop_allows(task: PickAndPlaceTask) -> None:
    grip = slice(CLOSES.start - 10, CLOSES.stop + 6)
    for lower in (0.005, 0.015, 0.025):
        rollouts = task.simulate(TALL, raised(TALL, -lower, grip))
        carried = slice(CARRY.start + 40, CARRY.stop - 40)
        top = rollouts.paths["object"][0, carried, 2] + TALL[0] / 2
        depth = top - rollouts.paths["tool"][0, carried, 2]
        assert rollouts.outcomes["grasped"][0]
        np.testing.assert_allclose(depth, min(GRASP_DEPTH + lower, 0.018), atol=1e-3)


def test_every_demonstration_fails_in_the_contexts_beyond_them(task: PickAndPlaceTask) -> None:
    shown = np.stack([task.demonstrate(context) for context in demonstration_contexts()])
    for context in EXTRAPOLATION_CONTEXTS:
        rollouts = task.simulate(np.tile(context, (len(shown), 1)), shown)
        assert not rollouts.successes.any()


def test_an_object_that_meets_the_tower_low_is_dropped_or_pushes_it_away(
    task: PickAndPlaceTask,
) -> None:
    context = np.array([0.09, 0.11])
    low = raised(context, -0.10, slice(CARRY.start + 20, CARRY.stop - 20))
    rollouts = task.simulate(context, low)
    moved = np.linalg.norm(rollouts.paths["tower"][0, -1] - rollouts.paths["tower"][0, 0])
    assert rollouts.outcomes["dropped"][0] or moved > 0.05
    assert rollouts.info(0)["touched_tower"] == 1.0 and not rollouts.successes[0]


# -- rewards -------------------------------------------------------------------------------------


def test_the_terms_are_the_distances_that_the_tool_is_off(task: PickAndPlaceTask) -> None:
    context, expert = np.array([0.06, 0.08]), tool_path(np.array([0.06, 0.08]), T)
    off = np.array([0.03, 0.0, 0.04])
    cases = {"grasp": slice(0, CLOSES.stop), "place": slice(OPENS.start, T)}
    for name, phase in cases.items():
        path = expert.copy()
        path[phase] += off  # a jump; only the place of the phase counts
        errors = task.simulate(context, planned(path)).terms
        assert errors[name][0] == pytest.approx(-0.05, abs=0.01)
        assert max(abs(errors[other][0]) for other in cases if other != name) < 0.005
    path = expert.copy()
    path[:, 2] = np.minimum(path[:, 2], needed_height(context) - 0.01)
    path[: CLOSES.stop], path[OPENS.start :] = expert[: CLOSES.stop], expert[OPENS.start :]
    assert task.simulate(context, planned(path)).terms["avoid"][0] == pytest.approx(-0.03, abs=3e-3)


def test_a_tilted_gripper_is_off_though_its_tool_point_is_right(task: PickAndPlaceTask) -> None:
    data = mujoco.MjData(task.model)
    trajectory = task.demonstrate(TALL)
    trajectory[:, 4] += np.radians(4) * np.clip(np.linspace(0, 6, T), 0, 1)
    rollouts = task.simulate(TALL, trajectory)
    before = rollouts.paths["object"][0, CLOSES.start - 1]
    np.testing.assert_allclose(before, [*OBJECT, TALL[0] / 2], atol=1e-3)  # not touched yet
    for name, value in zip(JOINTS, rollouts.executed[0, CLOSES.stop - 1], strict=True):
        data.joint(name).qpos[0] = value
    mujoco.mj_kinematics(task.model, data)
    wanted = np.array([*OBJECT, TALL[0] - GRASP_DEPTH])
    tool = np.linalg.norm(data.site("tool").xpos - wanted)
    flange = np.linalg.norm(data.body("gripper").xpos - wanted - [0.0, 0.0, TOOL_LENGTH])
    error = np.sqrt((tool**2 + flange**2) / 2)
    assert rollouts.terms["grasp"][0] == pytest.approx(-error, abs=1e-3)


def test_an_object_knocked_over_on_the_way_counts_where_it_lies(task: PickAndPlaceTask) -> None:
    path = tool_path(TALL, T)
    aside = path.copy()
    aside[: CLOSES.start - 10, 1] += 0.05  # a finger comes down on the object, then all is right
    rollouts = task.simulate(TALL, np.stack([planned(path), planned(aside)]))
    lying = rollouts.paths["object"][1, CLOSES.start - 1]
    assert lying[2] < TALL[0] / 2 - 0.01 or np.linalg.norm(lying[:2] - OBJECT) > 0.02
    assert rollouts.terms["grasp"][1] < -0.03 and rollouts.terms["grasp"][0] > -0.005
    assert rollouts.terms["place"][1] > -0.005 and not rollouts.successes[1]


def test_avoidance_counts_what_lacks_in_height_and_to_the_side_alone() -> None:
    y = np.linspace(-0.2, 0.2, 41)
    ways = np.stack(
        [
            np.column_stack([np.full(41, 0.62 + aside), y, np.full(41, 0.2 + up)])
            for aside, up in ((0.0, 0.0), (0.0, 0.1), (0.0, -0.03), (0.03, -0.04))
        ]
    )
    over = np.tile(Layout.of([[0.06, 0.08]]).crossings, (4, 1, 1))
    found = avoidance_error(ways, over, np.full(4, 0.2))
    np.testing.assert_allclose(found, [0.0, 0.0, 0.09, 0.15], atol=1e-12)
    coarse = avoidance_error(ways[:, ::8], over, np.full(4, 0.2))  # ways are lines, not points
    np.testing.assert_allclose(coarse, found, atol=1e-12)
    standing = np.tile([0.62, -0.2, 0.2], (1, 5, 1))
    away = avoidance_error(standing, over[:1], np.array([0.2]))
    np.testing.assert_allclose(away, 0.15 + 0.2 + 0.25)


def test_rewards_of_wild_trajectories_stay_in_range_and_finite(task: PickAndPlaceTask) -> None:
    rng = np.random.default_rng(0)
    wild = HOME + np.cumsum(rng.normal(0, 0.05, (6, T, 6)), axis=1)
    contexts = np.stack([task.sample_context(rng) for _ in range(6)])
    rollouts = task.simulate(contexts, wild)
    low, high = task.reward_range
    assert np.isfinite(rollouts.rewards).all() and not rollouts.successes.any()
    assert ((rollouts.rewards >= low) & (rollouts.rewards <= high)).all()
    np.testing.assert_allclose(sum(rollouts.terms.values()), rollouts.rewards, atol=1e-12)
    assert rollouts.step_rewards is None


def test_good_rewards_succeed_and_bad_ones_fail(task: PickAndPlaceTask) -> None:
    rng = np.random.default_rng(1)
    contexts = np.stack([task.sample_context(rng) for _ in range(50)])
    trajectories = np.stack([task.demonstrate(context) for context in contexts])
    for rows, degrees in ((slice(25), 0.4), (slice(25, 50), 4.0)):
        noise = SmoothNoise(np.radians(degrees), n_bases=4)
        trajectories[rows] += noise.sample(rng, 25, (T, len(JOINTS)))
    rollouts = task.simulate(contexts, trajectories)
    good, bad = rollouts.rewards > -0.04, rollouts.rewards < -0.15
    assert good.sum() >= 15 and rollouts.successes[good].mean() >= 0.95
    assert bad.sum() >= 15 and rollouts.successes[bad].mean() <= 0.15


# -- limits --------------------------------------------------------------------------------------


def test_set_points_are_followed_at_the_speed_limits_and_that_is_told(
    task: PickAndPlaceTask,
) -> None:
    jump = np.tile(HOME, (T, 1))
    jump[20:, 0] += 0.5
    rollouts = task.simulate(TALL, jump)
    assert rollouts.clipped[0] and rollouts.info(0)["clipped"]
    np.testing.assert_array_equal(rollouts.trajectories[0], jump)  # what was asked for
    turned = rollouts.executed[0, :, 0] - HOME[0]
    fastest = FASTEST[0] * np.arange(1, T - 19)  # since the jump
    assert (turned[20:] < fastest + 1e-3).all() and (turned[:19] < 1e-3).all()
    np.testing.assert_allclose(rollouts.executed[0, -1], jump[-1], atol=1e-3)
    expert = task.simulate(TALL, task.demonstrate(TALL))
    assert not expert.clipped[0]


@pytest.mark.parametrize(
    ("context", "message"),
    [
        ([0.10, 0.05], r"entry 0 \(object height \[m\]\) is 0.1, but must lie in \[0.02, 0.09\]"),
        ([0.01, 0.05], r"entry 0 \(object height \[m\]\) is 0.01, but"),
        ([0.05, 0.20], r"entry 1 \(tower height \[m\]\) is 0.2, but must lie in \[0.02, 0.11\]"),
    ],
)
def test_heights_that_the_gripper_cannot_take_are_refused(
    task: PickAndPlaceTask, context: list[float], message: str
) -> None:
    with pytest.raises(InvalidContextError, match=message):
        task.demonstrate(context)
    with pytest.raises(InvalidContextError, match=message):
        task.simulate(context, np.tile(HOME, (T, 1)))


def test_the_environment_tells_what_happened() -> None:
    env = gym.make("nmp/PickAndPlace-v1", context=TALL)
    env.reset(seed=0)
    expert = env.unwrapped.demonstrate(TALL)  # pyright: ignore[reportAttributeAccessIssue]
    info: dict[str, Any] = env.step(expert.astype(np.float32))[4]
    assert info["is_success"] and info["grasped"] == 1.0
    assert info["touched_tower"] == info["dropped"] == info["toppled"] == 0.0
    assert info["path_object"].shape == info["path_tower"].shape == (T, 3)


def test_chosen_rollouts_keep_their_outcomes(task: PickAndPlaceTask) -> None:
    both = np.stack([task.initial_trajectory(TALL), task.demonstrate(TALL)])
    rollouts = task.simulate(TALL, both)
    np.testing.assert_array_equal(rollouts.outcomes["grasped"], [0.0, 1.0])
    np.testing.assert_array_equal(rollouts[1].outcomes["grasped"], [1.0])
    np.testing.assert_array_equal(rollouts[[1, 0]].outcomes["grasped"], [1.0, 0.0])  # pyright: ignore[reportArgumentType]


# -- the expert ----------------------------------------------------------------------------------


def test_the_expert_succeeds_over_the_whole_grid_at_the_best_reward(
    task: PickAndPlaceTask,
) -> None:
    grid = np.array([[o, t] for o in np.linspace(0.02, 0.09, 5) for t in (0.02, 0.05, 0.08, 0.11)])
    expert = np.stack([task.demonstrate(context) for context in grid])
    rollouts = task.simulate(grid, expert)
    assert rollouts.successes.all() and not rollouts.clipped.any()
    assert rollouts.rewards.min() > -1e-3
    assert np.abs(rollouts.executed - expert).max() < np.radians(0.16)
    end = rollouts.paths["object"][:, -1]
    assert np.linalg.norm(end[:, :2] - PLACE, axis=1).max() < 0.01


def test_the_demonstrations_are_carried_at_the_habitual_height_and_the_tests_need_more() -> None:
    shown = demonstration_contexts()
    assert shown.shape == (8, 2)
    np.testing.assert_array_equal(carry_height(shown), HABITUAL_HEIGHT)
    assert (needed_height(shown) <= HABITUAL_HEIGHT).all()
    # below the tower's top, at the habitual height, by so much:
    overlap = needed_height(EXTRAPOLATION_CONTEXTS) - CLEARANCE - HABITUAL_HEIGHT
    np.testing.assert_allclose(overlap, [0.02, 0.04], atol=1e-12)
    np.testing.assert_array_equal(
        carry_height(EXTRAPOLATION_CONTEXTS), needed_height(EXTRAPOLATION_CONTEXTS)
    )


def test_inverse_kinematics_brings_the_tool_upright_to_the_points() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform([0.4, -0.4, 0.0], [0.9, 0.4, 0.5], (50, 3))
    for joints, point in zip(inverse_kinematics(points), points, strict=True):
        pose = denavit_hartenberg(joints)
        np.testing.assert_allclose(pose[:3, 2], [0, 0, -1], atol=1e-12)
        np.testing.assert_allclose(pose[:3, 0], [0, -1, 0], atol=1e-12)  # the fingers' direction
        np.testing.assert_allclose(pose[:3, 3] - [0, 0, TOOL_LENGTH], point, atol=1e-12)
    np.testing.assert_allclose(inverse_kinematics(tool_position_at_home()), HOME, atol=1e-9)


@pytest.mark.parametrize("point", [(1.4, 0.0, 0.1), (0.05, 0.05, 0.2)])
def test_points_out_of_reach_are_named(point: tuple[float, float, float]) -> None:
    with pytest.raises(TaskError, match=rf"cannot be at \[{point[0]}, {point[1]}, {point[2]}\] m"):
        inverse_kinematics(np.array([[0.6, 0.0, 0.2], point]))
