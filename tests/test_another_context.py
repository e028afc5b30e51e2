"""A model that goes on in another context than before: it searches there, and forgets nothing."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

from baselines import BO, GA, RandomSearch
from sb3_nmp import ACNMP, RCNMP, CNMPPretraining, Demonstrations, RCNMPTraining, ResumeWarning
from tests.registry import SMALL

T = 20


class Reach(gym.Env[Any, Any]):
    """Ends must meet ``3 c``; contexts are drawn from some, or are asked for by option."""

    observation_space = spaces.Box(-2.0, 2.0, (1,))
    action_space = spaces.Box(-8.0, 8.0, (T, 1))
    exploration_scale = (0.3,)

    def __init__(self, *contexts: float) -> None:
        self.contexts = np.array(contexts, np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        asked = (options or {}).get("context")
        drawn = self.np_random.choice(self.contexts, 1).astype(np.float32)
        self.context = drawn if asked is None else np.asarray(asked, np.float32)
        return self.context, {}

    def initial_trajectory(self) -> Any:
        return np.linspace(0.0, 3.0 * self.context, T)

    def step(self, action: Any) -> Any:
        miss = float(abs(action[-1, 0] - 3.0 * self.context[0]))
        wobble = float(np.abs(np.diff(action[:, 0], 2)).max())
        return self.context, -miss - wobble, True, False, {"is_success": miss < 0.3}


CONTEXTS = np.linspace(-1.5, 1.5, 4)[:, None]
SHOWN = Demonstrations(CONTEXTS, np.stack([np.linspace([0.0], 2.7 * c, T) for c in CONTEXTS]))
SETTINGS: dict[Any, dict[str, Any]] = {
    ACNMP: {
        "demonstrations": SHOWN,
        "pretraining": CNMPPretraining(30),
        "policy_kwargs": {"cnmp": SMALL},
    },
    BO: {"demonstrations": SHOWN},
    RandomSearch: {},
    RCNMP: {"training": RCNMPTraining(10), "n_candidates": 2},
    GA: {},
}
EVERY = pytest.mark.parametrize("algorithm", SETTINGS, ids=lambda each: each.__name__)
POPULATIONS = pytest.mark.parametrize("algorithm", [RCNMP, GA], ids=lambda each: each.__name__)


def made(algorithm: Any, *contexts: float) -> Any:
    return algorithm("MlpPolicy", Reach(*contexts), seed=0, **SETTINGS[algorithm])


def executed_in(model: Any, budget: int) -> set[float]:
    seen: list[float] = []
    model.learn(budget, callback=lambda found, _: seen.extend(found["contexts"][:, 0]) is None)
    return {round(float(each), 4) for each in seen}


@EVERY
@pytest.mark.parametrize("how", ["load", "set_env"])
@pytest.mark.filterwarnings("ignore::sb3_nmp.ResumeWarning")
def test_the_new_environments_context_is_the_one_that_is_searched(
    algorithm: Any, how: str, tmp_path: Path
) -> None:
    model = made(algorithm, 1.2)
    assert executed_in(model, 40) == {1.2}
    if how == "load":
        model.save(tmp_path / "model")
        model = algorithm.load(tmp_path / "model", env=Reach(-1.2))
    else:
        model.set_env(Reach(-1.2))
    assert executed_in(model, 40) == {-1.2}


@POPULATIONS
@pytest.mark.parametrize("how", ["load", "set_env"])
def test_a_search_in_another_context_is_as_good_as_a_new_one(
    algorithm: Any, how: str, tmp_path: Path
) -> None:
    fresh = made(algorithm, -1.5).learn(120)
    model = made(algorithm, 1.5).learn(60)
    first, _ = model.predict(np.array([1.5], np.float32), deterministic=True)
    if how == "load":
        model.save(tmp_path / "model")
        model = algorithm.load(tmp_path / "model", env=Reach(-1.5))
    else:
        model.set_env(Reach(-1.5))
    with pytest.warns(ResumeWarning):
        model.learn(120)
    assert model.replay_buffer.trajectories[0, -1, 0] == pytest.approx(-4.5, abs=0.2)
    assert (model.replay_buffer.contexts < 0).all()
    assert model._views(20)[0].age == 120 // model.population_size  # its noise began anew
    assert model.replay_buffer.rewards.max() > 2 * fresh.replay_buffer.rewards.max() - 0.05
    again, _ = model.predict(np.array([1.5], np.float32), deterministic=True)
    np.testing.assert_array_equal(again, first)  # what was found there is remembered


@pytest.mark.parametrize("algorithm", [ACNMP, BO], ids=lambda each: each.__name__)
def test_a_pinned_context_keeps_what_a_stream_has_assimilated(algorithm: Any) -> None:
    stream = Reach(*np.linspace(-1.9, 1.9, 9))
    model: Any = algorithm("MlpPolicy", stream, seed=0, n_successes=1, **SETTINGS[algorithm])
    model.learn(100)
    before = model.replay_buffer.contexts[:, 0]
    assert len(before) >= 2
    model.set_env(Reach(0.37))
    model.learn(40)
    after = model.replay_buffer.contexts[:, 0]
    np.testing.assert_array_equal(after[: len(before)], before)
    assert after[len(before) :] == pytest.approx([0.37])
    model.learn(20)  # a better solution there takes the old one's place
    assert len(model.replay_buffer) == len(before) + 1


@EVERY
def test_an_environment_whose_first_draws_are_equal_is_found_out(algorithm: Any) -> None:
    class Late(Reach):
        n = 0

        def reset(self, **kwargs: Any) -> Any:
            self.n += 1
            self.contexts = np.array(
                [1.0] if self.n < 5 else np.linspace(-1.9, 1.9, 999), np.float32
            )
            return super().reset(**kwargs)

    model = algorithm("MlpPolicy", Late(1.0), seed=0, **SETTINGS[algorithm])
    model.learn(100)
    if algorithm in (RCNMP, GA):
        assert model._varies
    else:
        assert not model._pinned


@POPULATIONS
def test_contexts_that_varied_within_a_generation_vary_whatever_is_drawn_next(
    algorithm: Any,
) -> None:
    model = made(algorithm, 1.0).learn(20)
    assert model._varies is False
    n = model.population_size
    contexts = np.linspace(-1.0, 1.0, n)[:, None]
    model.replay_buffer.add(contexts, np.zeros((n, T, 1)), np.zeros(n), np.zeros(n, bool))
    model.learn(20)
    assert model._varies
