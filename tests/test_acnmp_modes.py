"""Demonstrations of several ways to do a task: ACNMP's categorical latent."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th

from sb3_nmp import ACNMP, CNMPArchitecture, CNMPPretraining, ConfigurationError, Demonstrations
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.cnmp_training import pretrain
from sb3_nmp.models.mode_gate import ModeGate
from tests.test_mixed import Detour, detours

SMALL = {"encoder_arch": (32,), "context_arch": (32,), "decoder_arch": (64, 64), "n_members": 2}
UNSEEN = np.linspace(-0.9, 0.9, 30)[:, None].astype(np.float32)


class Asked(Detour):
    """A detour to a height that may be asked for."""

    succeeds = True

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        context, info = super().reset(seed=seed)
        if options:
            self.height = context = np.asarray(options["context"], np.float32)
        return context, info

    def step(self, action: Any) -> Any:
        context, reward, terminated, truncated, info = super().step(action)
        success = info["is_success"] and self.succeeds
        return context, reward, terminated, truncated, info | {"is_success": success}


class Hopeless(Asked):
    """One in which nothing ever succeeds."""

    succeeds = False


def build(
    n_modes: int, shown: Demonstrations | None = None, env: type[Asked] = Asked, **more: Any
) -> ACNMP:
    return ACNMP(
        "MlpPolicy",
        env(),
        demonstrations=shown or detours(16),
        pretraining=CNMPPretraining(n_steps=600),
        policy_kwargs={"cnmp": CNMPArchitecture(n_modes=n_modes, **SMALL)},
        seed=0,
        **more,
    )


@pytest.fixture(scope="module")
def two() -> ACNMP:
    return build(2).pretrain()


def own(model: ACNMP) -> np.ndarray:
    """Return the network's own answers at unseen heights."""
    answers = model.policy.own_answer(UNSEEN)
    assert answers is not None
    return answers


def failures(model: ACNMP) -> float:
    """Return the share of unseen heights at which the network's own answer fails."""
    return float(np.mean(Detour.misses(UNSEEN, own(model)) > 0.2))


def test_two_ways_are_told_apart_where_one_network_averages_them(two: ACNMP) -> None:
    assert failures(two) < 0.1
    assert failures(build(1).pretrain()) > 0.8


def test_a_categorical_latent_that_collapses_is_seen(two: ACNMP) -> None:
    """All of what tells the ways apart is the latent: without it, the answers are the same."""
    answers, shares = two.policy.modes(UNSEEN)
    np.testing.assert_allclose(np.exp(shares).sum(axis=1), 1.0, rtol=1e-5)
    best = answers[np.arange(30), shares.argmax(axis=1)]
    np.testing.assert_allclose(best, own(two), atol=1e-5)
    assert answers.shape == (30, 2, 20, 1)
    halfway = answers[:, :, 10, 0] - UNSEEN
    assert np.abs(np.abs(halfway) - 1.0).max() < 0.25  # 1 above or 1 below
    assert (np.sign(halfway[:, 0]) == -np.sign(halfway[:, 1])).all()  # and each the other way


def test_each_demonstration_is_of_the_mode_that_answers_like_it(two: ACNMP) -> None:
    shown = detours(16)
    modes = two.policy.cnmp.nearest_modes(shown).numpy()
    ways = np.arange(16) % 2
    assert (modes == ways).all() or (modes == 1 - ways).all()


def test_the_gate_follows_contexts() -> None:
    """Shown one way at low heights and the other at high ones, each height gets its own."""
    both = detours(40)
    ways = np.arange(40) % 2
    like = both[np.flatnonzero((both.contexts[:, 0] > 0) == (ways == 0))]
    answers = own(build(2, like).pretrain())
    above = answers[:, 10, 0] > UNSEEN[:, 0]
    clear = np.abs(UNSEEN[:, 0]) > 0.3
    assert (above[clear] == (UNSEEN[clear, 0] > 0)).all()


def test_a_via_point_chooses_the_way_that_leads_through_it(two: ACNMP) -> None:
    height = UNSEEN[12]
    for way in (1.0, -1.0):
        point = ([10 / 19], [height + way])
        answer, _ = two.predict(height, deterministic=True, via_points=point)
        expected = two.predict_distribution(height, via_points=point)
        for path in (answer, expected.mean):
            assert path[10, 0] == pytest.approx(float(height[0]) + way, abs=0.02)
            assert Detour.misses(height[None], path[None])[0] < 0.2


def test_a_gate_never_chooses_what_was_never_taken() -> None:
    gate = ModeGate(1, 3)
    gate.learn(th.as_tensor(UNSEEN), np.full(30, 2))
    assert set(gate(th.as_tensor(UNSEEN)).tolist()) == {2}
    gate.learn(th.as_tensor(UNSEEN), np.where(UNSEEN[:, 0] > 0, 2, 1))
    assert gate.is_taken.tolist() == [False, True, True]
    assert gate(th.tensor([[-0.8], [0.8]])).tolist() == [1, 2]


def test_each_mode_begins_as_a_regression_of_its_own() -> None:
    """One way rises with the context, the other falls: no offset can tell them apart."""
    contexts, ways = np.linspace(-1.0, 1.0, 16)[:, None], np.tile([1.0, -1.0], 8)
    heights = ways * (2.0 + contexts[:, 0])
    bump = np.sin(np.linspace(0.0, np.pi, 20))
    shown = Demonstrations(contexts, (heights[:, None] * bump)[..., None])
    cnmp = CNMP(1, (20, 1), CNMPArchitecture(n_modes=2))
    pretrain(shown, CNMPPretraining(n_steps=0), np.random.default_rng(0), cnmp)
    answers = cnmp.each_mode(th.tensor([[-0.5], [0.7]])).numpy()[:, :, 10, 0]
    expected = np.array([[1.5, -1.5], [2.7, -2.7]])
    found = answers if answers[0, 0] > 0 else answers[:, ::-1]
    np.testing.assert_allclose(found, expected, rtol=0.1)


def test_modes_survive_saving_and_a_stream(two: ACNMP, tmp_path: Path) -> None:
    model = build(2, n_contexts=5, population_size=5).learn(60)
    assert failures(model) < 0.1
    model.save(tmp_path / "model")
    again = ACNMP.load(tmp_path / "model")
    np.testing.assert_array_equal(own(again), own(model))


def test_failures_among_drawn_contexts_do_not_teach() -> None:
    """Where no search finds anything, the network stays as it was."""

    model = build(1, env=Hopeless, n_contexts=5, population_size=5)
    before = own(model.pretrain())
    model.learn(40)
    np.testing.assert_array_equal(own(model), before)


def test_a_number_of_modes_that_is_none_is_refused() -> None:
    for n_modes in (0, 1.5):
        with pytest.raises(ConfigurationError, match=f"n_modes is {n_modes}; it must be a whole"):
            CNMPArchitecture(n_modes=n_modes)  # pyright: ignore[reportArgumentType]
