"""The weights of a movement primitive as the action: scale, faces, learning, bad input."""

import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordEpisodeStatistics
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.env_checker import check_env as sb3_check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecNormalize

from baselines import DMP, ProMP
from benchmark_envs import (
    InvalidTrajectoryError,
    MovementPrimitiveWrapper,
    TaskError,
    TrajectoryVecEnv,
    make_task,
    task_ids,
)

VIA_POINTS = "nmp/ViaPoints-v0"
PROMP = ProMP(n_bases=8, n_time_points=200)
WRAPPER: Any = (
    MovementPrimitiveWrapper  # as SB3 types its wrapper_class, it takes no wrapper_kwargs
)
DMP_8 = DMP(n_bases=8, n_time_points=200)
PRIMITIVES = pytest.mark.parametrize(
    ("primitive", "moves_goal"), [(PROMP, False), (DMP_8, False), (DMP_8, True)]
)


class Flat:
    """Its trajectories have no dimensions."""

    n_bases, n_time_points = 3, 200

    def trajectories(self, *_: Any) -> Any:
        return np.zeros((1, 2))


def wrapped(primitive: Any = PROMP, task_id: str = VIA_POINTS, **settings: Any) -> Any:
    return MovementPrimitiveWrapper(gym.make(task_id), primitive, **settings)


@pytest.mark.parametrize("task_id", task_ids())
def test_every_task_takes_weights(task_id: str) -> None:
    n_time_points, n_dimensions = make_task(task_id).trajectory_space.shape
    env = wrapped(ProMP(10, n_time_points), task_id)
    assert env.action_space.shape == (10 * n_dimensions,)
    env.reset(seed=0)
    assert env.trajectory_space.contains(env.action(env.action_space.sample()))


@pytest.mark.parametrize("task_id", [VIA_POINTS, "nmp/Bottles-v0"])
def test_the_checkers_are_content(task_id: str) -> None:
    env = wrapped(task_id=task_id)
    sb3_check_env(env, warn=False)
    assert gym.make(env.spec).action_space == env.action_space, "its spec makes it anew"
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*different from the unwrapped version")
        warnings.filterwarnings("ignore", ".*symmetric and normalized")
        check_env(env, skip_render_check=True)


@PRIMITIVES
def test_weights_of_zero_are_the_mean_and_others_explore_at_the_tasks_scale(
    primitive: Any, moves_goal: bool
) -> None:
    env = wrapped(primitive, exploration_scale=0.01, moves_goal=moves_goal)
    context, _ = env.reset(seed=1)
    mean = env.unwrapped.task.initial_trajectory(context)
    np.testing.assert_allclose(env.action(np.zeros(env.action_space.shape)), mean, atol=1e-6)
    draws = np.random.default_rng(0).standard_normal((4000, *env.action_space.shape))
    bends = np.stack([env.action(weights) for weights in draws]) - mean
    assert np.sqrt(np.mean(bends**2)) == pytest.approx(0.01, rel=0.03)
    if moves_goal:
        ends = [env.action(sign * np.eye(9)[8])[-1] - mean[-1] for sign in (1, -1)]
        assert ends[0] > 0.005 and ends[1] == pytest.approx(-ends[0], rel=1e-3)


def test_the_trajectory_is_the_primitives_own() -> None:
    env = wrapped(DMP_8, moves_goal=True, exploration_scale=0.01, mean=np.zeros((200, 1)))
    rng, draws = np.random.default_rng(0), []
    for _ in range(5):
        w, goal = rng.normal(size=(1, 8, 1)), rng.normal(size=1)
        path = 1e-3 * DMP_8.trajectories(w, np.zeros(1), goal)[0]
        draws.append(np.abs(env.action(env.weights(path)) - path).max())
    assert max(draws) < 1e-5
    ends = [wrapped(DMP_8, mean=np.zeros((200, 1))).action(np.full(8, w))[-1] for w in (-1, 1)]
    middle = np.full((200, 2), 0.3)
    two = wrapped(task_id="nmp/Bottles-v0", mean=middle, exploration_scale=[0.01, 0.02])
    two.reset()
    w = rng.normal(size=(8, 2))
    gain = PROMP.weight_std(1.0)
    path = PROMP.trajectories([w * gain * [0.01, 0.02]], np.zeros(2), np.zeros(2))[0]
    np.testing.assert_allclose(two.action(w.ravel()) - middle, path, atol=1e-6)
    assert np.ptp(ends) < 0.15, "without moves_goal, a DMP ends near the mean's end"


def test_a_demonstration_is_met_within_the_bounds_as_well_as_can_be() -> None:
    env = wrapped(reach=3.0)
    context, _ = env.reset(seed=0)
    demonstration = env.unwrapped.demonstrate(context)
    weights = env.weights(demonstration)
    assert env.action_space.contains(weights)

    def error(weights: np.ndarray) -> float:
        bent = env.mean_trajectory() + env._bases @ weights.reshape(-1, 1) * env._scale
        return float(np.sum((bent - demonstration) ** 2))

    rng = np.random.default_rng(0)
    nearby = np.clip(weights + rng.normal(0, 0.05, (500, 8)), -3, 3)
    assert error(weights) <= min(error(each) for each in nearby)
    far = wrapped(ProMP(20, 200), reach=100.0)
    far.reset(seed=0)
    assert np.abs(far.action(far.weights(demonstration)) - demonstration).max() < 0.1


def test_the_mean_may_be_given_or_depend_on_the_context() -> None:
    given = np.linspace(0, 1, 200)[:, None]
    env = wrapped(mean=given)
    env.reset(seed=0)
    np.testing.assert_allclose(env.action(np.zeros(8)), given, atol=1e-6)
    env = wrapped(mean=lambda context: np.full((200, 1), context[1]))
    with pytest.raises(TaskError, match=r"call reset\(\) before"):
        env.action(np.zeros(8))
    for seed in (0, 1):
        context, _ = env.reset(seed=seed)
        np.testing.assert_allclose(env.action(np.zeros(8)), context[1], atol=1e-6)


def test_without_help_from_the_environment_the_middle_and_a_tenth_of_the_space_are_taken() -> None:
    class Bare(gym.Env[np.ndarray, np.ndarray]):
        action_space = spaces.Box(-1.0, 3.0, (20, 2), np.float32)
        observation_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    env = MovementPrimitiveWrapper(Bare(), ProMP(4, 20))
    np.testing.assert_array_equal(env.mean_trajectory(), np.ones((20, 2)))
    np.testing.assert_allclose(env._scale, 0.4)


def test_a_pinned_context_and_options_pass_through() -> None:
    task = make_task(VIA_POINTS)
    pinned = task.sample_context(np.random.default_rng(3))
    env = MovementPrimitiveWrapper(gym.make(VIA_POINTS, context=pinned), PROMP)
    np.testing.assert_allclose(env.reset(seed=0)[0], pinned)
    other = task.sample_context(np.random.default_rng(4))
    np.testing.assert_allclose(env.reset(options={"context": other})[0], other)
    _, reward, terminated, _, info = env.step(np.ones(8, np.float32))
    again = task.simulate(other, env.action(np.ones(8)))
    assert terminated and reward == again.rewards[0] and "is_success" in info


def rollouts(vec_env_cls: Any, n: int = 2) -> tuple[np.ndarray, np.ndarray, list[Any]]:
    env = make_vec_env(
        VIA_POINTS,
        n_envs=n,
        seed=0,
        vec_env_cls=vec_env_cls,
        vec_env_kwargs={"start_method": "fork"} if vec_env_cls is SubprocVecEnv else {},
        wrapper_class=WRAPPER,
        wrapper_kwargs={"primitive": PROMP},
    )
    contexts = np.asarray(env.reset())
    actions = np.random.default_rng(0).standard_normal((n, 8)).astype(np.float32)
    _, rewards, _, infos = env.step(actions)
    env.close()
    return contexts, rewards, infos


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
@pytest.mark.parametrize("vec_env_cls", [SubprocVecEnv, TrajectoryVecEnv])
def test_vectorised_environments_agree(vec_env_cls: Any) -> None:
    contexts, rewards, infos = rollouts(DummyVecEnv)
    same = rollouts(vec_env_cls)
    np.testing.assert_array_equal(contexts, same[0])
    np.testing.assert_allclose(rewards, same[1], rtol=1e-6)
    assert infos[0]["is_success"] == same[2][0]["is_success"]


def test_the_batch_simulates_once_whatever_wrappers_make_of_the_action() -> None:
    env: Any = TrajectoryVecEnv([lambda: RecordEpisodeStatistics(wrapped()) for _ in range(4)])
    env.reset()
    calls, simulate = [], env.task.simulate
    for each in env._trajectory_envs:
        each.task.simulate = lambda *_: pytest.fail("simulated again, outside of the batch")
    env.task.simulate = lambda *inputs: calls.append(1) or simulate(*inputs)
    env.step(np.ones((4, 8), np.float32))
    assert len(calls) == 1


def test_ppo_improves_and_sac_runs_on_an_analytic_task() -> None:
    env = VecNormalize(
        make_vec_env(
            VIA_POINTS,
            n_envs=32,
            seed=0,
            vec_env_cls=TrajectoryVecEnv,
            env_kwargs={"n_points": 2},
            wrapper_class=WRAPPER,
            wrapper_kwargs={"primitive": PROMP},
        )
    )
    settings: dict[str, Any] = {"n_steps": 8, "batch_size": 128, "n_epochs": 10, "seed": 0}
    model = PPO("MlpPolicy", env, learning_rate=3e-3, gamma=0.0, device="cpu", **settings)

    def score() -> float:
        env.training, env.norm_reward = False, False
        mean, _ = evaluate_policy(model, env, n_eval_episodes=300)
        env.training, env.norm_reward = True, True
        return float(np.mean(mean))

    before = score()
    model.learn(4096)
    assert score() > 0.6 * before, "the mean distance falls by more than 40 %"
    SAC("MlpPolicy", wrapped(), learning_starts=20, device="cpu", buffer_size=100).learn(40)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: wrapped(ProMP(8, 100)), "100 time points.*n_time_points=200"),
        (lambda: wrapped(reach=0.0), "reach is 0.0"),
        (lambda: wrapped(reach=np.nan), "reach is nan"),
        (lambda: wrapped(exploration_scale=[0.1, 0.1]), "exploration_scale is .*one for each"),
        (lambda: wrapped(exploration_scale=-1.0), "exploration_scale is -1.0"),
        (lambda: wrapped(exploration_scale="big"), "exploration_scale is 'big'; .*number > 0"),
        (lambda: wrapped(mean=np.zeros((100, 1))), r"shape \(100, 1\).*\(T, D\) = \(200, 1\)"),
        (lambda: wrapped(mean=np.full((200, 1), np.nan)), "not finite"),
        (lambda: wrapped(moves_goal=True), "goal of ProMP.*moves_goal=False"),
        (lambda: MovementPrimitiveWrapper(gym.make("Pendulum-v1"), PROMP), "TrajectoryActionWr"),
        (lambda: MovementPrimitiveWrapper(gym.make("CartPole-v1"), PROMP), "finite Box"),
        (
            lambda: wrapped("promp"),
            r"primitive is 'promp'; .*ProMP\(n_bases=8, n_time_points=200\)",
        ),
        (lambda: wrapped(ProMP), "primitive is <class .*an object with n_bases"),
        (lambda: wrapped(reach="5"), "reach is '5'; it must be a finite number > 0"),
        (lambda: wrapped(reach=[1, 2]), r"reach is \[1, 2\]; it must be a finite number"),
        (lambda: wrapped(reach=True), "reach is True; it must be a finite number"),
        (lambda: wrapped(mean="zero"), "trajectory is 'zero'; .*numbers, of shape"),
        (lambda: wrapped(mean=[[1], [1, 2]]), r"is \[\[1\], \[1, 2\]\]; .*numbers, of shape"),
        (lambda: wrapped(moves_goal="yes"), "moves_goal is 'yes'; it must be True or False"),
        (
            lambda: wrapped(Flat()),
            r"Flat.trajectories returned shape \(1, 2\).* must be \(N, T, D\)",
        ),
        (lambda: WRAPPER("nmp/ViaPoints-v0", PROMP), "env is 'nmp/.*gym.make"),
    ],
)
def test_what_does_not_fit_is_told(build: Any, message: str) -> None:
    with pytest.raises(TaskError, match=message):
        build()


def test_wrong_weights_are_told() -> None:
    env = wrapped()
    env.reset()
    for text in ("a", [[1], [1, 2]]):
        with pytest.raises(InvalidTrajectoryError, match=r"action is .*; .*\(8,\) finite numbers"):
            env.step(text)
    for wrong in (np.zeros(7), np.full(8, np.nan)):
        with pytest.raises(InvalidTrajectoryError, match=r"takes \(8,\): 8 for each of 1"):
            env.step(wrong)
