"""gymnasium-robotics' Fetch tasks as trajectory bandits, and their experts."""

import pickle
import sys
from typing import Any

import numpy as np
import pytest
from stable_baselines3.common.env_checker import check_env

from benchmark_envs import FetchExpert, TaskError, fetch_env
from benchmark_envs.wrappers.fetch import TASKS
from sb3_nmp import Demonstrations

try:
    import gymnasium_robotics  # noqa: F401

    MISSING = ""
except ImportError:
    MISSING = "gymnasium-robotics is not installed: pip install 'sb3-nmp[robotics]'"
pytestmark = [
    pytest.mark.skipif(bool(MISSING), reason=MISSING or "installed"),
    pytest.mark.filterwarnings("ignore:.*AdroitHand"),
]

SHAPES = {
    "FetchReach-v4": (3, 3),
    "FetchPush-v4": (4, 3),
    "FetchSlide-v4": (4, 3),
    "FetchPickAndPlace-v4": (5, 4),
}
FETCH = pytest.mark.parametrize("env_id", SHAPES)
SOLVED = pytest.mark.parametrize("env_id", [name for name in SHAPES if "Slide" not in name])


@FETCH
def test_a_context_is_set_whatever_was_before_to_the_last_bit(env_id: str) -> None:
    c, d = SHAPES[env_id]
    env = fetch_env(env_id)
    assert env.action_space.shape == (50, d) and env.observation_space.shape == (c,)
    assert env.tells_achievement and env.dt == pytest.approx(0.04)
    context, _ = env.reset(seed=0)
    bent = env.initial_trajectory() + 0.1 * np.sin(np.linspace(0, 6, 50))[:, None]
    outcomes = [env.step(bent)]
    env.reset(seed=1)
    for _ in range(2):
        again, _ = env.reset(options={"context": context})
        np.testing.assert_array_equal(again, context)
        outcomes.append(env.step(bent))
    for outcome in outcomes[1:]:
        assert outcome[1] == outcomes[0][1]
        first, second = (each[4]["executed_trajectory"] for each in (outcomes[0], outcome))
        np.testing.assert_array_equal(first, second)


@FETCH
def test_contexts_are_those_that_the_environment_draws(env_id: str) -> None:
    env = fetch_env(env_id)
    base: Any = env.env.unwrapped
    drawn = np.stack([env.reset(seed=seed)[0] for seed in range(60)])
    goal = list(TASKS[env_id.split("-")[0]].goal)
    np.testing.assert_allclose(base.goal[goal], drawn[-1, : len(goal)])
    space: Any = env.observation_space
    assert (drawn >= space.low).all() and (drawn <= space.high).all()
    share = np.ptp(drawn, axis=0) / (space.high - space.low)
    assert (share > 0.8).all(), "the space is no wider than what is drawn"
    if base.has_object:
        apart = np.linalg.norm(drawn[:, -2:] - base.initial_gripper_xpos[:2], axis=1)
        assert apart.min() >= 0.099
        where = base._get_obs()["achieved_goal"][:2]
        np.testing.assert_allclose(where, drawn[-1, -2:], atol=1e-6)


@SOLVED
def test_the_expert_succeeds_and_what_it_achieved_is_the_goal(env_id: str) -> None:
    expert, env = FetchExpert(env_id), fetch_env(env_id)
    shown = Demonstrations.from_task(expert, 4, seed=0)
    n_goal = len(TASKS[env_id.split("-")[0]].goal)
    for context, trajectory in zip(shown.contexts, shown.trajectories, strict=True):
        env.reset(options={"context": context})
        _, reward, *_, info = env.step(trajectory)
        assert info["is_success"] and -0.05 < reward <= 0
        if "achieved_context" in info:
            miss = np.linalg.norm((info["achieved_context"] - context)[:n_goal])
            assert miss == pytest.approx(-reward, abs=2e-3)
            rest = context[n_goal:].astype(np.float32)
            np.testing.assert_array_equal(info["achieved_context"][n_goal:], rest)
    still = env.reset(options={"context": shown.contexts[0]})[0]
    _, reward, *_, info = env.step(env.initial_trajectory())
    assert not info["is_success"], still


def test_sparse_rewards_other_settings_and_the_checker() -> None:
    env = fetch_env("FetchReach-v4", reward_type="sparse")
    env.reset(seed=0)
    assert env.step(env.initial_trajectory())[1] in (-1.0, 0.0)
    check_env(fetch_env("FetchReach-v4"), warn=False)


@pytest.mark.parametrize("env_id", ["FetchRech-v4", "Pendulum-v1"])
def test_other_environments_are_told(env_id: str) -> None:
    with pytest.raises(TaskError, match="is no Fetch task; there are FetchReach, FetchPush"):
        fetch_env(env_id)


def test_a_missing_library_and_a_missing_expert_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(TaskError, match="no expert for FetchSlide-v4"):
        FetchExpert("FetchSlide-v4")
    with pytest.raises(TaskError, match="no mode 'fast'"):
        FetchExpert("FetchReach-v4").demonstrate(np.zeros(3), "fast")
    monkeypatch.setitem(sys.modules, "gymnasium_robotics", None)
    with pytest.raises(TaskError, match=r"pip install 'sb3-nmp\[robotics\]'"):
        fetch_env("FetchReach-v4")


def test_another_type_of_reward_is_refused() -> None:
    """The environment itself takes any for dense."""
    with pytest.raises(TaskError, match="reward_type is 'shaped'; it must be 'dense' or 'sparse'"):
        fetch_env("FetchReach-v4", reward_type="shaped")


@pytest.mark.parametrize("env_id", ["FetchReach-v4", "FetchPickAndPlace-v4"])
def test_a_pickled_environment_begins_anew_and_does_the_same(env_id: str) -> None:
    env = fetch_env(env_id)
    context, _ = env.reset(seed=0)
    copy = pickle.loads(pickle.dumps(env))
    with pytest.raises(TaskError, match="call reset"):
        copy.step(np.zeros(SHAPES[env_id][1]) + np.zeros((50, 1)))
    copy.reset(options={"context": context})
    env.reset(options={"context": context})
    trajectory = env.initial_trajectory()
    assert np.array_equal(copy.initial_trajectory(), trajectory)
    assert copy.step(trajectory)[1] == env.step(trajectory)[1]
