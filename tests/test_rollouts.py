"""The info keys that algorithms read, against what every registered task's environment tells."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from benchmark_envs import TrajectoryEnv, make_task, task_ids
from sb3_nmp import InvalidDataError
from sb3_nmp.common.rollouts import (
    ACHIEVED_CONTEXT,
    IS_SUCCESS,
    STEP_REWARDS,
    TERM_PREFIX,
    Generation,
    RolloutInfo,
)


def one_rollout(task: str) -> tuple[Any, np.ndarray, float, dict[str, Any]]:
    env = gym.make(task)
    context, _ = env.reset(seed=0)
    action = np.asarray(env.unwrapped.initial_trajectory(), np.float32)  # pyright: ignore
    _, reward, _, _, info = env.step(action)
    return context, action, float(reward), info


@pytest.mark.parametrize("task", task_ids())
def test_every_task_tells_what_algorithms_read(task: str) -> None:
    context, action, reward, info = one_rollout(task)
    assert {IS_SUCCESS, STEP_REWARDS, ACHIEVED_CONTEXT} == {*RolloutInfo.__annotations__}
    assert isinstance(info[IS_SUCCESS], bool)
    terms = {key: value for key, value in info.items() if key.startswith(TERM_PREFIX)}
    assert all(isinstance(term, float) for term in terms.values())
    if terms:
        assert sum(terms.values()) == pytest.approx(reward)
    if STEP_REWARDS in info:
        assert info[STEP_REWARDS].shape == action.shape[:1]
        assert info[STEP_REWARDS].sum() == pytest.approx(reward)

    rewards = np.array([reward, reward])
    rollouts = Generation.from_step(
        np.stack([context, context]), np.stack([action, action]), rewards, [info, info]
    )
    assert len(rollouts) == 2
    assert rollouts.successes.tolist() == [info[IS_SUCCESS]] * 2
    assert {f"{TERM_PREFIX}{name}" for name in rollouts.terms} == {*terms}
    assert (rollouts.step_rewards is not None) == (STEP_REWARDS in info)


def test_every_key_may_be_missing() -> None:
    tried = np.zeros((2, 5, 1), np.float32)
    rollouts = Generation.from_step(np.zeros((2, 1)), tried, np.arange(2.0), [{}, {}])
    assert not rollouts.successes.any()
    assert (rollouts.terms, rollouts.step_rewards) == ({}, None)


def test_parts_are_joined_and_taken_in_order() -> None:
    def part(value: float, n: int, steps: bool) -> Generation:
        info: dict[str, Any] = {"reward_a": value, "is_success": value > 1}
        info |= {"step_rewards": np.full(5, value)} if steps else {}
        tried = np.full((n, 5, 1), value, np.float32)
        return Generation.from_step(np.zeros((n, 1)), tried, np.full(n, value), [info] * n)

    whole = Generation.concatenate([part(1.0, 2, True), part(2.0, 1, True)])
    assert whole.rewards.tolist() == whole.terms["a"].tolist() == [1.0, 1.0, 2.0]
    last = whole[whole.successes]
    assert len(last) == 1 and last.step_rewards is not None
    np.testing.assert_array_equal(last.step_rewards, np.full((1, 5), 2.0))
    assert Generation.concatenate([part(1.0, 1, True), part(2.0, 1, False)]).step_rewards is None


def test_what_was_achieved_is_gathered_and_joined() -> None:
    def part(*achieved: float | None) -> Generation:
        infos = [{} if one is None else {ACHIEVED_CONTEXT: np.array([one])} for one in achieved]
        n = len(infos)
        return Generation.from_step(np.zeros((n, 1)), np.zeros((n, 5, 1), np.float32),
                                    np.zeros(n), infos)  # fmt: skip

    assert part(None, None).achieved is None
    whole = Generation.concatenate([part(None), part(0.5, None)])
    assert whole.achieved is not None
    np.testing.assert_array_equal(whole.achieved, [[np.nan], [0.5], [np.nan]])
    assert whole[np.array([1])].achieved == 0.5
    with pytest.raises(InvalidDataError, match=r"shape \(2,\) .* it must be a context.*\(1,\)"):
        Generation.from_step(np.zeros((1, 1)), np.zeros((1, 5, 1), np.float32), np.zeros(1),
                             [{ACHIEVED_CONTEXT: np.zeros(2)}])  # fmt: skip


@pytest.mark.parametrize(
    ("task", "solved"), [("nmp/Push-v0", [-0.097, 0.364]), ("nmp/Pouring-v1", [900.0, 400.0])]
)
def test_a_rollout_would_have_been_right_where_it_says(task: str, solved: list[float]) -> None:
    """In the context that it achieved, the same trajectory has hardly any error."""
    physics = make_task(task, n_threads=1, **({"reward": "goal"} if "Push" in task else {}))
    shown = physics.demonstrate(solved)
    idle = physics.initial_trajectory(solved)
    achieved = physics.simulate(solved, np.stack([shown, idle])).achieved_contexts
    assert achieved is not None
    assert np.isnan(achieved[1]).all(), "nothing was moved or poured"
    again = physics.simulate(achieved[0], shown)
    assert again.successes[0] and again.rewards[0] > -1e-3 - 0.5 * ("Pouring" in task)
    env = TrajectoryEnv(physics, context=solved)
    env.reset()
    assert np.array_equal(env.step(shown.astype(np.float32))[4][ACHIEVED_CONTEXT].shape, (2,))
    env.reset()
    assert ACHIEVED_CONTEXT not in env.step(idle.astype(np.float32))[4]
