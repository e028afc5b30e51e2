"""Several ways to do a task, not told which is which: RC-NMP's categorical latent over contexts."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from stable_baselines3.common.env_util import make_vec_env

from baselines import GA
from benchmark_envs import make_task
from results.exceptions import BenchmarkError
from results.harness.environments import RunTask
from results.stream.protocol import Stream
from sb3_nmp import RCNMP, ConfigurationError, Demonstrations, InvalidDataError
from sb3_nmp.common.contextual import Experience
from sb3_nmp.common.regression import leave_one_out_error, linear_regression
from sb3_nmp.models.ensemble import Ensemble, EnsembleTraining
from sb3_nmp.models.modes import sort_into_modes
from sb3_nmp.models.skill_space import SkillSpace
from sb3_nmp.rcnmp.settings import RCNMPSkill
from sb3_nmp.rcnmp.skill import RewardConditionedSkill

TWO = {"skill": RCNMPSkill(n_modes=2)}
RNG = np.random.default_rng


def two_ways(n: int, noise: float = 0.2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Contexts, weights that are linear in them in one of two ways, and which one."""
    rng = RNG(0)
    contexts, ways = rng.normal(size=(n, 2)), rng.permutation(np.arange(n) % 2)
    slopes = rng.normal(size=(2, 2, 8))
    middles = np.stack([np.full(8, 1.0), np.full(8, -1.0)])
    means = middles[ways] + np.einsum("nc,ncp->np", contexts, slopes[ways])
    return contexts, means + noise * rng.normal(size=(n, 8)), ways


def two_mode_skill(n_modes: int = 2) -> tuple[SkillSpace, RewardConditionedSkill]:
    """A space of those weights, and a skill that has learned nothing."""
    space = SkillSpace(2, (20, 1), 8)
    space.begin(np.zeros((2, 2)), np.zeros((2, 20, 1)), (1.0,))
    return space, RewardConditionedSkill(space, 2, RCNMPSkill(n_modes=n_modes))


class Detour(gym.Env[Any, Any]):
    """A path must end at a drawn height and pass, half-way, 1 above or 1 below that height."""

    observation_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
    action_space = spaces.Box(-3.0, 3.0, (20, 1), np.float32)
    exploration_scale = np.array([0.3])

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.height = self.np_random.uniform(-1.0, 1.0, 1).astype(np.float32)
        return self.height, {}

    def initial_trajectory(self) -> np.ndarray:
        return np.zeros((20, 1))

    def step(self, action: Any) -> Any:
        miss = float(self.misses(self.height[None], action[None])[0])
        return self.height, -miss, True, False, {"is_success": miss < 0.2}

    @staticmethod
    def misses(heights: np.ndarray, paths: np.ndarray) -> np.ndarray:
        ends = np.abs(paths[:, -1, 0] - heights[:, 0])
        return ends + np.abs(np.abs(paths[:, 10, 0] - heights[:, 0]) - 1.0)


def detours(n: int) -> Demonstrations:
    """Both ways in turn, with a smooth path for each."""
    heights = RNG(3).uniform(-1.0, 1.0, (n, 1))
    times = np.linspace(0.0, 1.0, 20)
    way = np.where(np.arange(n) % 2, -1.0, 1.0)[:, None]
    paths = heights * (1 - np.cos(np.pi * times)) / 2 + way * np.sin(np.pi * times) ** 2
    paths += heights * np.sin(np.pi * times) ** 2 / 2  # half-way at height + way
    return Demonstrations(heights, paths[:, :, None])


def many() -> Any:
    return make_vec_env(Detour, n_envs=10)


@pytest.fixture(scope="module")
def shown() -> Any:
    """RC-NMP with two modes after 200 rollouts, shown both ways."""
    model = RCNMP("MlpPolicy", many(), seed=0, demonstrations=detours(12), policy_kwargs=TWO)
    return model.learn(200)


HEIGHTS = np.linspace(-0.9, 0.9, 40, dtype=np.float32)[:, None]


# -- telling modes apart -----------------------------------------------------------------------


def agreement(labels: np.ndarray, ways: np.ndarray) -> float:
    return max(float((labels == ways).mean()), float((labels != ways).mean()))


def test_two_ways_are_told_apart_though_their_slopes_differ() -> None:
    contexts, weights, ways = two_ways(40)
    assert agreement(sort_into_modes(contexts, weights, 2), ways) == 1.0
    assert agreement(sort_into_modes(contexts, weights, 4), ways) == 1.0, "there are but two"


def test_the_commonest_mode_comes_first_and_a_rare_one_is_found() -> None:
    contexts, weights, ways = two_ways(40)
    rare = np.flatnonzero(ways == 1)[:3]
    rows = np.concatenate([np.flatnonzero(ways == 0), rare])
    labels = sort_into_modes(contexts[rows], weights[rows], 2)
    assert labels.tolist() == [0] * 20 + [1] * 3


def test_one_way_is_not_split_by_its_noise() -> None:
    contexts, weights, ways = two_ways(200, noise=1.0)
    one = ways == 0
    assert (sort_into_modes(contexts[one], weights[one], 3) == 0).all()


@pytest.mark.parametrize("n", [1, 2, 3])
def test_more_modes_than_rows_are_no_trouble(n: int) -> None:
    contexts, weights, _ = two_ways(n)
    labels = sort_into_modes(contexts, weights, 5)
    assert labels.shape == (n,)
    assert set(labels) == set(range(labels.max() + 1)), "no mode is empty"


# -- answers -----------------------------------------------------------------------------------


def test_both_ways_are_learned(shown: Any) -> None:
    """A collapse would leave one way, or their mean, which passes half-way at the height itself."""
    paths, promises = shown.policy.modes(HEIGHTS)
    assert paths.shape == (40, 2, 20, 1) and promises.shape == (40, 2)
    passed = paths[:, :, 10, 0] - HEIGHTS
    assert (np.sign(passed[:, 0]) == -np.sign(passed[:, 1])).all()
    for k in range(2):
        assert np.mean(Detour.misses(HEIGHTS, paths[:, k]) < 0.2) >= 0.9


def test_the_answer_is_the_mode_that_promises_most() -> None:
    """Of two ways that were shown, one succeeds where c_0 < 0, the other elsewhere."""
    contexts, weights, ways = two_ways(300)
    good = (contexts[:, 0] < 0) == (ways == 0)
    tried = Experience(contexts, weights, np.where(good, 0.0, -3.0), good, None)
    space, skill = two_mode_skill()
    skill.learn(space, tried.after(contexts[:40], weights[:40]), th.Generator().manual_seed(0))
    asked = th.tensor([[-1.0, 0.5], [-1.0, -0.5], [1.0, 0.5], [1.0, -0.5]])
    answers, promises = skill.modes(space, asked)
    best = promises.argmax(dim=1)
    assert best[0] == best[1] != best[2] == best[3]
    th.testing.assert_close(skill.answer(space, asked), answers[th.arange(4), best])
    first = 0 if skill.prior_mean(space, th.zeros(1, 2), 0).mean() > 0 else 1  # way 0 is around +1
    assert best.tolist() == [first, first, 1 - first, 1 - first]


def test_exploration_takes_the_modes_in_turn(shown: Any) -> None:
    skill = shown.policy.skill
    weights, _ = skill.modes(HEIGHTS[:4])
    explored = skill.explore(HEIGHTS[:4], np.arange(3, 7))
    np.testing.assert_array_equal(explored, weights[np.arange(4), [1, 0, 1, 0]])


def test_a_saved_model_knows_its_modes(shown: Any, tmp_path: Path) -> None:
    shown.save(tmp_path / "model")
    loaded = RCNMP.load(tmp_path / "model", env=many())
    for before, after in zip(
        shown.policy.modes(HEIGHTS), loaded.policy.modes(HEIGHTS), strict=True
    ):
        np.testing.assert_array_equal(before, after)
    loaded.load_replay_buffer(_saved_buffer(shown, tmp_path))
    loaded.learn(60, reset_num_timesteps=False)
    known: Any = loaded._search
    assert len(known.shown[0]) == 12, "what was shown is remembered when training goes on"


def _saved_buffer(model: Any, folder: Path) -> str:
    model.save_replay_buffer(folder / "buffer.npz")
    return str(folder / "buffer.npz")


# -- demonstrations ----------------------------------------------------------------------------


def experience(n: int, rewards: np.ndarray) -> Experience:
    contexts, weights, _ = two_ways(n)
    return Experience(contexts, weights, rewards, rewards > -1.0, None)


def test_demonstrations_are_right_and_have_no_reward() -> None:
    known = experience(4, np.array([-2.0, -0.5, -2.0, -0.2]))
    known = known.after(np.zeros((3, 2)), np.ones((3, 8)))
    assert known.right.tolist() == [0, 1, 2, 4, 6]
    assert known.rated.tolist() == [3, 4, 5, 6]


def test_a_demonstration_does_not_enter_the_reward_model() -> None:
    known = experience(12, np.linspace(-2.0, 0.0, 12))
    far = known.after(known.contexts[:2], 50.0 + known.weights[:2])
    skills: list[RewardConditionedSkill] = []
    for each in (known, far):
        space, skill = two_mode_skill()
        skill.learn(space, each, th.Generator().manual_seed(0))
        skills.append(skill)
    for name in ("rewards", "moments"):
        alike = [getattr(skill, name).mean for skill in skills]
        th.testing.assert_close(*alike)
    assert skills[0].target_reward == skills[1].target_reward


@pytest.mark.parametrize("algorithm", [RCNMP, GA])
def test_what_was_shown_answers_before_a_rollout_succeeds(algorithm: Any) -> None:
    """One way is shown; the first generation follows it already."""
    model = algorithm("MlpPolicy", many(), seed=0, demonstrations=detours(24)[::2])
    model.learn(20)
    assert model._search.example is None and model._search.shown is not None
    blind = algorithm("MlpPolicy", many(), seed=0).learn(20)
    passed = model.replay_buffer.trajectories[:, 10, 0] - model.replay_buffer.contexts[:, 0]
    assert np.mean(passed > 0) >= 0.9
    assert model.replay_buffer.rewards.mean() > blind.replay_buffer.rewards.mean() + 0.3


def test_before_a_success_the_commonest_mode_answers() -> None:
    space, skill = two_mode_skill()
    contexts, weights, ways = two_ways(40)
    rows = np.concatenate([np.flatnonzero(ways == 0), np.flatnonzero(ways == 1)[:5]])
    nothing = Experience(np.empty((0, 2)), np.empty((0, 8)), np.empty(0), np.empty(0, bool), None)
    skill.learn(space, nothing.after(contexts[rows], weights[rows]), th.Generator())
    asked = th.zeros(3, 2)
    th.testing.assert_close(skill.answer(space, asked), skill.prior_mean(space, asked, 0))
    assert skill.shares.tolist() == pytest.approx([0.8, 0.2])


def test_one_mode_is_one_regression_on_all_that_was_right_bit_for_bit() -> None:
    """The same draws in the same order as before there were modes."""
    space, skill = two_mode_skill(n_modes=1)
    known = experience(30, np.linspace(-1.5, 0.0, 30))
    skill.learn(space, known, th.Generator().manual_seed(5))
    generator = th.Generator().manual_seed(5)
    prior, _ = (Ensemble(skill.sizes[name], 8, generator) for name in ("prior", "reward"))
    contexts, weights = (
        th.as_tensor(rows, dtype=th.float32) for rows in (known.contexts, known.weights)
    )
    right = th.as_tensor(known.right)
    middle, rows = weights[right].mean(dim=0), skill.contexts(contexts)
    wanted = (weights[right] - middle) / space.scale
    with th.enable_grad():
        prior.fit(rows[right], wanted, 30, EnsembleTraining(), generator)
    expected = middle + space.scale * prior(rows).mean(dim=0)
    assert skill.n_found == 1 and 10 < len(right) < 30
    assert th.equal(skill.prior_mean(space, contexts), expected)


# -- what was shown, and a few rollouts --------------------------------------------------------


def shown_linear() -> tuple[np.ndarray, np.ndarray]:
    """Twelve contexts, and weights that are linear in them."""
    rng = RNG(4)
    contexts = rng.normal(size=(12, 2))
    return contexts, contexts @ rng.normal(size=(2, 8)) + 1.0


def nothing() -> Experience:
    return Experience(np.empty((0, 2)), np.empty((0, 8)), np.empty(0), np.empty(0, bool), None)


def rolled_out(n: int, rewards: np.ndarray) -> Experience:
    rng = RNG(6)
    return Experience(rng.normal(size=(n, 2)), rng.normal(size=(n, 8)), rewards, rewards > 0, None)


def test_what_was_shown_is_answered_as_its_regression_does_from_the_beginning() -> None:
    contexts, weights = shown_linear()
    space, skill = two_mode_skill(n_modes=1)
    skill.learn(space, nothing().after(contexts, weights), th.Generator().manual_seed(0))
    far = RNG(5).normal(size=(20, 2)) * 2.0
    slopes = np.linalg.lstsq(contexts, weights - 1.0, rcond=None)[0]
    answers = skill.answer(space, th.as_tensor(far, dtype=th.float32)).numpy()
    assert np.abs(answers - (far @ slopes + 1.0)).max() < 0.15  # weights are up to 10


def test_a_reward_model_is_believed_as_far_as_it_has_foretold_new_rollouts() -> None:
    """Rewards that nothing explains must not move what was shown; those that it explains do."""
    contexts, weights = shown_linear()
    moved, errors = [], []
    for explained in (False, True):
        space, skill = two_mode_skill(n_modes=1)
        tried = rolled_out(200, RNG(7).normal(size=200))
        if explained:
            # the higher the trajectory, the better, up to the best of those that were tried
            tried.rewards[:] = 3.0 * tried.weights.mean(axis=1)
            tried.successes[:] = tried.rewards > 1.0
        for n in (160, 200):
            part = Experience(
                tried.contexts[:n], tried.weights[:n], tried.rewards[:n], tried.successes[:n], None
            )
            skill.learn(space, part.after(contexts, weights), th.Generator().manual_seed(0))
        asked = th.as_tensor(contexts, dtype=th.float32)
        step = skill.answer(space, asked) - skill.prior_mean(space, asked)
        moved.append(float(step.pow(2).mean().sqrt()))
        errors.append(float(skill.residual))
    assert errors[0] > 0.8 > 0.5 > errors[1]
    assert moved[0] < 0.5 * moved[1]


def test_before_a_reward_model_has_foretold_anything_it_is_as_good_as_a_constant() -> None:
    contexts, weights = shown_linear()
    space, skill = two_mode_skill(n_modes=1)
    tried = rolled_out(20, RNG(7).normal(size=20))
    skill.learn(space, tried.after(contexts, weights), th.Generator().manual_seed(0))
    assert float(skill.residual) == 1.0
    skill.learn(space, tried, th.Generator().manual_seed(0))  # where nothing is shown, its own
    assert float(skill.residual) < 0.9


def test_the_error_of_leaving_one_out_is_that_of_fitting_without_it() -> None:
    rng = RNG(2)
    known, values = rng.normal(size=(15, 3)), rng.normal(size=(15, 4))
    squares = []
    for row in range(15):
        others = np.arange(15) != row
        centre, middle, slopes = linear_regression(known[others], values[others], 1e-9)
        squares.append((values[row] - middle - (known[row] - centre) @ slopes) ** 2)
    assert leave_one_out_error(known, values, 1e-9) == pytest.approx(np.mean(squares), rel=1e-6)


# -- protocol, and what is refused -------------------------------------------------------------


def test_a_stream_shows_the_modes_in_turn() -> None:
    task = make_task("nmp/Bottles-v0", random_bottles=True, n_threads=1)
    mixed = Demonstrations.from_task(task, 6, seed=0, modes=task.modes)
    plain = Demonstrations.from_task(task, 6, seed=0)
    np.testing.assert_array_equal(mixed.contexts, plain.contexts)
    told = [task.mode_of(*each) for each in zip(mixed.contexts, mixed.trajectories, strict=True)]
    assert told == ["s", "reverse_s"] * 3
    run = RunTask("nmp/Bottles-v0", 0, 20, settings={"random_bottles": True})
    shown = Stream(6, 10, 10, modes="mixed").demonstrations(run)
    assert shown is not None
    ways = [task.mode_of(*each) for each in zip(shown.contexts, shown.trajectories, strict=True)]
    assert ways == ["s", "reverse_s"] * 3


def test_a_stream_of_one_mode_has_the_settings_of_old_records() -> None:
    assert Stream().settings == {"n_demonstrations": 30, "n_contexts": 1000, "n_test": 1000}
    assert Stream(modes="mixed").settings["modes"] == "mixed"


def test_what_cannot_be_is_refused() -> None:
    for wrong in (0, -1, 1.5):
        with pytest.raises(ConfigurationError, match=rf"n_modes is {wrong}; .*>= 1"):
            RCNMPSkill(n_modes=wrong)  # pyright: ignore[reportArgumentType]
    with pytest.raises(BenchmarkError, match="modes is 'both'; a stream shows first or mixed"):
        Stream(modes="both")  # pyright: ignore[reportArgumentType]
    task = make_task("nmp/Bottles-v0", n_threads=1)
    for none in ((), "s"):
        with pytest.raises(InvalidDataError, match="it must name one or more, or be None"):
            Demonstrations.from_task(task, 2, modes=none)
    with pytest.raises(ConfigurationError, match="no modes are known: train with"):
        RCNMP("MlpPolicy", many()).policy.modes(HEIGHTS)
