"""RC-NMP: its ELBO, its operators, its switches, and (slow) what it reaches on the bottles."""

import math
from typing import Any

import numpy as np
import pytest
import torch as th
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.logger import configure
from torch.distributions import Normal, kl_divergence

from benchmark_envs import TrajectoryVecEnv, make_task
from benchmark_envs.tasks.bottles import BOTTLES
from sb3_nmp import (
    RCNMP,
    ConfigurationError,
    Demonstrations,
    InvalidDataError,
    PDController,
    RCNMPTraining,
    SmoothNoise,
)
from sb3_nmp.common.niches import View
from sb3_nmp.models.neural_process import NeuralProcess
from sb3_nmp.rcnmp.training import Batch, elbo

ENV_ID = "nmp/Bottles-v0"
QUICK: dict[str, Any] = {"population_size": 10, "n_crossover": 6, "training": RCNMPTraining(3)}


def learned(budget: int = 30, **settings: Any) -> RCNMP:
    return RCNMP("MlpPolicy", ENV_ID, seed=0, **(QUICK | settings)).learn(budget)


def all_of(model: RCNMP) -> View:
    """Return what all members see where one mode is looked for."""
    return model._views(10)[0]


# -- Eq. 6.2 ---------------------------------------------------------------------------------------


def some_batch(network: NeuralProcess) -> Batch:
    return Batch(
        observed_times=th.rand(3, 4),
        observed_values=th.randn(3, 4, 2),
        target_times=th.rand(3, 5),
        target_values=th.randn(3, 5, 2),
        condition=th.randn(3, 1),
        noise=th.randn(3, network.latent_dim),
    )


def test_the_bound_is_the_log_likelihood_minus_beta_times_the_divergence() -> None:
    network = NeuralProcess(2, 1, 3, [8], [8], 1, 0.5, th.nn.Tanh)
    batch = some_batch(network)
    for beta in (0.0, 0.3, 2.0):
        bound = elbo(network, batch, beta)
        assert bound.loss.item() == pytest.approx(
            (beta * bound.divergence - bound.log_likelihood).item()
        )
    encoded = network.encode(batch.observed_times, batch.observed_values, batch.condition)
    posterior = Normal(encoded.latent.mean[:, 0], encoded.latent.stddev[:, 0])
    expected = kl_divergence(posterior, Normal(th.zeros(3, 3), th.ones(3, 3))).sum(1).mean()
    th.testing.assert_close(bound.divergence, expected)
    latent = posterior.mean + posterior.stddev * batch.noise
    mean = network.decode(batch.target_times, latent, batch.condition).mean
    squares = ((batch.target_values - mean) ** 2).sum(-1).mean()
    constant = 2 * math.log(0.5 * math.sqrt(2 * math.pi))
    assert bound.log_likelihood.item() == pytest.approx(-squares.item() / 0.5 - constant, rel=1e-5)


def test_training_raises_the_bound_and_the_reward_decides_what_is_generated() -> None:
    """Trajectories whose height grows with reward: the network must give the asked height."""
    rng = np.random.default_rng(0)
    model = RCNMP("MlpPolicy", ENV_ID, seed=0, temperature=math.inf, training=RCNMPTraining(400))
    space: Any = model.action_space
    height = np.linspace(-0.1, 0.1, 60)
    line = make_task(ENV_ID).initial_trajectory(BOTTLES)
    bump = np.sin(np.linspace(0, np.pi, space.shape[0]))
    trajectories = line + height[:, None, None] * bump[:, None] * np.array([1.0, 0.0])
    trajectories += rng.normal(0, 0.002, trajectories.shape)
    contexts = np.tile(BOTTLES, (60, 1))
    model.replay_buffer.add(contexts, trajectories, height)
    model.get_env().reset()  # pyright: ignore[reportOptionalMemberAccess]
    model.set_logger(configure(None, []))
    model._train()
    seeded = th.as_tensor(contexts[:1], dtype=th.float32)
    with th.no_grad():
        asked = model.policy.generate(seeded, th.zeros(1, model.policy.latent_dim))
    assert float(asked[0, 100, 0]) - line[100, 0] > 0.04, "it asks for the best reward by itself"
    generated = []
    for reward in (-1.0, 0.0, 1.0):
        model.policy.target_reward.fill_(reward)
        with th.no_grad():
            made = model.policy.generate(seeded, th.zeros(1, model.policy.latent_dim))
        generated.append(float(made[0, 100, 0]) - line[100, 0])
    assert generated[0] < -0.04
    assert abs(generated[1]) < 0.04
    assert generated[2] > 0.04


# -- a generation ----------------------------------------------------------------------------------


def test_the_first_rollout_is_the_initial_trajectory_and_its_reward_counts() -> None:
    model = learned(10)
    line = make_task(ENV_ID).initial_trajectory(BOTTLES)
    filtered = PDController()(line[None], line[0], line[-1])[0]
    np.testing.assert_allclose(model.replay_buffer.trajectories[0], filtered, atol=1e-6)
    assert model.replay_buffer.rewards[0] == pytest.approx(-8.12, abs=0.01)
    assert len(model.replay_buffer) == 10


def test_children_come_in_pairs_with_swapped_parents_and_one_cut() -> None:
    model = learned(10)
    plan = model._draw_parents(10, 6, all_of(model))
    children, twins = slice(4, 7), slice(7, 10)
    for array in (plan.latents, plan.rows):
        np.testing.assert_array_equal(array[0, children], array[1, twins])
        np.testing.assert_array_equal(array[1, children], array[0, twins])
    np.testing.assert_array_equal(plan.cuts[children], plan.cuts[twins])
    assert (plan.cuts[:4] == 200).all() and (plan.cuts[4:] < 200).all()
    assert (plan.rows[:, :4] == -1).all(), "sampled members come from the network alone"
    model._draw_parents = lambda n, n_crossover, view: plan
    made, cut = model._offspring(10, 6, all_of(model)), int(plan.cuts[4])
    first, second = (model._parent(plan.latents[i], plan.rows[i]) for i in (0, 1))
    np.testing.assert_array_equal(made[4, :cut], first[4, :cut])
    np.testing.assert_array_equal(made[4, cut:], second[4, cut:])


def test_elite_parents_can_be_all_or_none() -> None:
    for share, stored in ((0.0, False), (1.0, True)):
        model = learned(10, elite_parents=share)
        plan = model._draw_parents(10, 6, all_of(model))
        assert ((plan.rows[:, 4:] >= 0) == stored).all()
        assert (plan.rows[:, :4] == -1).all()


def test_every_trajectory_passes_the_pd_controller_and_ends_near_the_goal() -> None:
    ends = learned(30).replay_buffer.trajectories[:, -1]
    np.testing.assert_allclose(ends, np.tile([0.5, 0.4], (30, 1)), atol=0.05)
    free = learned(30, pd_controller=None).replay_buffer.trajectories[:, -1]
    assert np.abs(free - [0.5, 0.4]).max() > 0.1


@pytest.mark.parametrize(
    "switch",
    [
        {"n_crossover": 0},
        {"n_crossover": 10},
        {"mutation": None},
        {"mutation": SmoothNoise((0.1, 0.02), n_bases=20)},
        {"mutation_rate": 1.0},
        {"n_explorers": 3},
        {"pd_controller": None},
        {"reward_conditioning": False},
        {"reward_scaling": "standardize"},
        {"temperature": math.inf},
        {"beta": 0.0},
        {"elite_parents": 0.0},
        {"buffer_size": 10, "n_elites": 0},
        {"buffer_size": 15, "n_elites": 5},
        {"policy_kwargs": {"n_frequencies": 0, "latent_dim": 2}},
    ],
    ids=str,
)
def test_every_element_can_be_switched(switch: dict[str, Any]) -> None:
    model = learned(**switch)
    assert model.num_timesteps == 30
    complete = 30 - 30 % model.population_size
    assert len(model.replay_buffer) == min(complete, switch.get("buffer_size", 30))
    same = np.array_equal(learned().replay_buffer.trajectories, model.replay_buffer.trajectories)
    assert not same, "the switch changes the search"


def test_demonstrations_seed_the_search_as_guesses_or_as_rollouts_with_rewards() -> None:
    task = make_task(ENV_ID)
    expert = task.demonstrate(BOTTLES, "s")
    shown = Demonstrations(BOTTLES[None], expert[None])
    guessed = learned(10, demonstrations=shown)
    assert guessed.replay_buffer.rewards[0] > -1

    seeded = RCNMP("MlpPolicy", ENV_ID, seed=0, **QUICK)
    rollouts = task.simulate(BOTTLES, expert)
    seeded.replay_buffer.add(rollouts.contexts, rollouts.trajectories, rollouts.rewards)
    seeded.learn(10)
    assert len(seeded.replay_buffer) == 11
    followed = seeded.replay_buffer.trajectories[1:, :, 0].mean(axis=0) - 0.5
    alike = np.corrcoef(followed, expert[:, 0] - 0.5)[0, 1]
    assert alike > 0.5, "the first generation is already made around the demonstration"


def test_greedy_predict_is_the_best_rollout_of_its_context() -> None:
    model = learned(60)
    buffer = model.replay_buffer
    greedy, _ = model.predict(BOTTLES.astype(np.float32), deterministic=True)
    np.testing.assert_allclose(greedy, buffer.trajectories[np.argmax(buffer.rewards)], atol=1e-6)


@pytest.mark.parametrize(
    ("settings", "rule"),
    [
        ({"n_crossover": 3}, "n_crossover is 3; it must be even"),
        ({"n_crossover": 12}, "n_crossover is 12; it must be even, >= 0 and at most .* of 10"),
        ({"population_size": 0, "n_crossover": 0}, "population_size is 0; it must be >= 1"),
        ({"mutation_decay": 0.0}, r"mutation_decay is 0\.0; it must be in \(0, 1\]"),
        ({"elite_parents": 1.5}, r"elite_parents is 1\.5; it must be in \[0, 1\]"),
        ({"temperature": 0.0}, r"temperature is 0\.0; it must be > 0"),
        ({"n_explorers": 99}, "less than the population"),
        ({"reward_scaling": "raw"}, "'rank' or 'standardize'"),
        ({"beta": -1.0}, ">= 0"),
        ({"buffer_size": 2, "n_elites": 3}, "cannot keep 3 elites"),
    ],
)
def test_settings_outside_their_range_are_refused(settings: dict[str, Any], rule: str) -> None:
    with pytest.raises(ConfigurationError, match=rule):
        RCNMP("MlpPolicy", ENV_ID, **(QUICK | settings))


def test_wrong_demonstrations_and_training_settings_are_refused() -> None:
    short = Demonstrations(BOTTLES[None], np.zeros((1, 100, 2)))
    with pytest.raises(InvalidDataError, match=r"has \(200, 2\); resample them"):
        learned(demonstrations=short)
    with pytest.raises(ConfigurationError, match="is a ndarray; it must be Demonstrations"):
        learned(demonstrations=np.zeros((100, 2)))
    with pytest.raises(ConfigurationError, match="batch_size is 0"):
        RCNMPTraining(batch_size=0)


# -- what it reaches (seeds that neither tuning nor the reported runs use) -----------------------


@pytest.mark.slow
def test_both_modes_appear_and_nearly_every_run_solves_the_bottles() -> None:
    task = make_task(ENV_ID)
    solved, modes, rewards = 0, set(), []
    for seed in range(500, 520):
        env = make_vec_env(ENV_ID, n_envs=20, vec_env_cls=TrajectoryVecEnv)
        model = RCNMP("MlpPolicy", env, seed=seed).learn(400)
        greedy, _ = model.predict(BOTTLES.astype(np.float32), deterministic=True)
        rollout = task.simulate(BOTTLES, greedy)
        solved += int(rollout.successes[0])
        rewards.append(rollout.rewards[0])
        nearest = np.argmin(np.abs(greedy[:, 1] + 0.2))
        modes.add(bool(greedy[nearest, 0] > 0.5))
    assert modes == {True, False}
    assert solved >= 18
    assert np.median(rewards) > -0.14
