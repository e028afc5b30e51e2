"""Learning over varying contexts: RC-NMP's skill, its twins, and what a rollout achieved."""

import zlib
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

from baselines import GA
from benchmark_envs import TrajectoryVecEnv, make_task
from sb3_nmp import RCNMP, ConfigurationError, InvalidDataError
from sb3_nmp.common.contextual import ContextualExploration, ContextualSearch, Experience
from sb3_nmp.common.repertoire import Repertoire
from sb3_nmp.models.ensemble import Ensemble, EnsembleTraining
from sb3_nmp.models.skill_space import SkillSpace
from sb3_nmp.rcnmp.achievement import AchievementConditionedSkill
from sb3_nmp.rcnmp.settings import RCNMPAchievement, RCNMPSkill

N_UNSEEN = 60


class Reaching(gym.Env[Any, Any]):
    """The end of a path is to lie at a drawn target, which it seldom does by chance."""

    observation_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
    action_space = spaces.Box(-3.0, 3.0, (12, 2), np.float32)
    exploration_scale = np.array([0.3, 0.3])

    def __init__(self, tells: bool = True, where: np.ndarray | None = None) -> None:
        self.tells_achievement, self.where = tells, where

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.target = self.np_random.uniform(-1.0, 1.0, 2).astype(np.float32)
        return self.target, {}

    def initial_trajectory(self) -> np.ndarray:
        return np.zeros((12, 2))

    def step(self, action: Any) -> Any:
        end = self.bend(action[-1])
        miss = float(np.linalg.norm(end - self.target))
        info: dict[str, Any] = {"is_success": miss < 0.05}
        if self.tells_achievement and (np.abs(end) <= 1.0).all():
            info["achieved_context"] = end if self.where is None else self.where
        return self.target, -miss, True, False, info

    @staticmethod
    def bend(end: np.ndarray) -> np.ndarray:
        return end + 0.2 * np.sin(2.0 * end[::-1])


class Dice(gym.Env[Any, Any]):
    """What a throw shows depends on its last bit, and on a circumstance: no model can tell."""

    observation_space = spaces.Box(0.0, 1.0, (2,), np.float32)
    action_space = spaces.Box(-3.0, 3.0, (12, 1), np.float32)
    exploration_scale = np.array([0.3])
    tells_achievement = True

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        cup = 0.2 * self.np_random.integers(5)
        self.context = np.array([cup, self.np_random.uniform()], np.float32)
        return self.context, {}

    def step(self, action: Any) -> Any:
        shown = self.throw(self.context[0], action)
        miss = abs(shown - self.context[1])
        info = {"is_success": miss < 0.05, "achieved_context": np.array([self.context[0], shown])}
        return self.context, -miss, True, False, info

    @staticmethod
    def throw(cup: float, action: np.ndarray) -> float:
        drawn = np.append(action.astype(np.float32).ravel(), np.float32(cup)).tobytes()
        return zlib.crc32(drawn) / 2**32


def many() -> VecEnv:
    return make_vec_env(Reaching, n_envs=10)


def dice_solved(model: Any) -> float:
    rng = np.random.default_rng(5)
    contexts = np.stack([0.2 * rng.integers(5, size=200), rng.uniform(size=200)], axis=1)
    contexts = contexts.astype(np.float32)
    throws, _ = model.predict(contexts, deterministic=True)
    shown = np.array([Dice.throw(c[0], a) for c, a in zip(contexts, throws, strict=True)])
    return float((np.abs(shown - contexts[:, 1]) < 0.05).mean())


def solved_of(model: Any, task: Any) -> float:
    contexts = np.stack(
        [task.sample_context(np.random.default_rng([7, i])) for i in range(N_UNSEEN)]
    )
    answers, _ = model.predict(contexts.astype(np.float32), deterministic=True)
    return float(task.simulate(contexts, answers).successes.mean())


def reaching_misses(model: Any) -> np.ndarray:
    targets = np.random.default_rng(5).uniform(-0.9, 0.9, (200, 2)).astype(np.float32)
    answers, _ = model.predict(targets, deterministic=True)
    return np.linalg.norm([Reaching.bend(a[-1]) for a in answers] - targets, axis=1)


@pytest.fixture(scope="module")
def bottles() -> tuple[Any, Any]:
    """RC-NMP after 160 rollouts of bottles at random, and the task."""
    env = make_vec_env(
        "nmp/Bottles-v0", n_envs=20, vec_env_cls=TrajectoryVecEnv,
        env_kwargs={"random_bottles": True, "n_threads": 1},
    )  # fmt: skip
    model = RCNMP("MlpPolicy", env, seed=1000).learn(160)
    return model, make_task("nmp/Bottles-v0", random_bottles=True, n_threads=1)


# -- learning ----------------------------------------------------------------------------------


def test_rcnmp_learns_a_skill_over_contexts_from_nothing(bottles: tuple[Any, Any]) -> None:
    assert solved_of(*bottles) >= 0.95


def test_the_reward_that_is_asked_for_matters(bottles: tuple[Any, Any]) -> None:
    """Asked for the worst reward instead of the wanted one, it knocks bottles over."""
    model, task = bottles
    skill = model.policy.skill.conditioned
    wanted, worst = skill.target_reward.clone(), (skill.rewards(th.tensor([-8.0])))[0]
    skill.target_reward.copy_(worst)
    try:
        assert solved_of(model, task) <= 0.6
    finally:
        skill.target_reward.copy_(wanted)
    assert wanted > 0.3, "the wanted reward is above the average, in standard deviations"


def test_the_reward_model_learns_from_failures(bottles: tuple[Any, Any]) -> None:
    """It tells solved contexts' answers from the straight line, which knocks bottles over."""
    model, task = bottles
    skill = model.policy.skill
    contexts = np.stack([task.sample_context(np.random.default_rng([8, i])) for i in range(20)])
    rows = skill.conditioned.contexts(th.as_tensor(contexts, dtype=th.float32))
    answers = th.as_tensor(skill.answer(contexts), dtype=th.float32)
    good = skill.conditioned._surprise(skill.space, rows, answers)
    bad = skill.conditioned._surprise(skill.space, rows, th.zeros_like(answers))
    assert (good < bad).float().mean() >= 0.9


def test_what_was_achieved_teaches_without_any_reward() -> None:
    """Relabelled, the rollouts teach what the few successes do not."""
    taught = RCNMP("MlpPolicy", many(), seed=0).learn(300)
    untaught = RCNMP("MlpPolicy", many(), seed=0, relabel=False).learn(300)
    assert np.median(reaching_misses(taught)) < 0.02
    assert np.median(reaching_misses(taught)) < 0.5 * np.median(reaching_misses(untaught))


class Beginning(Reaching):
    """The same, with an initial trajectory that depends on the target.

    It counts where a path is on the way: its end is given away by the target.
    """

    def __init__(self, side: float) -> None:
        super().__init__()
        self.side = side

    def initial_trajectory(self) -> np.ndarray:
        return self.side * np.linspace(0.5, 1.0, 12)[:, None] * self.target

    def step(self, action: Any) -> Any:
        return super().step(np.repeat(action[6:7], 12, axis=0))


@pytest.mark.parametrize(
    ("algorithm", "regression", "side", "most"),
    [
        (GA, "ridge", -1.0, 0.1),
        (GA, "gaussian-process", -1.0, 0.05),
        (RCNMP, None, -1.0, 0.02),
        (RCNMP, None, 1.0, 0.008),  # 0.012 where its ensemble sees deviations alone
    ],
)
def test_what_was_achieved_is_right_where_that_context_would_have_begun(
    algorithm: Any, regression: str | None, side: float, most: float
) -> None:
    """Weights from where the asked context had begun led away from what was achieved."""
    chosen = {"regression": regression} if regression else {}
    env = make_vec_env(lambda: Beginning(side), n_envs=10)
    model = algorithm("MlpPolicy", env, seed=0, policy_kwargs=chosen)
    model.learn(400)
    targets = np.random.default_rng(5).uniform(-0.9, 0.9, (200, 2)).astype(np.float32)
    answers = model.policy.own_answer(targets)
    ends = np.array([Reaching.bend(answer[6]) for answer in answers])
    assert np.median(np.linalg.norm(ends - targets, axis=1)) < most


@pytest.mark.parametrize("regression", ["nearest", "ridge", "gaussian-process"])
def test_the_twins_learn_too(regression: str) -> None:
    model = GA("MlpPolicy", many(), seed=0, policy_kwargs={"regression": regression})
    model.learn(300)
    assert np.median(reaching_misses(model)) < 0.2


def test_an_environment_with_one_context_is_searched_as_before() -> None:
    model = RCNMP("MlpPolicy", "nmp/Bottles-v0", seed=0).learn(20)
    assert model._search is None and not model.policy.skill.is_ready


# -- what a search remembers -------------------------------------------------------------------


def experience(successes: list[bool], example: int | None, since: int) -> Experience:
    n = len(successes)
    return Experience(
        np.zeros((n, 1)), np.zeros((n, 2)), np.zeros(n), np.array(successes), None, example, since
    )


def test_one_example_counts_of_the_first_successes() -> None:
    """Others may go a different way round; the mean of two ways goes none."""
    search = ContextualSearch(ContextualExploration())
    search.take(np.array([-3.0, -1.0, -2.0, -9.0]), np.array([1, 1, 0, 0], bool), 10, False)
    assert (search.example, search.since) == (11, 14)
    known = experience([True, True, True, False], example=1, since=3)
    assert known.right.tolist() == [1]
    assert experience([True, True, True, True], example=1, since=2).right.tolist() == [1, 2, 3]


def test_the_noise_grows_with_successes_and_shrinks_without() -> None:
    search = ContextualSearch(ContextualExploration())
    search.adapt(0.0, was_ready=False, is_ready=True, by_achievement=False)
    first = search.scale
    search.adapt(1.0, True, True, False)
    assert search.scale > first
    for _ in range(30):
        search.adapt(0.0, True, True, False)
    assert search.scale == search.exploration.limits[0]
    first = ContextualSearch(ContextualExploration())
    drawn = first.scales(np.random.default_rng(0), 100, is_ready=False)
    assert (drawn[::2] == 1.0).all() and drawn.max() > 3.0


# -- what is repeated --------------------------------------------------------------------------


@pytest.mark.parametrize("algorithm", [RCNMP, GA])
def test_what_no_model_can_tell_is_repeated(algorithm: Any) -> None:
    """Of 300 throws some show what is asked, and they show it again."""
    never = ContextualExploration(alike=None)
    learned = algorithm("MlpPolicy", make_vec_env(Dice, n_envs=10), seed=0).learn(300)
    guessing = algorithm("MlpPolicy", make_vec_env(Dice, n_envs=10), seed=0, contextual=never)
    guessing.learn(300)
    assert dice_solved(learned) >= 0.95
    assert dice_solved(guessing) <= 0.25


def repertoire(asked: list[Any], achieved: list[Any], successes: list[int]) -> Repertoire:
    known = Repertoire(len(asked[0]), (5, 2))
    drawn = np.random.default_rng(0).normal(size=(len(asked), 5, 2))
    known.learn(np.array(asked), np.array(achieved), np.array(successes, bool), drawn, 0.5)
    return known


def test_near_enough_is_what_has_succeeded_and_never_failed() -> None:
    asked, achieved = [[0.0], [1.0], [2.0], [3.0]], [[0.4], [1.1], [2.3], [np.nan]]
    unit = np.std([0.0, 1.0, 2.0])
    reaches = [float(repertoire(asked, achieved, s).reach) for s in ([0, 1, 0, 0], [0, 1, 1, 1])]
    np.testing.assert_allclose(reaches, np.array([0.1, 0.3]) / unit)
    contradictory = repertoire(asked, achieved, [1, 0, 1, 0])
    assert contradictory.reach < 0.1 / unit + 1e-9
    assert contradictory.find(th.tensor([[1.1 + 0.09], [1.1 + 0.11]])).tolist() == [1, -1]
    assert repertoire(asked, achieved, [0, 0, 0, 0]).find(th.tensor([[1.2]])).tolist() == [-1]


def test_the_most_like_circumstances_are_repeated() -> None:
    """The first entry is what every rollout achieved as given; goals within 0.3 are right."""
    asked = [[0.0, 0.0], [2.0, 0.1], [4.0, 0.2], [4.0, 0.6], [2.4, 0.5]]
    achieved = [[0.0, 0.3], [2.0, 0.3], [4.0, 0.35], [4.0, 0.9], [2.4, 0.5]]
    known = repertoire(asked, achieved, [1, 1, 1, 1, 1])
    wanted = [[0.1, 0.3], [1.9, 0.2], [3.9, 0.3], [3.9, 0.85], [1.0, 0.3], [0.1, 0.9]]
    assert known.find(th.tensor(wanted)).tolist() == [0, 1, 2, 3, -1, -1]
    assert known.find(th.tensor([[2.3, 0.38], [2.1, 0.42]])).tolist() == [4, 1]
    evenly = known.find(th.tensor([[2.21, 0.32], [2.19, 0.48]]))
    assert evenly.tolist() == [1, 4], "a smaller miss makes up for circumstances a little less like"


def test_a_far_goal_is_approached_in_strides() -> None:
    """Goals beyond two reaches of what was achieved are moved nearer; circumstances are not."""
    asked = [[0.0, 0.0], [2.0, 0.1], [4.0, 0.2], [4.0, 0.6]]
    known = repertoire(asked, [[0.0, 0.3], [2.0, 0.3], [4.0, 0.35], [4.0, 0.9]], [1, 1, 1, 1])
    wanted = th.tensor([[0.1, 0.8], [0.1, 2.8], [3.9, -2.0], [4.0, 0.9]])
    moved = known.approach(wanted, stride=2.0)
    np.testing.assert_allclose(moved, [[0.1, 0.8], [0.1, 1.5], [3.9, -0.3], [4.0, 0.9]], atol=1e-6)
    assert th.equal(Repertoire(2, (5, 2)).approach(wanted, stride=2.0), wanted)


def test_where_nothing_is_achieved_rollouts_explore_farther() -> None:
    search = ContextualSearch(ContextualExploration())
    search.widen(0.3)
    assert search.scale == 1.0
    search.widen(0.2)
    search.widen(0.0)
    assert search.scale == 9.0
    drawn = search.scales(np.random.default_rng(0), 100, is_ready=False)
    assert (drawn[::2] == 9.0).all() and 30.0 < drawn.max() <= 45.0


class Heavy(Reaching):
    """Nothing moves before a path leaves the middle by far, and it moves to an edge then."""

    exploration_scale = np.array([0.05, 0.05])

    def step(self, action: Any) -> Any:
        moves = np.abs(action).max() >= 2.0
        info = {"is_success": False, "achieved_context": np.sign(action[-1])}
        return self.target, -1.0, True, False, info if moves else {"is_success": False}


def test_a_search_finds_what_lies_far_from_where_it_begins() -> None:
    env, narrow = make_vec_env(Heavy, n_envs=10), ContextualExploration(widening=1.0)
    model = RCNMP("MlpPolicy", env, seed=0, contextual=narrow).learn(140)
    assert not model.policy.skill.is_ready
    assert RCNMP("MlpPolicy", env, seed=0).learn(140).policy.skill.is_ready


def test_rollouts_aim_no_farther_than_a_stride(monkeypatch: pytest.MonkeyPatch) -> None:
    model = RCNMP("MlpPolicy", many(), seed=0).learn(100)
    known, asked = model.policy.repertoire, []
    known.achieved = known.achieved[known.achieved[:, 0] < 0.0]
    known.reach.fill_(0.1)
    answer = model.policy.skill.answer
    monkeypatch.setattr(
        model.policy.skill, "answer", lambda rows: asked.append(rows) or answer(rows)
    )
    far = np.array([[0.9, 0.0]], np.float32)
    model._explore(slice(0, 1), far)
    np.testing.assert_allclose(asked[0], known.approach(th.as_tensor(far), 3.0))
    assert asked[0][0, 0] < 0.5


# -- parts -------------------------------------------------------------------------------------


def test_a_trajectory_is_found_again_from_its_weights() -> None:
    space, rng = SkillSpace(1, (50, 2), 6), np.random.default_rng(0)
    contexts = rng.uniform(size=(4, 1))
    ends = np.concatenate([contexts, 1.0 - contexts], axis=1)
    lines = np.linspace(0.0, 1.0, 50)[:, None] * ends[:, None]
    space.begin(contexts, lines, (0.1, 0.1))
    np.testing.assert_allclose(space.start_from(contexts), lines, atol=1e-9)
    weights = rng.normal(size=(4, space.n_weights))
    paths = space.trajectories(contexts, weights)
    np.testing.assert_allclose(paths[:, [0, -1]], lines[:, [0, -1]], atol=1e-9)
    found = space.trajectories(contexts, space.weights(contexts, paths))
    np.testing.assert_allclose(found, paths, atol=0.01)


def test_an_end_is_free_where_the_initial_trajectory_rests() -> None:
    space = SkillSpace(1, (50, 1), 6)
    space.begin(np.zeros((2, 1)), np.zeros((2, 50, 1)), (0.1,))
    assert space.trajectories(np.zeros((1, 1)), np.ones((1, 6)))[0, -1, 0] > 0.5


def test_an_ensemble_fits_and_doubts_what_it_has_not_seen() -> None:
    generator = th.Generator().manual_seed(0)
    ensemble = Ensemble([1, 32, 32, 1], 5, generator)
    seen = th.linspace(-1.0, 1.0, 64)[:, None]
    ensemble.fit(seen, th.sin(3.0 * seen), 400, EnsembleTraining(1e-2), generator)
    assert float((ensemble(seen).mean(dim=0) - th.sin(3.0 * seen)).abs().max()) < 0.15
    spread_outside = ensemble(th.tensor([[4.0]])).std(dim=0)
    assert spread_outside > 5 * ensemble(seen).std(dim=0).mean()


# -- saving, and what is refused ---------------------------------------------------------------


def test_a_saved_skill_answers_the_same(bottles: tuple[Any, Any], tmp_path: Path) -> None:
    taught = RCNMP("MlpPolicy", many(), seed=0).learn(60)
    twin = GA("MlpPolicy", many(), seed=0).learn(60)
    contexts = np.random.default_rng(1).uniform(-0.9, 0.9, (5, 2)).astype(np.float32)
    for model, seen in ((bottles[0], None), (taught, contexts), (twin, contexts)):
        rows: Any = model.env.reset() if seen is None else seen  # pyright: ignore
        model.save(tmp_path / "model")
        loaded = type(model).load(tmp_path / "model")
        np.testing.assert_array_equal(
            model.predict(rows, deterministic=True)[0], loaded.predict(rows, deterministic=True)[0]
        )


def test_a_failed_trajectory_does_not_answer_for_its_context(bottles: tuple[Any, Any]) -> None:
    model, task = bottles
    elites, skill = model.policy.elites, model.policy.skill
    failed = elites.contexts[~elites.solved]
    assert len(failed) > 5
    answers, _ = model.predict(failed.numpy(), deterministic=True)
    expected = skill.space.trajectories(failed.numpy(), skill.answer(failed.numpy()))
    low, high = model.action_space.low, model.action_space.high
    np.testing.assert_allclose(answers, np.clip(expected, low, high), atol=1e-5)
    assert task.simulate(failed.numpy(), answers).successes.mean() >= 0.9


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"does not tell what.*relabel=None"):
        RCNMP("MlpPolicy", Reaching(tells=False), relabel=True).learn(20)
    with pytest.raises(InvalidDataError, match=r"is \[5\.0, 0\.0\]; it must lie within"):
        RCNMP("MlpPolicy", Reaching(where=np.array([5.0, 0.0]))).learn(20)
    with pytest.raises(InvalidDataError, match=r"shape \(3,\)"):
        RCNMP("MlpPolicy", Reaching(where=np.zeros(3))).learn(20)
    with pytest.raises(ConfigurationError, match="regression is 'magic'; it must be 'nearest'"):
        GA("MlpPolicy", Reaching(), policy_kwargs={"regression": "magic"})


def test_without_the_reward_condition_the_answer_is_the_regression() -> None:
    env = make_vec_env("nmp/Bottles-v0", env_kwargs={"random_bottles": True, "n_threads": 1})
    settings = {"skill": RCNMPSkill(reward_conditioning=False)}
    model = RCNMP("MlpPolicy", env, seed=1000, policy_kwargs=settings).learn(60)
    skill: Any = model.policy.skill
    contexts = th.as_tensor(np.asarray(env.reset()))
    prior = skill.conditioned.prior_mean(skill.space, contexts).numpy()
    np.testing.assert_allclose(skill.answer(contexts.numpy()), prior, rtol=1e-6)


def test_a_rollout_that_achieved_the_context_is_the_answer() -> None:
    """The model's error at a known rollout is taken off, even if the model knows nothing."""
    rng = np.random.default_rng(0)
    space = SkillSpace(2, (20, 2), 4)
    space.begin(np.zeros((2, 2)), np.zeros((2, 20, 2)), (0.1, 0.1))
    skill = AchievementConditionedSkill(space, 2, RCNMPAchievement())
    achieved, weights = rng.uniform(0.2, 1.0, (12, 2)), rng.normal(size=(12, 8))
    asked = rng.uniform(0.2, 1.0, (12, 2))
    known = Experience(asked, weights, np.zeros(12), np.zeros(12, bool), achieved)
    skill.learn(space, known, th.Generator().manual_seed(0))
    for parameter in skill.model.parameters():
        parameter.zero_()
    answers = skill.answer(space, th.as_tensor(achieved, dtype=th.float32))
    np.testing.assert_allclose(answers.numpy(), weights, atol=1e-5)


def test_what_every_rollout_achieves_as_given_is_a_circumstance() -> None:
    rng = np.random.default_rng(0)
    space = SkillSpace(2, (20, 1), 4)
    space.begin(np.zeros((2, 2)), np.zeros((2, 20, 1)), (0.1,))
    skill = AchievementConditionedSkill(space, 2, RCNMPAchievement())
    asked = rng.uniform(size=(12, 2))
    achieved = np.column_stack([asked[:, 0], rng.uniform(size=12)])
    known = Experience(asked, rng.normal(size=(12, 4)), np.zeros(12), np.zeros(12, bool), achieved)
    skill.learn(space, known, th.Generator().manual_seed(0))
    assert skill.goals.tolist() == [0.0, 1.0]
