"""What environments tell wrongly, and calls that SB3 or NumPy would answer in their own words."""

import io
import warnings
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.callbacks import BaseCallback, EvalCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

from baselines import BO, CMAES, GA, REPS, ContextualREPS, RandomSearch
from sb3_nmp import (
    ACNMP,
    RCNMP,
    CNMPPretraining,
    ConfigurationError,
    Demonstrations,
    DemonstrationWarning,
    InvalidDataError,
    ResumeWarning,
)
from sb3_nmp.common.resampling import resample
from sb3_nmp.zoo.entries import ENTRIES
from tests.registry import ENV_ID
from tests.test_algorithms import build, run, vec_env
from tests.test_bad_input import INF, NAN, SHOWN, Call, made, of_bottles, plain, saved
from tests.test_environment_faces import Plain

ZEROS = np.zeros((5, 2))


class Telling(Plain):
    """Tells what it was made with, from its seventh rollout on."""

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.context = np.zeros(1, np.float32)
        return self.context, {}

    reward: float | None = None
    told: dict[str, Any] = {}  # noqa: RUF012
    n = 0

    def step(self, action: Any) -> Any:
        context, reward, *ended, _ = super().step(action)
        self.n += 1
        if self.n < 7:
            return context, reward, *ended, {}
        return context, reward if self.reward is None else self.reward, *ended, self.told


class Lost(Plain):
    """Observes no finite context once, after nine resets; it is drawn or pinned."""

    drawn = False
    n = 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        asked = (options or {}).get("context")
        if asked is not None or not self.drawn:
            self.context = np.zeros(1, np.float32) if asked is None else asked
        self.n += 1
        return np.full(1, NAN, np.float32) if self.n == 9 else self.context, {}


def lost(drawn: bool) -> Any:
    env = Lost()
    env.drawn = drawn
    return env


def telling(reward: float | None = None, **told: Any) -> Any:
    return type("Wrong", (Telling,), {"reward": reward, "told": told})()


def learnt(algorithm: Any, env: Any, **arguments: Any) -> object:
    return made(algorithm, env, seed=0, **arguments).learn(40)


def told(**hints: Any) -> Any:
    return plain(**hints)


def hint(value: Any) -> Any:
    return told(initial_trajectory=lambda _: value)


def rescaled(wrapper: Any) -> Any:
    return wrapper(gym.make(ENV_ID), np.float32(-1.0), np.float32(1.0))


QUICK = {"demonstrations": SHOWN, "pretraining": CNMPPretraining(5)}
SCALE_RULE = ("the environment's exploration_scale is", "one finite number > 0", "a tuple of 2")
INITIAL_RULE = ("the environment's initial_trajectory", "(T, D) = (5, 2)")
LEARN = {"total_timesteps": 20}
CALLBACK_RULE = ("callback is", "a BaseCallback of SB3, a list of them, or a function")
CONTEXT_RULE = ("the context is", "of shape (C,) or (N, C), where C is 1")
PATH_RULE = ("path is", "a path, or a file that is open for bytes")

BAD: dict[str, tuple[Call, tuple[str, ...]]] = {
    **{
        f"a reward of {reward} for {algorithm.__name__}": (
            lambda _, a=algorithm, s=settings, r=reward: learnt(a, telling(r), **s),
            (f"the reward {reward} in the context", "rewards must be finite", "the worst reward"),
        )
        for algorithm, settings in (
            (ACNMP, QUICK), (CMAES, QUICK), (BO, {"demonstrations": SHOWN}), (RandomSearch, {}),
            (REPS, {}), (GA, {}), (RCNMP, {}),
        )
        for reward in (NAN, -INF)
    },
    **{
        f"a context of nan, {'drawn' if drawn else 'pinned'}, for {algorithm.__name__}": (
            lambda _, a=algorithm, s=settings, d=drawn: learnt(a, lost(d), **s),
            ("environment 0 observed the context [nan]", "must be finite", "its reset"),
        )
        for algorithm, settings in (
            (ACNMP, QUICK), (BO, {"demonstrations": SHOWN}), (RandomSearch, {}), (REPS, {}),
            (ContextualREPS, {}), (GA, {}), (RCNMP, {}),
        )
        for drawn in (False, True)
    },
    **{
        f"{name} of {context!r}": (
            lambda _, n=name, c=context: getattr(made(RCNMP).policy, n)(c), told,
        )
        for name in ("greedy", "own_answer")
        for context, told in (
            (np.zeros((2, 3)), CONTEXT_RULE), (np.array([NAN]), ("[nan]", "not finite")),
        )
    },
    "a success of two": (
        lambda _: learnt(GA, telling(is_success=np.array([True, False]))),
        ("info['is_success'] is array([ True, False])", "one number or truth value"),
    ),
    "a success in words": (
        lambda _: learnt(GA, telling(is_success="yes")), ("info['is_success'] is 'yes'",),
    ),
    "a term in words": (
        lambda _: learnt(GA, telling(reward_height="a")), ("info['reward_height'] is 'a'",),
    ),
    "an achieved context in words": (
        lambda _: learnt(GA, telling(achieved_context="x")),
        ("info['achieved_context']", "dtype <U1", "numbers of shape (1,)"),
    ),
    **{
        f"a scale of {scale!r} of its own": (
            lambda _, s=scale: learnt(GA, told(exploration_scale=s)), SCALE_RULE,
        )
        for scale in (NAN, -1.0, 0.0, INF, None, "x", (0.1, 0.2, 0.3))
    },
    "an initial trajectory of another shape": (
        lambda _: learnt(REPS, hint(np.zeros((4, 2)))), (*INITIAL_RULE, "(4, 2)"),
    ),
    "an initial trajectory for many contexts": (
        lambda _: learnt(RCNMP, hint(np.zeros((4, 2)))), (*INITIAL_RULE, "(4, 2)"),
    ),
    "no initial trajectory": (lambda _: learnt(REPS, hint(None)), INITIAL_RULE),
    "an initial trajectory of nan": (
        lambda _: learnt(RandomSearch, hint(np.full((5, 2), NAN))), (*INITIAL_RULE, "not finite"),
    ),
    "an initial trajectory that is no method": (
        lambda _: learnt(REPS, told(initial_trajectory=ZEROS)), (*INITIAL_RULE, "cannot be called"),
    ),
    "a rescaled action space": (
        lambda _: learnt(GA, rescaled(gym.wrappers.RescaleAction)),
        ("in the unit of its own action space", "from -0.6 to 0.9", "Leave wrappers", "out"),
    ),
    "a callback that is a number": (lambda _: made().learn(**LEARN, callback=3), CALLBACK_RULE),
    "callbacks that are numbers": (lambda _: made().learn(**LEARN, callback=[3]), CALLBACK_RULE),
    "a callback's class": (
        lambda _: made().learn(**LEARN, callback=EvalCallback), (*CALLBACK_RULE, "add brackets"),
    ),
    "an interval in words": (
        lambda _: made().learn(**LEARN, log_interval="a"), ("log_interval is 'a'", "or None"),
    ),
    "a budget of True": (lambda _: made().learn(True), ("total_timesteps is True",)),
    "a seed of True": (lambda _: made(seed=True), ("seed is True", "a whole number in [0")),
    "a policy that is a number": (
        lambda _: made(policy=cast(Any, 3)), ("policy is 3", "MlpPolicy"),
    ),
    "a policy that is no policy": (
        lambda _: made(policy=cast(Any, dict)), ("<class 'dict'>", "MlpPolicy"),
    ),
    "a schedule of words": (
        lambda _: made(RCNMP, learning_rate=lambda _: "a"), ("learning_rate is", "a schedule of"),
    ),
    **{
        f"a schedule that comes to {last}": (
            lambda _, r=last: of_bottles(
                RCNMP, learning_rate=lambda left: 1e-3 if left == 1 else r
            ).learn(30),
            (f"gives {last} where", "of the budget remains", "finite and >= 0"),
        )
        for last in (NAN, -1e-3)
    },
    "a window below 1": (
        lambda _: made(stats_window_size=-1), ("stats_window_size is -1", "1 or more"),
    ),
    **{
        f"to predict {context!r}": (
            lambda _, c=context: made().predict(c), CONTEXT_RULE,
        )
        for context in ("a", ["a"], {"a": 1}, None, [0.0, 0.0], np.zeros((2, 3)))
    },
    "to predict nothing": (
        lambda _: made().predict(np.zeros((0, 1))), ("no context was given", "no rows"),
    ),
    "to save in a number": (lambda _: made().save(3), PATH_RULE),
    "to save in a text file": (lambda _: made().save(io.StringIO()), PATH_RULE),
    "to load a number": (lambda _: REPS.load(3), PATH_RULE),
    "to load a folder": (lambda folder: REPS.load(folder), ("is a folder", "name a file in it")),
    "to set an id that is not registered": (
        lambda _: made().set_env("nmp/Nope-v0"), ("no environment 'nmp/Nope-v0'", "nmp/Bottles-v0"),
    ),
    "to set an environment of other spaces": (
        lambda _: made().set_env("nmp/Bottles-v0"), ("space of env is", "the model's is"),
    ),
    "to load with other spaces": (
        lambda folder: REPS.load(saved(folder), env="nmp/Bottles-v0"), ("space of env is",),
    ),
    "to set more environments": (
        lambda _: made().set_env(DummyVecEnv([Plain] * 7)), ("7 parallel", "the model has 1"),
    ),
    "to begin with a seed below 0": (lambda _: made().set_random_seed(-1), ("seed is -1",)),
    "to set a number as environment": (lambda _: made().set_env(3), ("env is 3", "a VecEnv")),
    "steps in words": (
        lambda _: resample([ZEROS], cast(Any, "a")), ("n_steps is 'a'", "whole number"),
    ),
    "half a step": (lambda _: resample([ZEROS], cast(Any, 2.5)), ("n_steps is 2.5", "at least 2")),
    "trajectories of unequal dimensions": (
        lambda _: resample([np.zeros((3, 2)), np.zeros((9, 3))], 5),
        ("[(2,), (3,)]", "the same dimensions"),
    ),
    "a trajectory in words": (lambda _: resample(["a"], 5), ("trajectory 0 is 'a'", "(T, D)")),
    "a dataset that is a number": (
        lambda _: Demonstrations.from_minari(3), ("dataset is 3", "a minari.MinariDataset"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("algorithm", [RCNMP, REPS, RandomSearch])
def test_learning_goes_on_after_a_context_that_was_not_finite(algorithm: Any) -> None:
    model = made(algorithm, lost(drawn=False), seed=0)
    with pytest.raises(InvalidDataError):
        model.learn(40)
    before = model.num_timesteps
    assert 0 < before < 9
    assert model.learn(22, reset_num_timesteps=False).num_timesteps == before + 22


@pytest.mark.parametrize("kind", BAD)
def test_it_is_told_with_value_rule_and_way_out(kind: str, tmp_path: Path) -> None:
    if "dataset" in kind:
        pytest.importorskip("minari", reason="Minari is not installed")
    call, parts = BAD[kind]
    with pytest.raises(ValueError) as caught:
        call(tmp_path)
    message = str(caught.value)
    assert [part for part in parts if part not in message] == [], message
    assert message.endswith("."), message


@pytest.mark.parametrize("scale", [0.2, [0.2], (0.2, 0.2), np.float32(0.2), np.full(2, 0.2)])
def test_a_scale_of_the_environments_own_may_be_one_number_or_one_per_dimension(scale: Any) -> None:
    one, other = (made(GA, env, seed=0) for env in (told(exploration_scale=scale), Plain()))
    assert one.first_scale() == pytest.approx(other.first_scale())


def test_what_a_wrapper_tells_itself_is_in_its_own_unit() -> None:
    class Rescaled(gym.wrappers.RescaleAction):  # type: ignore[type-arg]
        exploration_scale = 0.1

        def initial_trajectory(self) -> Any:
            return np.zeros((200, 2))

    env = rescaled(Rescaled)
    assert made(GA, env, seed=0).first_scale() == (0.1, 0.1)
    assert made(REPS, env, seed=0).learn(20).num_timesteps == 20


def test_a_rollout_that_breaks_down_costs_nothing_that_was_learned() -> None:
    model: Any = made(REPS, telling(NAN), seed=0, population_size=5)
    with pytest.raises(ValueError, match="rewards must be finite"):
        model.learn(40)
    assert model.num_timesteps == 6
    model.get_env().envs[0].unwrapped.n = -100
    assert model.learn(5, reset_num_timesteps=False).num_timesteps == 11


@pytest.mark.parametrize("callback", [None, [], lambda *_: True, BaseCallback])
def test_callbacks_as_sb3_takes_them_are_taken(callback: Any) -> None:
    if callback is BaseCallback:
        one = type("One", (BaseCallback,), {"_on_step": lambda _: True})()
        callback = [one, type(one)()]
    model: Any = made(REPS, seed=np.int64(3)).learn(20, callback=callback, log_interval=None)
    assert (model.num_timesteps, model.seed, type(model.seed)) == (20, 3, int)


def test_a_model_is_saved_after_its_workers_have_ended_and_goes_on_exactly(tmp_path: Path) -> None:
    def workers() -> SubprocVecEnv:
        kwargs = {"random_bottles": True, "n_threads": 1}
        made = make_vec_env(ENV_ID, 2, env_kwargs=kwargs, vec_env_cls=SubprocVecEnv)
        assert isinstance(made, SubprocVecEnv)
        return made

    first = workers()
    model = build(REPS, first)
    model.learn(8)
    first.close()
    model.save(tmp_path / "model")
    again: Any = REPS.load(tmp_path / "model", env=vec_env(2, random_bottles=True))
    rest = run(again, 8, reset_num_timesteps=False)
    whole = run(build(REPS, vec_env(2, random_bottles=True)), 16)
    np.testing.assert_array_equal(rest.trajectories, whole.trajectories[8:])


def test_a_loaded_model_is_given_its_environment_by_id(tmp_path: Path) -> None:
    model: Any = GA("MlpPolicy", ENV_ID, seed=0).learn(20)
    model.save(tmp_path / "model")
    with pytest.warns(ResumeWarning):
        assert GA.load(tmp_path / "model", env=ENV_ID).learn(20).num_timesteps == 20
    model.set_env(ENV_ID)
    assert model.learn(20).num_timesteps == 20


def test_the_zoo_goes_on_with_a_models_own_demonstrations(tmp_path: Path) -> None:
    entry, env = ENTRIES["acnmp"], make_vec_env("nmp/Push-v0")
    settings: dict[str, Any] = {"demonstrations": 2, "pretraining": {"n_steps": 5}}
    model: Any = entry(env, 1, **settings).learn(2)
    model.save(tmp_path / "model")
    model.save_replay_buffer(tmp_path / "buffer")
    again: Any = entry.load(str(tmp_path / "model.zip"), env, 2, **settings)
    again.load_replay_buffer(tmp_path / "buffer")
    assert again.learn(2, reset_num_timesteps=False).num_timesteps == 4


def test_a_refused_environment_changes_nothing() -> None:
    model = made(GA, seed=0)
    before = model.population_size
    with pytest.raises(ConfigurationError):
        model.set_env(DummyVecEnv([Plain] * 7))
    assert model.population_size == before and model.env.num_envs == 1


@pytest.mark.parametrize(("factor", "told"), [(1.0, False), (180 / np.pi, True)])
def test_demonstrations_of_another_unit_are_told(factor: float, told: bool) -> None:
    shown = Demonstrations.from_task(ENV_ID, 2, seed=0)
    shown = Demonstrations(shown.contexts, factor * shown.trajectories)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ACNMP("MlpPolicy", ENV_ID, demonstrations=shown, seed=0)
    said = [str(each.message) for each in caught if each.category is DemonstrationWarning]
    assert len(said) == told
    if told:
        assert "the demonstrations' trajectories hold" in said[0] and "their units" in said[0]


def test_another_seed_begins_other_random_numbers(tmp_path: Path) -> None:
    load: Any = GA.load

    def answer(model: Any) -> Any:
        return model.learn(20).replay_buffer.trajectories.copy()

    of_bottles(GA, seed=0).save(tmp_path / "model")
    kept, same, other = (
        answer(load(tmp_path / "model", env=ENV_ID, **seed))
        for seed in ({}, {"seed": 0}, {"seed": 3})
    )
    np.testing.assert_array_equal(kept, same)
    assert not np.array_equal(kept, other)
    np.testing.assert_array_equal(other, answer(of_bottles(GA, seed=3)))
    reseeded = of_bottles(GA, seed=0)
    reseeded.set_random_seed(3)
    np.testing.assert_array_equal(other, answer(reseeded))
