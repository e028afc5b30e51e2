"""What was cut short: by an error, another environment or population, or a lost buffer."""

import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from baselines import CMAES, CMAME, GA, REPS, ContextualCMAES, RandomSearch, TuRBO
from sb3_nmp import (
    ACNMP,
    RCNMP,
    CNMPPretraining,
    ConfigurationError,
    Demonstrations,
    InvalidDataError,
    RCNMPTraining,
    ResumeWarning,
)
from tests.registry import SMALL

T = 20
CONTEXTS = np.linspace(-0.9, 0.9, 4)[:, None]
SHOWN = Demonstrations(CONTEXTS, np.stack([np.linspace([0.0], c, T) for c in CONTEXTS]))


class Reach(gym.Env[Any, Any]):
    """From 0 to c: drawn, pinned, or asked for by option.

    :param pinned: the context; None draws it
    :param tolerance: of a success
    :param broken: the number of the rollout whose reward is NaN, or whose info is `wrong`
    :param wrong: added to the info of the broken one, instead of the NaN
    :param takes_options: whether a context can be asked for
    """

    observation_space = spaces.Box(-1.0, 1.0, (1,))
    action_space = spaces.Box(-3.0, 3.0, (T, 1))
    exploration_scale = (0.3,)

    def __init__(
        self,
        pinned: float | None = None,
        tolerance: float = 0.5,
        broken: int = -1,
        wrong: dict[str, Any] | None = None,
        takes_options: bool = True,
    ) -> None:
        self.pinned, self.tolerance, self.broken = pinned, tolerance, broken
        self.wrong, self.takes_options = wrong, takes_options
        self.executed: list[tuple[float, float]] = []

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        drawn = self.np_random.uniform(-1, 1) if self.pinned is None else self.pinned
        if self.takes_options and options and "context" in options:
            drawn = float(options["context"][0])
        self.context = np.array([drawn], np.float32)
        return self.context.copy(), {}

    def initial_trajectory(self) -> Any:
        return np.zeros((T, 1))

    def step(self, action: Any) -> Any:
        miss = float(abs(action[0, 0]) + abs(action[-1, 0] - self.context[0]))
        self.executed.append((float(self.context[0]), miss))
        info: dict[str, Any] = {"is_success": miss < self.tolerance}
        is_broken = len(self.executed) == self.broken
        if is_broken and self.wrong is not None:
            info |= self.wrong
        reward = np.nan if is_broken and self.wrong is None else -miss
        return self.context.copy(), reward, True, False, info


def envs(n: int = 1, **settings: Any) -> Any:
    return DummyVecEnv([lambda: Reach(**settings) for _ in range(n)])


QUICK: dict[Any, dict[str, Any]] = {
    RCNMP: {"training": RCNMPTraining(3), "n_crossover": 4, "n_candidates": 2},
    GA: {"n_crossover": 4},
    REPS: {},
    RandomSearch: {},
    CMAES: {},
    ContextualCMAES: {},
    CMAME: {"n_emitters": 2},
    ACNMP: {
        "demonstrations": SHOWN,
        "pretraining": CNMPPretraining(5),
        "policy_kwargs": {"cnmp": SMALL},
    },
}
EVERY = pytest.mark.parametrize("algorithm", QUICK, ids=lambda each: each.__name__)


def made(algorithm: Any, env: Any, **settings: Any) -> Any:
    if algorithm is CMAME:
        pytest.importorskip("ribs", reason="the extra 'qd' is not installed")
    return algorithm("MlpPolicy", env, seed=0, population_size=8, **(QUICK[algorithm] | settings))


@EVERY
@pytest.mark.parametrize(
    "wrong", [None, {"is_success": np.nan}, {"step_rewards": [np.nan] * T}], ids=str
)
def test_after_a_refused_rollout_the_next_one_is_in_the_context_that_is_known(
    algorithm: Any, wrong: dict[str, Any] | None
) -> None:
    env = envs(broken=12, wrong=wrong)
    model = made(algorithm, env)
    with pytest.raises(InvalidDataError):
        model.learn(30)
    np.testing.assert_array_equal(model._last_obs, [env.envs[0].unwrapped.context])
    told: list[Any] = []
    model.learn(
        8,
        callback=lambda found, _: told.extend(found["contexts"][:, 0]) is None,
        reset_num_timesteps=False,
    )
    executed = [context for context, _ in env.envs[0].unwrapped.executed[12:]]
    np.testing.assert_array_equal(np.array(executed, np.float32), told)


@EVERY
def test_another_environment_in_the_middle_of_a_generation_begins_it_anew(algorithm: Any) -> None:
    model = made(algorithm, envs(pinned=0.5)).learn(11)
    with pytest.warns(ResumeWarning, match="the environment was exchanged: it begins anew"):
        model.set_env(envs(pinned=-0.5))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResumeWarning)
        model.learn(16)
    assert model._n_collected == 0
    if algorithm in (RCNMP, GA):
        assert not model._varies
        assert set(model.replay_buffer.contexts[:, 0].tolist()) == {-0.5}


def test_another_pinned_context_given_to_load_begins_a_generation_anew(tmp_path: Path) -> None:
    made(GA, envs(pinned=0.5)).learn(11).save(tmp_path / "model")
    loaded: Any = GA.load(tmp_path / "model", env=envs(pinned=-0.5))
    with pytest.warns(ResumeWarning) as told:
        loaded.learn(16)
    assert any("3 of 8 rollouts" in str(each.message) for each in told)
    assert any("another context is pinned" in str(each.message) for each in told)
    assert not loaded._varies
    assert set(loaded.replay_buffer.contexts[:, 0].tolist()) == {-0.5}


def test_contexts_that_were_drawn_for_a_generation_are_not_asked_of_the_next_environment() -> None:
    model = REPS("MlpPolicy", envs(), population_size=8, rollouts_per_context=2, seed=0).learn(4)
    with pytest.warns(ResumeWarning):
        model.set_env(envs(pinned=0.5, takes_options=False))
    assert model.learn(16).num_timesteps == 16


@EVERY
def test_a_generation_of_another_size_begins_anew(algorithm: Any, tmp_path: Path) -> None:
    if algorithm is ACNMP:
        pytest.skip("its generations keep the proposals that they were begun with")
    made(algorithm, envs(pinned=0.5)).learn(9).save(tmp_path / "model")
    loaded = algorithm.load(tmp_path / "model", env=envs(pinned=0.5), population_size=12)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", ResumeWarning)
        loaded.learn(30, reset_num_timesteps=False)
    assert loaded.num_timesteps == 39
    if algorithm not in (CMAES, RandomSearch, CMAME):  # these keep proposals as ACNMP does
        assert any("generations have 12 rollouts now" in str(each.message) for each in told)


def test_a_population_that_is_rounded_up_after_loading_begins_a_generation_anew(
    tmp_path: Path,
) -> None:
    GA("MlpPolicy", envs(pinned=0.5), seed=0).learn(9).save(tmp_path / "model")
    loaded: Any = GA.load(tmp_path / "model", env=envs(3, pinned=0.5))
    assert loaded.population_size == 21
    with pytest.warns(ResumeWarning, match="9 of 20 rollouts"):
        loaded.learn(30, reset_num_timesteps=False)
    assert loaded.num_timesteps == 39


def test_a_refused_environment_is_not_learned_in() -> None:
    model = made(GA, envs(pinned=0.5)).learn(3)
    before = model.env
    with pytest.raises(ConfigurationError, match="norm_obs=False"):
        model.set_env(VecNormalize(envs(pinned=0.5)))
    assert model.env is before
    with pytest.raises(ConfigurationError, match="8 does not fit 3"):
        model.set_env(envs(3, pinned=0.5))
    assert model.env is before and model.n_envs == 1
    assert model.learn(13, reset_num_timesteps=False).num_timesteps == 16


@pytest.mark.parametrize("algorithm", [RCNMP, GA])
def test_explorers_leave_room_for_a_test_of_two_ways(algorithm: Any) -> None:
    with pytest.raises(ConfigurationError, match=r"n_explorers is 7.*less by 2"):
        made(algorithm, envs(pinned=0.5), n_modes=2, n_explorers=7)
    model = made(algorithm, envs(pinned=0.5, tolerance=5.0), n_modes=2, n_explorers=6)
    assert model.learn(40).num_timesteps == 40


@pytest.mark.parametrize("algorithm", [RCNMP, GA])
def test_modes_are_sought_anew_where_the_replay_buffer_was_lost(
    algorithm: Any, tmp_path: Path
) -> None:
    settings = {"n_modes": 2, "pd_controller": None}
    model = made(algorithm, envs(pinned=0.5, tolerance=5.0), **settings).learn(40)
    assert model._niches.best and max(model._niches.best) > 8
    model.save(tmp_path / "model")
    loaded = algorithm.load(tmp_path / "model", env=envs(pinned=0.5, tolerance=5.0))
    with pytest.warns(ResumeWarning, match="learns without them"):
        loaded.learn(16, reset_num_timesteps=False)
    assert max(loaded._niches.best) < 16
    assert loaded._n_before == 5, "the noise begins anew"


@pytest.mark.parametrize("algorithm", [RCNMP, GA])
def test_a_skill_does_not_learn_from_rows_of_a_lost_buffer(algorithm: Any, tmp_path: Path) -> None:
    model = made(algorithm, envs()).learn(160)
    assert model._search.learned_from > 0 and model._search.example is not None
    model.save(tmp_path / "model")
    loaded = algorithm.load(tmp_path / "model", env=envs())
    with pytest.warns(ResumeWarning, match="learns without them"):
        loaded.learn(48, reset_num_timesteps=False)
    example = loaded._search.example
    assert example is None or loaded.replay_buffer.successes[example]
    assert loaded._search.learned_from <= 48


def test_ways_of_another_context_are_forgotten_with_their_archive() -> None:
    model = made(CMAME, envs(pinned=0.5, tolerance=3.0), pd_controller=None).learn(40)
    assert len(model.policy.ways.rewards) > 1
    model.set_env(envs(pinned=-0.9, tolerance=0.0))
    model.learn(40)
    assert len(model.policy.ways.rewards) == 0


def test_strategies_that_were_asked_twice_go_on_after_saving(tmp_path: Path) -> None:
    model = made(CMAME, envs(2, pinned=0.5, tolerance=0.0)).learn(12)
    model._collected, model._generation_started = [], False  # dropped without being told
    model.learn(4, reset_num_timesteps=False)
    model.save(tmp_path / "model")
    loaded: Any = CMAME.load(tmp_path / "model", env=envs(2, pinned=0.5, tolerance=0.0))
    executed = []
    for each in (model, loaded):
        env = each.env
        each.learn(20, reset_num_timesteps=False)
        executed.append([inner.unwrapped.executed[-10:] for inner in env.envs])
    assert executed[0] == executed[1]


def test_numbers_given_to_load_are_kept_and_those_of_the_making_are_not_changed(
    tmp_path: Path,
) -> None:
    made(ACNMP, envs()).save(tmp_path / "acnmp")
    assert ACNMP.load(tmp_path / "acnmp", env=envs(), n_contexts=12).n_contexts == 12
    assert ACNMP.load(tmp_path / "acnmp", env=envs()).n_contexts == 8
    made(ContextualCMAES, envs()).learn(8).save(tmp_path / "strategy")
    with pytest.raises(ConfigurationError, match="context_features is 'linear'"):
        ContextualCMAES.load(tmp_path / "strategy", env=envs(), context_features="linear")
    shown = {"demonstrations": SHOWN, "pretraining": CNMPPretraining(5)}
    made(CMAES, envs(), context_std=0.3, **shown).save(tmp_path / "residual")
    with pytest.raises(ConfigurationError, match="context_std is 0"):
        CMAES.load(tmp_path / "residual", env=envs(), context_std=0.0)


def test_a_design_fills_the_space_where_a_greedy_rollout_came_before() -> None:
    pytest.importorskip("botorch", reason="the extra 'bo' is not installed")
    settings: dict[str, Any] = {"n_initial": 12, "n_bases": 3, "max_iterations": 3}
    model = TuRBO(
        "MlpPolicy", envs(tolerance=0.0), seed=0, population_size=4, n_candidates=20, **settings
    ).learn(4)
    searches: list[Any] = [each.search for each in model.searches]
    assert [len(each.points) for each in searches] == [1] * 4
    model.learn(16, reset_num_timesteps=False)
    for each in searches:
        tried = 0.5 + each.points[1:5] / (2 * each.reach)
        np.testing.assert_allclose(tried, np.clip(each._design[:4], 0, 1), atol=1e-3)


def test_rewards_whose_terms_change_are_refused() -> None:
    model = made(GA, envs(pinned=0.5, broken=5, wrong={"reward_bonus": 1.0}))
    with pytest.raises(InvalidDataError, match=r"terms were \[\], and then \['bonus'\]"):
        model.learn(8)
