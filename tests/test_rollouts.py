"""The info keys that algorithms read, against what every registered task's environment tells."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from benchmark_envs import task_ids
from sb3_nmp.common.rollouts import IS_SUCCESS, STEP_REWARDS, TERM_PREFIX, Generation, RolloutInfo


def one_rollout(task: str) -> tuple[Any, np.ndarray, float, dict[str, Any]]:
    env = gym.make(task)
    context, _ = env.reset(seed=0)
    action = np.asarray(env.unwrapped.initial_trajectory(), np.float32)  # pyright: ignore
    _, reward, _, _, info = env.step(action)
    return context, action, float(reward), info


@pytest.mark.parametrize("task", task_ids())
def test_every_task_tells_what_algorithms_read(task: str) -> None:
    context, action, reward, info = one_rollout(task)
    assert {IS_SUCCESS, STEP_REWARDS} == {*RolloutInfo.__annotations__}
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
