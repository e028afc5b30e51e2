"""Where demonstrations go several ways: all answers are tried first, and the gate learns."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th

from sb3_nmp import ACNMP, ACNMPAdaptation, ACNMPExploration, CNMPArchitecture, CNMPPretraining
from sb3_nmp.acnmp.ways import WaysSearch
from sb3_nmp.models.mode_gate import ModeGate
from sb3_nmp.models.mode_success import N_REMEMBERED, ModeSuccess
from tests.test_acnmp_modes import SMALL, Asked
from tests.test_mixed import Detour, detours

HEIGHTS = np.linspace(-0.9, 0.9, 60)[:, None].astype(np.float32)
ABOVE, BELOW = 1.0, -1.0


class OneWay(Asked):
    """A detour that succeeds above at low heights, and below at high ones."""

    @staticmethod
    def fails(heights: np.ndarray, paths: np.ndarray) -> np.ndarray:
        """Return which paths (N, T, 1) fail at heights (N, 1)."""
        wanted = np.where(heights[:, 0] > 0.2, BELOW, ABOVE)
        way = np.sign(paths[:, 10, 0] - heights[:, 0])
        return (Detour.misses(heights, paths) > 0.2) | (way != wanted)

    def step(self, action: Any) -> Any:
        context, reward, terminated, truncated, info = super().step(action)
        path = np.asarray(action)[None]
        success = not self.fails(np.atleast_2d(self.height), path)[0]
        return context, reward, terminated, truncated, info | {"is_success": bool(success)}


class Farther(OneWay):
    """One in which neither answer goes far enough at great heights, but a search does."""

    @staticmethod
    def fails(heights: np.ndarray, paths: np.ndarray) -> np.ndarray:
        """Return which paths (N, T, 1) fail at heights (N, 1)."""
        far = np.abs(paths[:, 10, 0] - heights[:, 0]) > 1.1
        return np.where(heights[:, 0] > 0.5, ~far, OneWay.fails(heights, paths))


def build(env: gym.Env[Any, Any] | None = None, **more: Any) -> ACNMP:
    settings: Any = {"n_contexts": 5, "population_size": 1, **more}
    return ACNMP(
        "MlpPolicy",
        env or OneWay(),
        demonstrations=detours(16),  # both ways, everywhere in turn
        pretraining=CNMPPretraining(n_steps=600),
        policy_kwargs={"cnmp": CNMPArchitecture(n_modes=2, **SMALL)},
        seed=0,
        **settings,
    )


def failures(model: ACNMP) -> float:
    answers = model.policy.own_answer(HEIGHTS)
    assert answers is not None
    return float(np.mean(OneWay.fails(HEIGHTS, answers)))


def test_the_gate_learns_which_way_succeeds_where() -> None:
    """Shown both ways everywhere, it can know from rollouts alone."""
    model = build().pretrain()
    before = failures(model)
    weights = model.policy.cnmp.network.state_dict()
    pretrained = {name: value.clone() for name, value in weights.items()}
    model.learn(60)
    assert before > 0.3 and failures(model) < 0.1
    assert len(model.replay_buffer) == 0  # the other way's answer was enough everywhere:
    assert all(th.equal(value, pretrained[name]) for name, value in weights.items())
    assert model.n_given_up == 0


def test_it_is_the_gate_that_has_learned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ModeSuccess, "remember", lambda *_: None)
    model = build().pretrain()
    before = failures(model)
    assert failures(model.learn(60)) == before


def test_a_failed_answer_costs_one_rollout_where_the_other_way_succeeds() -> None:
    model = build(population_size=1)
    executed: list[Any] = []
    observe = model._observe

    def watched(rollouts: Any) -> None:
        executed.extend(zip(rollouts.contexts, rollouts.successes, strict=True))
        observe(rollouts)

    model._observe = watched  # type: ignore[method-assign]
    model.learn(40)
    of_context: dict[float, list[bool]] = {}
    for context, success in executed:
        of_context.setdefault(float(context[0]), []).append(bool(success))
    tried = list(of_context.values())
    assert [False, True] in tried
    assert all(each in ([True], [False, True]) for each in tried[:-5])


def test_the_gate_survives_saving(tmp_path: Path) -> None:
    model = build().learn(40)
    model.save(tmp_path / "model")
    again = ACNMP.load(tmp_path / "model", env=OneWay())
    own, theirs = (each.policy.own_answer(HEIGHTS) for each in (model, again))
    assert own is not None and theirs is not None
    np.testing.assert_array_equal(own, theirs)
    gates = [each.policy.cnmp.gate for each in (model, again)]
    assert all(gate is not None and gate.outcomes.knows_failures for gate in gates)
    assert failures(again.learn(20, reset_num_timesteps=False)) < 0.1


def test_answers_that_satisfied_are_learned_beside_solutions() -> None:
    """And nothing of contexts that were searched, or are."""
    model = build(
        n_successes=2,
        max_generations=30,
        adaptation=ACNMPAdaptation(keep_answers=True, n_assimilation_steps=2),
        exploration=ACNMPExploration(foretold=False),  # it needs more than demonstrations foretell
        env=Farther(),
    ).learn(120)
    contexts, answers = model._satisfying_answers()
    searched = {float(each.context[0]) for each in model.searches}
    searched |= set(model.replay_buffer.contexts[:, 0].tolist())
    assert len(contexts) > 10 and len(model.replay_buffer) > 1
    assert not searched & set(contexts[:, 0].tolist())
    assert not Farther.fails(contexts, answers).any()
    n_known = len(model.training_set())
    assert len(model._sampler(model.rng).values) == n_known + len(contexts)
    model.adaptation = ACNMPAdaptation()
    assert len(model._sampler(model.rng).values) == n_known


def test_a_search_under_way_is_saved(tmp_path: Path) -> None:
    model = build(n_successes=5).learn(7)  # five answers, and two of other ways
    waiting = [each for each in model.searches if isinstance(each.search, WaysSearch)]
    assert waiting
    model.save(tmp_path / "model")
    again = ACNMP.load(tmp_path / "model", env=OneWay())
    assert len(again.searches) == len(model.searches)
    for one, other in zip(waiting, again.searches, strict=False):
        assert isinstance(one.search, WaysSearch) and isinstance(other.search, WaysSearch)
        assert one.search.modes == other.search.modes


def test_where_no_way_succeeds_the_better_one_is_searched() -> None:
    class Hopeless(OneWay):
        def step(self, action: Any) -> Any:
            *told, info = super().step(action)
            return *told, info | {"is_success": False}

    model = build(Hopeless(), n_contexts=1).learn(12)
    (each,) = model.searches
    assert isinstance(each.search, WaysSearch)
    counts = [len(search.points) for search in each.search.searches]
    assert sum(counts) == 12 and min(counts) == 1
    assert each.search.best is each.search.searches[int(np.argmax(counts))]


def test_answers_succeed_where_others_near_did() -> None:
    outcomes = ModeSuccess(1, 3)
    tried = th.linspace(-1.0, 1.0, 20)[:, None]
    of_mode = th.arange(20) % 2
    outcomes.remember(tried, of_mode, (tried[:, 0] > 0) == (of_mode == 0))
    assert outcomes.is_to_learn and not outcomes.knows_failures
    outcomes.learn(th.zeros(0, 1), th.zeros(0, dtype=th.long))
    assert outcomes.knows_failures and not outcomes.is_to_learn
    odds = outcomes(th.tensor([[-0.8], [0.8]]))
    assert odds[:, :2].argmax(dim=1).tolist() == [1, 0]
    assert (odds[:, :2].amin(dim=1) < 0).all() and (odds[:, :2].amax(dim=1) > 0).all()
    assert (odds[:, 2] == 0).all()  # nothing is known of mode 2


def test_only_the_newest_answers_are_remembered() -> None:
    outcomes = ModeSuccess(1, 1)
    for start in range(0, 3 * N_REMEMBERED, N_REMEMBERED // 2):
        some = th.full((N_REMEMBERED // 2, 1), float(start))
        outcomes.remember(some, th.zeros(len(some), dtype=th.long), th.ones(len(some)).bool())
    assert len(outcomes.tried_contexts) == N_REMEMBERED
    assert outcomes.tried_contexts[0].item() == 2 * N_REMEMBERED


def test_failures_are_forgotten_last_and_take_at_most_half() -> None:
    outcomes, n = ModeSuccess(1, 1), N_REMEMBERED
    for start, succeeds in ((0, False), (20, True), (20 + 2 * n, False)):
        n_told = 20 if start == 0 else 2 * n if succeeds else n
        some = start + th.arange(n_told, dtype=th.float32)[:, None]
        outcomes.remember(some, th.zeros(n_told, dtype=th.long), th.full((n_told,), succeeds))
        if succeeds:  # the 20 first ones failed, and are still known
            assert outcomes.tried_contexts[:20, 0].tolist() == list(range(20))
            assert len(outcomes.tried_contexts) == n and not outcomes.tried_successes[:20].any()
    assert int((~outcomes.tried_successes).sum()) == n // 2
    assert outcomes.tried_contexts[-1].item() == 20 + 3 * n - 1
    assert (outcomes.tried_contexts.diff(dim=0) > 0).all()  # in order


def test_before_any_failure_the_gate_says_which_way_was_shown() -> None:
    shown = th.linspace(-1.0, 1.0, 20)[:, None]
    ways = (shown[:, 0] > 0).long().numpy()
    gate = ModeGate(1, 2)
    gate.outcomes.remember(shown, th.as_tensor(1 - ways), th.ones(20, dtype=th.bool))
    gate.learn(shown, ways)
    assert (gate(shown).numpy() == ways).all()
    gate.outcomes.remember(shown, th.as_tensor(ways), th.zeros(20, dtype=th.bool))
    gate.learn(shown, ways)
    assert (gate(shown).numpy() != ways).mean() > 0.8
