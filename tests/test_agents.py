"""PPO, SAC and ARS as rows: budgets, callbacks, what `predict` answers, and bad input."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv

from benchmark_envs import TrajectoryVecEnv
from results.agents import ARS, PPO, SAC, PrimitiveAgent
from results.algorithms import ARS as ARS_ROW
from results.exceptions import BenchmarkError
from results.harness.runner import execute
from results.harness.specification import RunSpecification
from results.one_context.protocol import OneContext

pytest.importorskip("sb3_contrib", reason="the extra 'contrib' is not installed")
ENV = "nmp/ViaPoints-v0"
EVERY = pytest.mark.parametrize("algorithm", [PPO, SAC, ARS])


class Seen(BaseCallback):
    """Keeps what each step gave, and the greedy answer before it."""

    def __init__(self, stop_after: int | None = None) -> None:
        super().__init__()
        self.rewards: list[float] = []
        self.answers: list[np.ndarray] = []
        self.stop_after = stop_after

    def _on_rollout_start(self) -> None:
        context = np.asarray(self.training_env.reset())[0] if not self.answers else self.context
        self.context = context
        self.answers.append(self.model.predict(context, deterministic=True)[0])

    def _on_step(self) -> bool:
        self.rewards.extend(self.locals["rewards"])
        assert all("is_success" in info for info in self.locals["infos"])
        return self.stop_after is None or len(self.rewards) < self.stop_after


def env(n_envs: int = 1) -> Any:
    context = gym.make(ENV).reset(seed=0)[0]
    return make_vec_env(
        ENV, n_envs=n_envs, vec_env_cls=TrajectoryVecEnv, env_kwargs={"context": context}
    )


def run(algorithm: type[PrimitiveAgent], budget: int, seed: int = 0, **more: Any) -> Any:
    seen = Seen(more.pop("stop_after", None))
    model = algorithm("MlpPolicy", env(), seed=seed, **more).learn(budget, callback=seen)
    return model, seen


@EVERY
def test_the_budget_is_kept_exactly_and_the_policy_answers_with_trajectories(
    algorithm: type[PrimitiveAgent],
) -> None:
    model, seen = run(algorithm, 47)
    assert model.num_timesteps == len(seen.rewards) == len(seen.answers) == 47
    context = seen.context
    one = model.predict(context, deterministic=True)[0]
    many = model.predict(np.stack([context] * 2), deterministic=True)[0]
    assert one.shape == model.get_env().action_space.shape
    assert model.get_env().action_space.contains(one)
    assert_allclose(many[0], one, atol=1e-6)
    assert_allclose(model.policy.own_answer(context[None])[0], one, atol=1e-6)
    assert not np.array_equal(seen.answers[0], one)  # it has learned something


@EVERY
def test_a_callback_stops_the_run(algorithm: type[PrimitiveAgent]) -> None:
    model, seen = run(algorithm, 47, stop_after=13)
    assert model.num_timesteps == len(seen.rewards) == 13


@EVERY
def test_equal_seeds_give_equal_runs(algorithm: type[PrimitiveAgent]) -> None:
    rewards = [run(algorithm, 30, seed)[1].rewards for seed in (1, 1, 2)]
    assert rewards[0] == rewards[1] != rewards[2]


def test_ppo_gets_better_with_rollouts() -> None:
    _, seen = run(PPO, 400, n_bases=5)
    assert np.mean(seen.rewards[-50:]) > np.mean(seen.rewards[:50])


def test_a_run_under_the_harness_says_what_it_sees() -> None:
    specification = RunSpecification("ARS", ARS_ROW, "nmp/Bottles-v0", 0, 12, OneContext())
    result = execute(specification)
    assert result.sees == ("reward",)
    assert result.measured.curve["rollouts"] == list(range(1, 13))
    assert "own" in result.measured.rollouts


def test_another_vec_env_is_refused() -> None:
    with pytest.raises(BenchmarkError, match="PPO runs on a TrajectoryVecEnv, not on a DummyVec"):
        PPO("MlpPolicy", DummyVecEnv([lambda: gym.make(ENV)]))
