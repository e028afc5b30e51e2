"""Pick-and-place with object and goal anywhere on a field: layout, expert, rewards, bounds."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv

from benchmark_envs import InvalidContextError, TrajectoryVecEnv, make_task
from benchmark_envs.tasks.pick_and_place import PickAndPlaceTask
from benchmark_envs.tasks.pick_and_place_expert import (
    ALONG,
    CLEARANCE,
    HOME,
    inverse_kinematics,
    needed_height,
    tool_path,
)
from benchmark_envs.tasks.pick_and_place_layout import (
    FIELD,
    HALF_GRIPPER,
    HALF_OBJECT,
    HALF_TOWER,
    HIGHEST,
    LOWEST,
    OBJECT,
    PLACE,
    ROOM,
    Layout,
)
from benchmark_envs.tasks.pick_and_place_measures import CARRY, CLOSES, OPENS, T, avoidance_error

#: object x, y, goal x, y, heights of object and tower, in m: away from the arm, and aslant
SLANTED = np.array([0.52, 0.11, 0.70, -0.05, 0.06, 0.08])


def field(n_threads: int | None = None) -> PickAndPlaceTask:
    task = make_task("nmp/PickAndPlace-v1", n_threads=n_threads, field=True)
    assert isinstance(task, PickAndPlaceTask)
    return task


@pytest.fixture(scope="module")
def task() -> PickAndPlaceTask:
    return field()


def drawn(task: PickAndPlaceTask, n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([task.sample_context(rng) for _ in range(n)])


def planned(context: np.ndarray, offset: list[float], phase: slice) -> np.ndarray:
    """The expert's trajectory with the tool moved aside in a phase."""
    path = tool_path(context, T)
    path[phase] += offset
    return inverse_kinematics(path)


# -- where things are ----------------------------------------------------------------------------


def test_heights_alone_lay_out_the_thesis_arrangement_to_the_last_bit() -> None:
    layout = Layout.of([[0.06, 0.08], [0.02, 0.11]])
    np.testing.assert_array_equal(layout.objects, [OBJECT, OBJECT])
    np.testing.assert_array_equal(layout.places, [PLACE, PLACE])
    np.testing.assert_array_equal(layout.towers, [[0.62, 0.0]] * 2)
    np.testing.assert_array_equal(layout.directions, [[0.0, 1.0]] * 2)
    np.testing.assert_array_equal(layout.turns, [0.0, 0.0])
    edge = HALF_TOWER + HALF_OBJECT
    np.testing.assert_array_equal(layout.crossings[0], [[0.62, -edge], [0.62, 0.0], [0.62, edge]])
    default = make_task("nmp/PickAndPlace-v1")
    assert default.settings == {"field": False} and not default.tells_achievement
    assert len(default.context_names) == 2 and default.context_space.shape == (2,)


def test_the_tower_stands_midway_and_across_the_way(task: PickAndPlaceTask) -> None:
    layout = Layout.of(SLANTED[None])
    way = SLANTED[2:4] - SLANTED[:2]
    np.testing.assert_allclose(layout.towers[0], [0.61, 0.03])
    np.testing.assert_allclose(layout.directions[0], way / np.linalg.norm(way))
    model, state = task._model(SLANTED), task._initial_state(SLANTED)
    address = 1 + model.joint("tower").qposadr[0]  # after the time
    w, x, y, z = state[address + 3 : address + 7]
    thin = np.array([2 * (x * y - w * z), 1 - 2 * (x**2 + z**2)])  # the tower's y axis
    np.testing.assert_allclose(thin, layout.directions[0], atol=1e-12)
    np.testing.assert_allclose(state[address : address + 3], [0.61, 0.03, 0.04])
    np.testing.assert_allclose(model.geom("place").pos[:2], SLANTED[2:4])
    assert 2 * model.geom("object").size[2] == pytest.approx(0.06)


@pytest.mark.parametrize("angle", [0, 20, 45, 90, 135, 200, 290])
def test_the_crossings_are_where_the_edges_of_object_and_tower_meet(angle: float) -> None:
    """Of a square that keeps its sides, the foremost corner reaches the tower's face there."""
    way = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    middle = FIELD.mean(axis=0)
    ends = np.concatenate([middle - 0.14 * way, middle + 0.14 * way])
    layout = Layout.of([[*ends, 0.05, 0.05]])
    corners = HALF_OBJECT * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    for crossing, side in zip(layout.crossings[0, [0, 2]], (-1.0, 1.0), strict=True):
        nearest = np.min(side * ((crossing + corners - middle) @ way))
        assert nearest == pytest.approx(HALF_TOWER)
    np.testing.assert_allclose(layout.crossings[0, 1], middle)
    gripper = HALF_GRIPPER * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    free = np.min(-((ends[:2] + gripper - middle) @ way)) - HALF_TOWER
    assert layout.room[0] == pytest.approx(free)


def test_object_and_goal_are_drawn_everywhere_with_room_for_the_gripper(
    task: PickAndPlaceTask,
) -> None:
    contexts = drawn(task, 2000)
    layout = Layout.of(contexts)
    assert layout.room.min() >= ROOM - 1e-6
    for points in (layout.objects, layout.places):
        cells = np.histogram2d(*points.T, bins=4, range=FIELD.T.tolist())[0]  # pyright: ignore[reportArgumentType]
        assert cells.min() > 0.2 * len(points) / 16
    counts = np.histogram2d(*layout.objects.T, bins=4, range=FIELD.T.tolist())[0]  # pyright: ignore[reportArgumentType]
    assert np.abs(counts - 125).max() < 5 * np.sqrt(125), "the object is drawn uniformly"
    np.testing.assert_allclose(contexts[:, 4:].min(axis=0), LOWEST, atol=1e-3)
    np.testing.assert_allclose(contexts[:, 4:].max(axis=0), HIGHEST, atol=1e-3)


@pytest.mark.parametrize(
    ("context", "message"),
    [
        ([0.60, 0.0, 0.60, 0.1, 0.05, 0.05], r"0\.100 m apart, but .* at least 0\.189 m"),
        ([0.55, 0.0, 0.67, 0.0, 0.05, 0.05], r"0\.120 m apart, but .* at least 0\.128 m"),
        ([0.62, 0.0, 0.62, 0.0, 0.05, 0.05], r"0\.000 m apart, but .* at least 0\.189 m"),
        ([0.40, 0.0, 0.67, 0.0, 0.05, 0.05], r"entry 0 \(object x \[m\]\) is 0\.4, but"),
        ([0.5, 0.0, 0.67, 0.2, 0.05, 0.05], r"entry 3 \(goal y \[m\]\) is 0\.2, but"),
        ([0.5, 0.0, 0.67, 0.0, 0.05, 0.15], r"entry 5 \(tower height \[m\]\) is 0\.15, but"),
        ([0.05, 0.05], r"has shape \(6,\) \(object x"),
    ],
)
def test_contexts_that_make_no_sense_are_refused(
    task: PickAndPlaceTask, context: list[float], message: str
) -> None:
    with pytest.raises(InvalidContextError, match=message):
        task.demonstrate(context)
    with pytest.raises(InvalidContextError, match=message):
        gym.make("nmp/PickAndPlace-v1", field=True, context=context)


def test_the_least_distance_that_is_told_is_accepted(task: PickAndPlaceTask) -> None:
    task.check_context([0.60, -0.05, 0.60, 0.1391, 0.05, 0.05])
    task.check_context([0.55, 0.0, 0.6781, 0.0, 0.05, 0.05])


# -- the expert ----------------------------------------------------------------------------------


def test_the_expert_succeeds_everywhere_at_the_best_reward(task: PickAndPlaceTask) -> None:
    x, y = FIELD.T
    corners = [
        [a, b, x[0] + x[1] - a, y[0] + y[1] - b, *heights]
        for a in x
        for b in y
        for heights in ((0.02, 0.11), (0.09, 0.11), (0.09, 0.02))
    ]
    contexts = np.concatenate([corners, drawn(task, 50)])
    expert = np.stack([task.demonstrate(context) for context in contexts])
    rollouts = task.simulate(contexts, expert)
    assert rollouts.successes.all() and not rollouts.clipped.any()
    assert rollouts.rewards.min() > -2e-3
    ends = rollouts.paths["object"][:, -1, :2]
    assert np.linalg.norm(ends - contexts[:, 2:4], axis=1).max() < 0.01


def test_the_expert_is_up_before_it_moves_over_a_tower_that_is_near(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    near = np.array([[0.55, 0.02, 0.6785, 0.02, 0.09, 0.11], [0.6, -0.09, 0.6, 0.0995, 0.09, 0.11]])
    layout = Layout.of(near)

    def lacking() -> float:
        ways = np.stack([tool_path(context, T)[CARRY] for context in near])
        return avoidance_error(ways, layout.crossings, needed_height(layout.heights)).max()

    assert lacking() < 1e-3
    monkeypatch.setattr("benchmark_envs.tasks.pick_and_place_expert.ALONG_FIELD", ALONG)
    assert lacking() > 5e-3, "the thesis's distance leaves more time"


@pytest.mark.slow
def test_the_expert_succeeds_in_99_of_100_contexts(task: PickAndPlaceTask) -> None:
    contexts = drawn(task, 500, seed=1)
    expert = np.stack([task.demonstrate(context) for context in contexts])
    assert task.simulate(contexts, expert).successes.mean() >= 0.99


# -- rewards and success -------------------------------------------------------------------------


def test_the_terms_are_the_distances_that_the_tool_is_off(task: PickAndPlaceTask) -> None:
    aside = [0.024, -0.018, 0.04]
    for name, phase in {"grasp": slice(0, CLOSES.stop), "place": slice(OPENS.start, T)}.items():
        terms = task.simulate(SLANTED, planned(SLANTED, aside, phase)).terms
        assert terms[name][0] == pytest.approx(-0.05, abs=0.01)
        assert terms["place" if name == "grasp" else "grasp"][0] > -0.005
    low = tool_path(SLANTED, T)
    shown = low.copy()
    low[:, 2] = np.minimum(low[:, 2], needed_height(SLANTED[4:]) - 0.01)
    low[: CLOSES.stop], low[OPENS.start :] = shown[: CLOSES.stop], shown[OPENS.start :]
    rollouts = task.simulate(SLANTED, inverse_kinematics(low))
    assert rollouts.terms["avoid"][0] == pytest.approx(-0.03, abs=4e-3)
    assert rollouts.successes[0] and rollouts.rewards[0] == pytest.approx(-0.03, abs=5e-3)


def test_a_detour_around_the_tower_costs_its_distance_to_the_points(
    task: PickAndPlaceTask,
) -> None:
    layout, path = Layout.of(SLANTED[None]), tool_path(SLANTED, T)
    across = np.array([-layout.directions[0, 1], layout.directions[0, 0], 0.0])
    path[CLOSES.stop : OPENS.start] += 0.03 * across
    terms = task.simulate(SLANTED, inverse_kinematics(path)).terms
    assert terms["avoid"][0] == pytest.approx(-0.09, abs=5e-3)


def test_a_solution_fails_where_the_object_or_the_goal_is_elsewhere(
    task: PickAndPlaceTask,
) -> None:
    moved = np.tile(SLANTED, (3, 1))
    moved[0, 0] -= 0.045
    moved[1, 3] -= 0.045
    moved[2, 5] = 0.11
    rollouts = task.simulate(moved, np.tile(task.demonstrate(SLANTED), (3, 1, 1)))
    assert not rollouts.successes[:2].any()
    assert not rollouts.outcomes["grasped"][0] and rollouts.terms["grasp"][0] < -0.03
    assert rollouts.outcomes["grasped"][1] and rollouts.terms["place"][1] < -0.03
    low = tool_path(SLANTED, T)
    low[CARRY, 2] = np.minimum(low[CARRY, 2], 0.12)
    hit = task.simulate(moved[2], inverse_kinematics(low))
    assert hit.outcomes["touched_tower"][0] and not hit.successes[0]
    assert hit.terms["avoid"][0] < -0.1


def test_rewards_of_wild_trajectories_stay_in_range(task: PickAndPlaceTask) -> None:
    rng = np.random.default_rng(0)
    wild = HOME + np.cumsum(rng.normal(0, 0.05, (6, T, 6)), axis=1)
    rollouts = task.simulate(drawn(task, 6), wild)
    low, high = task.reward_range
    assert ((rollouts.rewards >= low) & (rollouts.rewards <= high)).all()
    assert not rollouts.successes.any() and np.isnan(rollouts.achieved_contexts).all()  # pyright: ignore[reportArgumentType, reportCallIssue]


# -- what was achieved ---------------------------------------------------------------------------


def test_what_a_rollout_achieved_is_solved_by_it(task: PickAndPlaceTask) -> None:
    """Trajectories for other goals, executed anew in the contexts that they achieved."""
    contexts = drawn(task, 30, seed=3)
    meant = contexts.copy()
    for row, shift in zip(
        meant, np.random.default_rng(4).uniform(-0.06, 0.06, (30, 2)), strict=True
    ):
        row[2:4] = np.clip(row[2:4] + shift, FIELD[0] + 0.005, FIELD[1] - 0.005)
    possible = Layout.of(meant).room >= ROOM
    contexts, meant = contexts[possible], meant[possible]
    trajectories = np.stack([task.demonstrate(context) for context in meant])
    rollouts = task.simulate(contexts, trajectories)
    achieved: Any = rollouts.achieved_contexts
    known = np.isfinite(achieved).all(axis=1)
    assert known.mean() > 0.6
    np.testing.assert_allclose(achieved[known], meant[known], atol=2e-3)
    assert 0 < (known & ~rollouts.successes).sum(), "some were wrong where they were tried"
    again = task.simulate(achieved[known], trajectories[known])
    assert again.successes.all()
    assert again.rewards.min() > -CLEARANCE - 0.01


def test_nothing_is_achieved_where_the_object_is_not_carried(task: PickAndPlaceTask) -> None:
    missed = planned(SLANTED, [0.06, 0.0, 0.0], slice(0, CLOSES.stop))
    rollouts = task.simulate(SLANTED, np.stack([task.demonstrate(SLANTED), missed]))
    told = np.isfinite(rollouts.achieved_contexts).all(axis=1)  # pyright: ignore[reportArgumentType, reportCallIssue]
    np.testing.assert_array_equal(told, [True, False])
    env = gym.make("nmp/PickAndPlace-v1", field=True, context=SLANTED)
    env.reset(seed=0)
    info = env.step(task.demonstrate(SLANTED).astype(np.float32))[4]
    np.testing.assert_allclose(info["achieved_context"], SLANTED, atol=2e-3)
    assert env.unwrapped.tells_achievement  # pyright: ignore[reportAttributeAccessIssue]


def test_what_is_achieved_was_carried_high_enough_and_leaves_room(task: PickAndPlaceTask) -> None:
    right = tool_path(SLANTED, T)
    low, near = right.copy(), (SLANTED[:2] + SLANTED[2:4]) / 2
    low[CARRY, 2] = np.minimum(low[CARRY, 2], needed_height(SLANTED[4:]) - CLEARANCE)
    cases: list[tuple[np.ndarray, np.ndarray, bool]] = [
        (right, SLANTED[2:4], True),
        (right, SLANTED[2:4], False),  # not carried
        (low, SLANTED[2:4], True),  # it would touch the tower
        (right, near, True),  # no tower fits between
        (right, SLANTED[2:4] + 0.1, True),  # off the field
    ]
    tools, ends, carried = (np.array(each) for each in zip(*cases, strict=True))
    achieved: Any = task._achieved(np.tile(SLANTED, (len(cases), 1)), ends, tools, carried)
    np.testing.assert_array_equal(achieved[0], SLANTED)
    assert np.isnan(achieved[1:]).all()


# -- the contracts of tests/test_tasks.py --------------------------------------------------------


def test_a_batch_gives_the_same_bits_as_single_rollouts_on_one_and_two_threads() -> None:
    one, two = field(1), field(2)
    contexts = drawn(one, 4)
    wanted = np.stack([one.demonstrate(context) for context in contexts])
    wanted[:2] += 0.05 * np.sin(np.linspace(0, np.pi, T))[:, None]  # these miss
    batch = two.simulate(contexts, wanted)
    assert 0 < batch.successes.sum() < 4
    for i in reversed(range(4)):
        alone = one.simulate(contexts[i], wanted[i])
        assert alone.rewards[0] == batch.rewards[i]
        np.testing.assert_array_equal(alone.executed[0], batch.executed[i])
        np.testing.assert_array_equal(alone.paths["tower"][0], batch.paths["tower"][i])


def test_the_environments_keep_gymnasiums_and_sb3s_contracts() -> None:
    check_env(gym.make("nmp/PickAndPlace-v1", field=True).unwrapped, skip_render_check=True)
    settings = {"field": True, "n_threads": 1}
    batched, separate = (
        make_vec_env("nmp/PickAndPlace-v1", 3, seed=5, vec_env_cls=kind, env_kwargs=settings)
        for kind in (TrajectoryVecEnv, DummyVecEnv)
    )
    seen: Any = batched.reset()
    np.testing.assert_array_equal(seen, separate.reset())
    task = field()
    actions = np.stack([task.demonstrate(context) for context in seen]).astype(np.float32)
    steps = [env.step(actions) for env in (batched, separate)]
    for one, other in zip(*(step[:3] for step in steps), strict=True):
        np.testing.assert_array_equal(one, other)
    assert all(info["is_success"] for info in steps[0][3])
