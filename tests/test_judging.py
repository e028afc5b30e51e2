"""RC-NMP's reward model in one context: it sees the better candidates, and the search uses it."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from numpy.typing import NDArray

from baselines import GA
from benchmark_envs import make_task
from benchmark_envs.tasks.bottles import BOTTLES
from sb3_nmp import RCNMP, ConfigurationError, RCNMPRewardModel, RCNMPTraining
from sb3_nmp.common.buffer import TrajectoryBuffer
from sb3_nmp.common.judging import Wanted, features
from sb3_nmp.common.niches import View
from sb3_nmp.common.noise import SmoothNoise
from sb3_nmp.common.operators import take_turns
from sb3_nmp.rcnmp.reward_model import judge, success_and_score

ENV_ID = "nmp/Bottles-v0"
QUICK: dict[str, Any] = {"population_size": 10, "n_crossover": 6, "training": RCNMPTraining(3)}


def curves(n: int, seed: int) -> NDArray[np.float64]:
    return SmoothNoise(n_bases=6).sample(np.random.default_rng(seed), n, (50, 1))


def reward(trajectories: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance from a curve that is nowhere shown."""
    target = np.sin(np.linspace(0, 3, 50))[:, None]
    return -np.abs(trajectories - target).mean(axis=(1, 2))


def asked(buffer: TrajectoryBuffer, candidates: NDArray[np.float64]) -> NDArray[np.float64]:
    view = View(buffer.rewards, buffer.successes, 20, 1)
    generator = th.Generator().manual_seed(0)
    return judge(buffer.trajectories, view, candidates, RCNMPRewardModel(), generator)


def filled(n: int, least: float) -> TrajectoryBuffer:
    buffer, shown = TrajectoryBuffer(1, (50, 1)), curves(n, 0)
    rewards = reward(shown)
    buffer.add(np.zeros((n, 1)), shown, rewards, rewards > np.quantile(rewards, least))
    return buffer


@pytest.mark.parametrize("least", [0.99, 0.6], ids=["hardly any success", "many successes"])
def test_candidates_that_it_prefers_are_better_than_drawn_ones(least: float) -> None:
    candidates = curves(400, 1)
    told = asked(filled(150, least), candidates)
    assert told.shape == (5, 400)
    earned = reward(candidates)
    chosen = earned[take_turns(told, 20)]
    assert chosen.mean() > np.quantile(earned, 0.85), "asked for the best, not for any or the worst"
    for member in told:
        assert np.corrcoef(member, earned)[0, 1] > 0.5


def test_successes_count_more_than_rewards() -> None:
    """Half of the curves fail whatever their reward: those on one side at the end."""
    buffer, shown = TrajectoryBuffer(1, (50, 1)), curves(150, 0)
    right = shown[:, -1, 0] > 0
    buffer.add(np.zeros((150, 1)), shown, reward(shown), right)
    candidates = curves(400, 1)
    told = asked(buffer, candidates)
    chosen = candidates[take_turns(told, 20)]
    assert (chosen[:, -1, 0] > 0).mean() >= 0.6, "by the score alone: none"


@pytest.mark.parametrize("least", [0.99, 0.6], ids=["hardly any success", "many successes"])
def test_gaussian_processes_prefer_better_candidates_too(least: float) -> None:
    buffer, candidates = filled(150, least), curves(400, 1)
    twin = GA("MlpPolicy", ENV_ID, n_candidates=10)
    twin.replay_buffer = buffer
    told = twin._promise(candidates, View(buffer.rewards, buffer.successes, 20, 1))
    assert told.shape == (1, 400)
    earned = reward(candidates)
    assert earned[take_turns(told, 20)].mean() > np.quantile(earned, 0.85)


def test_among_successes_both_judges_prefer_those_of_larger_reward() -> None:
    """All succeed, so that only the score tells them apart."""
    buffer, shown, candidates = TrajectoryBuffer(1, (50, 1)), curves(150, 0), curves(400, 1)
    buffer.add(np.zeros((150, 1)), shown, reward(shown), np.ones(150, bool))
    twin = GA("MlpPolicy", ENV_ID, n_candidates=10)
    twin.replay_buffer = buffer
    told = twin._promise(candidates, View(buffer.rewards, buffer.successes, 20, 1))
    earned = reward(candidates)
    for judged in (told, asked(buffer, candidates)):
        assert earned[take_turns(judged, 20)].mean() > np.quantile(earned, 0.85)


def test_the_wanted_reward_is_that_of_the_best_success() -> None:
    rewards = np.array([-5.0, -4.0, -3.0, -2.0, -1.0, 0.0])
    wanted = Wanted.of(rewards, np.array([True] * 5 + [False]))
    assert wanted.score[4] == 0.0, "not the worst one's, nor a failure's"
    assert (np.diff(wanted.score) > 0).all()


def test_the_score_of_a_failure_teaches_nothing() -> None:
    predicted = th.tensor([[[0.3, 1.0]]], requires_grad=True)
    success_and_score(predicted, th.tensor([[[0.0, 5.0]]])).backward()
    assert predicted.grad is not None
    assert predicted.grad[0, 0, 1] == 0.0 and predicted.grad[0, 0, 0] > 0.0
    success_and_score(predicted, th.tensor([[[1.0, 5.0]]])).backward()
    assert predicted.grad[0, 0, 1] < 0.0


def test_few_successes_are_judged_by_place() -> None:
    rewards = np.array([-3.0, -1.0, -2.0])
    few = Wanted.of(rewards, np.array([False, True, False]))
    assert not few.is_split
    np.testing.assert_array_equal(few.score, [-1.0, 1.0, 0.0])
    same = Wanted.of(np.full(8, -2.0), np.ones(8, bool))
    assert same.is_split and (same.score == 0.0).all()


def test_features_have_one_unit_a_dimension() -> None:
    known = np.random.default_rng(0).normal([3.0, -5.0], [0.1, 40.0], (30, 200, 2))
    seen, asked = features(known, known[:4])
    np.testing.assert_allclose(seen[:4], asked)
    assert seen.mean() == pytest.approx(0.0, abs=1e-9)
    assert seen[:, ::2].std() == pytest.approx(1.0) and seen[:, 1::2].std() == pytest.approx(1.0)


@pytest.mark.parametrize("algorithm", [RCNMP, GA])
def test_what_is_executed_are_the_most_promising_candidates(algorithm: Any) -> None:
    settings: dict[str, Any] = (
        QUICK if algorithm is RCNMP else {"population_size": 10, "n_crossover": 6}
    )
    seen: list[NDArray[np.float64]] = []

    def promise(trajectories: NDArray[np.float64], view: View) -> NDArray[np.float64]:
        assert view.n == 8
        seen.append(trajectories)
        return -np.abs(trajectories[:, 100, :1]).T  # nearest to x = 0

    model = algorithm("MlpPolicy", ENV_ID, seed=0, n_explorers=2, n_candidates=5, **settings)
    model._promise = promise
    model.learn(20)
    assert [len(rows) for rows in seen] == [8 * 5]
    kept = model.replay_buffer.trajectories[12:]
    wanted = np.sort(np.abs(seen[0][:, 100, 0]))[:8]
    np.testing.assert_allclose(np.sort(np.abs(kept[:, 100, 0])), wanted, atol=1e-6)


def test_judged_searches_find_better_paths_than_unjudged_ones() -> None:
    """Via-points: the sum over runs of the best distance; a judge of the wrong sign is seen."""
    task = make_task("nmp/ViaPoints-v0", n_points=3)
    found = {}
    for n_candidates in (1, 8):
        best = []
        for seed in (1000, 1001, 1002):
            context = task.sample_context(np.random.default_rng(seed))
            model = RCNMP(
                "MlpPolicy",
                gym_env(context),
                seed=seed,
                pd_controller=None,
                n_candidates=n_candidates,
                training=RCNMPTraining(10),
            ).learn(120)
            best.append(model.replay_buffer.rewards.max())
        found[n_candidates] = np.mean(best)
    assert found[8] > found[1]


def gym_env(context: NDArray[np.float64]) -> Any:
    return gym.make("nmp/ViaPoints-v0", n_points=3, context=context)


def test_the_best_answer_is_a_success_if_there_is_one() -> None:
    """Without the PD controller, ending short of the goal pays in reward and is no success."""
    for algorithm in (RCNMP, GA):
        model: Any = algorithm("MlpPolicy", ENV_ID, seed=0)
        context = BOTTLES.astype(np.float32)
        expert = make_task(ENV_ID).demonstrate(BOTTLES)
        short = np.full_like(expert, 0.5)
        model.policy.elites.update(
            np.stack([context, context]),
            np.stack([expert, short]),
            np.array([-0.2, -0.1]),
            np.array([True, False]),
        )
        answer, _ = model.predict(context, deterministic=True)
        np.testing.assert_allclose(answer, expert, atol=1e-6)


def test_a_number_of_candidates_below_one_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="n_candidates is 0; it must be >= 1"):
        RCNMP("MlpPolicy", ENV_ID, n_candidates=0)
