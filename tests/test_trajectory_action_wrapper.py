"""Step-based environments as trajectory bandits: contexts, controllers, returns, bad input."""

import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

from baselines import ProMP
from benchmark_envs import (
    ContextSource,
    InvalidContextError,
    InvalidTrajectoryError,
    MovementPrimitiveWrapper,
    PositionController,
    TaskError,
    TrajectoryActionWrapper,
)
from sb3_nmp import RCNMP

ANY_SPACE: Any = spaces.Discrete(3)
WIDE = spaces.Box(-2.0, 2.0, (2,), np.float32)


class Point(gym.Env[np.ndarray, np.ndarray]):
    """A point in the plane, moved by a tenth of the action; it ends beyond 0.9 m."""

    action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
    observation_space = spaces.Box(-np.inf, np.inf, (4,), np.float64)
    dt = 0.5

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, Any]:
        super().reset(seed=seed)
        self.at, self.goal = np.zeros(2), self.np_random.uniform(-0.5, 0.5, 2)
        return self.seen(), {}

    def seen(self) -> np.ndarray:
        return np.concatenate([self.at, self.goal])

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        self.at = self.at + 0.1 * action
        distance, effort = np.linalg.norm(self.at - self.goal), 0.01 * float(np.sum(action**2))
        info = {"is_success": distance < 0.05, "reward_near": -distance, "reward_effort": -effort}
        return self.seen(), float(-distance - effort), bool(abs(self.at[0]) > 0.9), False, info


def place(env: Any, context: np.ndarray) -> np.ndarray:
    env.unwrapped.goal = np.array(context)
    return env.unwrapped.seen()


SOURCE = ContextSource(lambda seen: seen[2:], WIDE, place, achieved=lambda _, seen: seen[:2])
FOLLOW = PositionController(position=lambda seen: seen[:2], gain=10.0)


def bandit(**settings: Any) -> Any:
    chosen = {"n_time_points": 10, "context": SOURCE} | settings
    return TrajectoryActionWrapper(Point(), **chosen)


def following(**settings: Any) -> Any:
    return bandit(controller=FOLLOW, low=[-1, -1], high=[1, 1], initial=[0, 0], **settings)


def line(end: Any, n: int = 10) -> np.ndarray:
    return np.linspace(0, 1, n)[:, None] * np.asarray(end)


# -- what a rollout is ---------------------------------------------------------------------------


def test_the_rewards_of_the_steps_are_the_return() -> None:
    actions = np.random.default_rng(0).uniform(-1, 1, (10, 2)).astype(np.float32)
    env, plain = bandit(), Point()
    context, _ = env.reset(options={"context": [0.25, -0.5]})
    plain.reset()
    plain.goal = np.array(context)
    steps = [plain.step(action) for action in actions]
    rewards = [step[1] for step in steps]
    _, reward, terminated, truncated, info = env.step(actions)
    assert reward == sum(rewards) and terminated and not truncated
    np.testing.assert_array_equal(info["step_rewards"], rewards)
    np.testing.assert_array_equal(info["executed_trajectory"], actions)
    np.testing.assert_allclose(info["achieved_context"], plain.at, atol=1e-6)
    for name in ("reward_near", "reward_effort"):
        assert info[name] == pytest.approx(sum(step[4][name] for step in steps))
    assert info["is_success"] == steps[-1][4]["is_success"] and info["n_steps"] == 10
    env = bandit(returns="last")
    env.reset(options={"context": context})
    _, reward, *_, info = env.step(actions)
    assert reward == rewards[-1] and "step_rewards" not in info
    assert info["reward_near"] == steps[-1][4]["reward_near"]


def test_terms_that_do_not_add_up_are_left_out() -> None:
    env = TrajectoryActionWrapper(
        gym.wrappers.TransformReward(Point(), lambda reward: reward + 1),  # pyright: ignore
        n_time_points=5,
        context=SOURCE,
    )
    env.reset(seed=0)
    *_, info = env.step(np.zeros((5, 2), np.float32))
    assert not [name for name in info if name.startswith("reward")]


def test_a_position_is_followed_and_what_was_reached_is_told() -> None:
    env = following()
    env.reset(options={"context": [0.5, -0.25]})
    goal = line([0.5, -0.25])
    *_, info = env.step(goal)
    np.testing.assert_allclose(info["executed_trajectory"], goal, atol=1e-6)
    assert info["is_success"] is True and not info["clipped"]
    env.reset(options={"context": [0.5, -0.25]})
    *_, info = env.step(np.full((10, 2), 0.5))
    assert info["clipped"], "0.5 m in one step are more than an action of 1"
    np.testing.assert_allclose(info["executed_trajectory"][:4, 0], [0.1, 0.2, 0.3, 0.4])


def test_an_episode_that_ends_early_keeps_its_shape() -> None:
    env = bandit()
    env.reset(seed=0)
    _, reward, *_, info = env.step(np.full((10, 2), [0.95, 0.0], np.float32))
    assert info["n_steps"] == 10, "0.9 is passed with the last step"
    env = bandit(controller=FOLLOW, low=[-1, -1], high=[1, 1])
    env.reset(seed=0)
    _, reward, *_, info = env.step(np.full((10, 2), [1.0, 0.0]))
    n = info["n_steps"]
    assert n < 10 and reward == pytest.approx(info["step_rewards"][:n].sum())
    assert (info["step_rewards"][n:] == 0).all()
    reached = info["executed_trajectory"]
    assert reached.shape == (10, 2)
    np.testing.assert_array_equal(reached[n:], reached[n - 1 : n])


def test_a_users_law_and_a_reward_as_success() -> None:
    law = lambda set_point, seen: 5 * (set_point - seen[:2])  # noqa: E731
    settings: dict[str, Any] = {"controller": law, "low": [-1, -1], "high": [1, 1]}
    env = bandit(**settings, returns="last", success_reward=-0.05)
    for context, success in (([0.1, 0.1], True), ([0.5, 0.1], False)):
        env.reset(options={"context": context})
        _, reward, *_, info = env.step(np.full((10, 2), 0.1, np.float32))
        assert info["is_success"] is success and (reward >= -0.05) is success
        np.testing.assert_allclose(info["executed_trajectory"], 0.1, atol=1e-6)


def test_what_algorithms_read_is_there() -> None:
    env = following(exploration_scale=[0.1, 0.2])
    assert env.dt == 0.5 and env.tells_achievement
    np.testing.assert_array_equal(env.exploration_scale, [0.1, 0.2])
    np.testing.assert_array_equal(env.initial_trajectory(), np.zeros((10, 2)))
    np.testing.assert_allclose(bandit().exploration_scale, 0.2)
    np.testing.assert_array_equal(bandit().initial_trajectory(), np.zeros((10, 2)))
    env = bandit(initial=lambda seen: seen[2:])
    with pytest.raises(TaskError, match=r"call reset\(\) before"):
        env.initial_trajectory()
    context, _ = env.reset(seed=0)
    np.testing.assert_allclose(env.initial_trajectory()[3], context)
    assert not bandit(context=ContextSource(lambda seen: seen[2:], WIDE)).tells_achievement


def test_an_achievement_outside_of_the_contexts_is_none_and_one_at_the_edge_is_the_edge() -> None:
    near = spaces.Box(0.0, 0.5, (2,), np.float32)
    source = ContextSource(lambda seen: seen[2:], near, place, lambda _, seen: seen[:2])
    for end, told in (([0.3, 0.2], [0.3, 0.2]), ([0.503, 0.2], [0.5, 0.2]), ([0.3, -0.1], None)):
        env = following(context=source)
        env.reset(options={"context": [0.1, 0.1]})
        *_, info = env.step(line(end))
        if told is None:
            assert "achieved_context" not in info
        else:
            np.testing.assert_allclose(info["achieved_context"], told, atol=1e-6)


# -- contexts ------------------------------------------------------------------------------------


def test_a_context_is_drawn_by_the_environment_and_rounded_as_it_is_observed() -> None:
    env, plain = bandit(), Point()
    context, _ = env.reset(seed=3)
    assert context.dtype == np.float32 and env.env.unwrapped.goal.tolist() == context.tolist()
    again, _ = bandit().reset(seed=3)
    other, _ = env.reset()
    np.testing.assert_array_equal(context, again)
    assert np.abs(context - other).max() > 0.01
    drawn = np.stack([env.reset()[0] for _ in range(300)])
    plain.reset(seed=0)
    assert np.abs(drawn).max() <= 0.5 and np.abs(drawn.mean(axis=0)).max() < 0.06


def test_without_place_a_drawn_context_comes_back_by_its_seed_and_no_other_does() -> None:
    env = bandit(context=ContextSource(lambda seen: seen[2:], WIDE))
    contexts = [env.reset(seed=0)[0]] + [env.reset()[0] for _ in range(4)]
    actions = np.full((10, 2), 0.1, np.float32)
    _, first, *_ = env.step(actions)
    for context in contexts:
        again, _ = env.reset(options={"context": context})
        np.testing.assert_array_equal(again, context)
    assert env.step(actions)[1] == first
    with pytest.raises(InvalidContextError, match=r"0\.123.*place=function"):
        env.reset(options={"context": [0.123, 0.0]})


def test_a_place_that_does_something_else_is_told() -> None:
    wrong = ContextSource(lambda seen: seen[2:], WIDE, lambda env, context: place(env, 2 * context))
    with pytest.raises(TaskError, match="place was asked for"):
        bandit(context=wrong).reset(options={"context": [0.3, 0.1]})


# -- faces ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("build", [bandit, following])
def test_the_checkers_are_content(build: Any) -> None:
    sb3_check_env(build(), warn=False)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*different from the unwrapped version")
        warnings.filterwarnings("ignore", ".*(not within the default|symmetric and normalized)")
        warnings.filterwarnings("ignore", ".*`.spec` is None")
        check_env(build(), skip_render_check=True)


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded:DeprecationWarning")
def test_vectorised_environments_agree() -> None:
    actions = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 10, 2)).astype(np.float32)
    results = []
    for build, settings in ((DummyVecEnv, {}), (SubprocVecEnv, {"start_method": "fork"})):
        env = build([bandit, bandit], **settings)
        env.seed(0)
        contexts = np.asarray(env.reset())
        results.append((contexts, env.step(actions)[1]))
        env.set_options([{"context": contexts[1]}, {"context": contexts[0]}])
        np.testing.assert_allclose(np.asarray(env.reset()), contexts[::-1])
        assert env.get_attr("exploration_scale")[0].tolist() == pytest.approx([0.2, 0.2])
        env.close()
    np.testing.assert_allclose(results[0][0], results[1][0])
    np.testing.assert_allclose(results[0][1], results[1][1], rtol=1e-6)


def test_rcnmp_learns_and_weights_of_a_primitive_are_taken() -> None:
    model = RCNMP("MlpPolicy", following(), population_size=10, n_crossover=4, seed=0).learn(40)
    env, solved = following(), []
    for seed in range(20):
        context, _ = env.reset(seed=seed)
        trajectory, _ = model.predict(context, deterministic=True)
        solved.append(env.step(trajectory)[4]["is_success"])
    assert np.mean(solved) >= 0.75, "of 20 unseen goals; a resting point solves none"
    env = MovementPrimitiveWrapper(following(), ProMP(4, 10))
    context, _ = env.reset(seed=0)
    *_, info = env.step(env.weights(line(context)))
    assert info["is_success"]


def test_pendulum_is_a_bandit_without_further_words() -> None:
    env = TrajectoryActionWrapper(gym.make("Pendulum-v1"), success_reward=-300)
    plain, rewards = gym.make("Pendulum-v1").unwrapped, []
    context, _ = env.reset(seed=4)
    assert env.dt == 0.05 and env.action_space.shape == (200, 1)
    plain.reset()
    plain.state = np.array([np.arctan2(context[1], context[0]), context[2]])  # pyright: ignore
    actions = np.full((200, 1), 0.5, np.float32)
    for action in actions:
        rewards.append(plain.step(action)[1])
    assert env.step(actions)[1] == pytest.approx(float(np.sum(rewards)), rel=1e-3)
    sb3_check_env(env, warn=False)


def test_reacher_follows_its_target() -> None:
    def put(env: Any, target: np.ndarray) -> np.ndarray:
        base = env.unwrapped
        base.set_state(np.append(base.data.qpos[:2], target), base.data.qvel)
        return base._get_obs()

    target = ContextSource(lambda seen: seen[4:6], spaces.Box(-0.21, 0.21, (2,), np.float32), put)
    env = TrajectoryActionWrapper(gym.make("Reacher-v5"), context=target)
    context, _ = env.reset(seed=0)
    assert np.linalg.norm(context) <= 0.2
    other, _ = env.reset(options={"context": [0.1, -0.05]})
    np.testing.assert_allclose(other, [0.1, -0.05], atol=1e-6)
    _, reward, *_, info = env.step(np.zeros((50, 2), np.float32))
    assert info["reward_dist"] + info["reward_ctrl"] == pytest.approx(reward)
    assert info["n_steps"] == 50 and info["reward_ctrl"] == 0


def test_pictures_pass_through() -> None:
    env = TrajectoryActionWrapper(Point(), n_time_points=3, context=SOURCE)
    env.env.render = lambda: "a picture"  # pyright: ignore
    assert env.render() == "a picture" and env.unwrapped is env


# -- what does not fit ---------------------------------------------------------------------------


class Unbounded(Point):
    action_space = spaces.Box(-np.inf, np.inf, (2,), np.float32)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: TrajectoryActionWrapper(gym.make("CartPole-v1")), "Discrete.*continuous actions"),
        (lambda: TrajectoryActionWrapper(Unbounded(), n_time_points=5), "no finite bounds"),
        (lambda: TrajectoryActionWrapper(Point(), n_time_points=5), "finite bounds, but entry 0"),
        (lambda: TrajectoryActionWrapper(Point(), context=SOURCE), "give n_time_points >= 2"),
        (lambda: bandit(n_time_points=1), "n_time_points is 1"),
        (
            lambda: TrajectoryActionWrapper(gym.make("Pendulum-v1"), n_time_points=201),
            r"after 200 steps.*max_episode_steps=201",
        ),
        (lambda: bandit(returns="mean"), "'mean'; it must be 'sum' or 'last'"),
        (lambda: bandit(controller=FOLLOW), "low and high are missing"),
        (lambda: bandit(controller=FOLLOW, low=[0, 0], high=[1]), "of one shape"),
        (lambda: bandit(low=[1, 1], high=[0, 0]), "low < high"),
        (lambda: bandit(low=[-1, -1], high=[1, np.inf]), "must be finite"),
        (lambda: bandit(controller="position"), "controller is 'position'; give ActionCo"),
        (lambda: bandit(exploration_scale=0.0), "exploration_scale is 0.0"),
        (lambda: bandit(exploration_scale=[1, 2, 3]), "one for each dimension"),
        (lambda: bandit(initial=[0.0]).initial_trajectory(), r"initial has shape \(1,\)"),
        (
            lambda: ContextSource(lambda seen: seen, spaces.Box(-np.inf, 1, (2,))),
            r"\[-inf, 1.0\]; give context=ContextSource",
        ),
        (lambda: ContextSource(lambda seen: seen, ANY_SPACE), "no space of contexts"),
        (lambda: bandit().reset(options={"context": [0.0]}), r"shape \(1,\)"),
        (lambda: bandit().reset(options={"context": [0.0, 3.0]}), r"entry 1 is 3, .*\[-2, 2\]"),
        (lambda: bandit().reset(options={"context": [np.nan, 0]}), "entry 0 is nan"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_told(build: Any, message: str) -> None:
    with pytest.raises(TaskError, match=message):
        build()


@pytest.mark.parametrize("wrong", [np.zeros((9, 2)), np.zeros(20), np.full((10, 2), np.nan)])
def test_a_wrong_trajectory_is_told(wrong: np.ndarray) -> None:
    env = bandit()
    env.reset()
    with pytest.raises(InvalidTrajectoryError, match=r"\(T, D\) = \(10, 2\)"):
        env.step(wrong)


def test_a_controllers_wrong_answer_and_a_missing_reset_are_told() -> None:
    env = bandit(controller=lambda *_: np.full(2, np.nan), low=[-1, -1], high=[1, 1])
    env.reset()
    with pytest.raises(TaskError, match=r"answered \[nan, nan\]; an action is 2 finite"):
        env.step(np.zeros((10, 2)))
    env = bandit()
    with pytest.raises(TaskError, match="has not begun"):
        env.step(np.zeros((10, 2)))
    env.reset()
    env.step(np.zeros((10, 2)))
    with pytest.raises(TaskError, match=r"call reset\(\) before each step"):
        env.step(np.zeros((10, 2)))


class AtTheEnd(Point):
    """Tells the term of the goal in the last step alone."""

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        seen, reward, ended, cut, info = super().step(action)
        self.n_steps = getattr(self, "n_steps", 0) + 1
        info = {"reward_all": reward}
        if self.n_steps == 3:
            reward, info = reward - 1.0, info | {"reward_goal": -1.0}
        return seen, reward, ended, cut, info


def test_a_term_that_is_told_at_the_end_alone_counts_nothing_before() -> None:
    env: Any = TrajectoryActionWrapper(AtTheEnd(), n_time_points=3, context=SOURCE)
    env.reset(seed=0)
    _, reward, _, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
    assert info["reward_goal"] == -1.0
    assert info["reward_goal"] + info["reward_all"] == pytest.approx(reward)
