"""Runs side by side: they meet where they train, and learn what they learn alone."""

import random
import signal
import threading
import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch as th
from stable_baselines3.common.utils import set_random_seed
from torch import nn

import benchmark_envs  # noqa: F401 (registers the tasks)
from sb3_nmp import RCNMP, RCNMPTraining
from sb3_nmp.common import lockstep
from sb3_nmp.common.lockstep import TrainingPhase, clock, together, train
from sb3_nmp.models.ensemble import Ensemble, EnsembleTraining, Regression
from sb3_nmp.models.neural_process import NeuralProcess
from sb3_nmp.models.stacking import stage_of
from sb3_nmp.rcnmp.reward_model import success_and_score
from sb3_nmp.rcnmp.training import ElboPhase, batches

SETTINGS = RCNMPTraining(n_steps=12, batch_size=4, n_target_points=5, max_conditioning_points=6)


@dataclass(frozen=True)
class Noted(TrainingPhase):
    """A phase that notes with whom it was done."""

    name: str
    sort: str
    notes: list[str]
    takes: Callable[[], object] = bool

    @property
    def kind(self) -> Hashable:
        return self.sort

    def alone(self) -> None:
        self.notes.append(self.name)

    @classmethod
    def as_one(cls, phases: Sequence["Noted"]) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        names = "+".join(phase.name for phase in phases)
        phases[0].takes()
        if "?" in names:
            raise ArithmeticError(names)
        phases[0].notes.append(names)


def visits(name: str, sorts: str, notes: list[str]) -> Callable[[], str]:
    """Return a task that trains once for each letter."""

    def task() -> str:
        for sort in sorts:
            notes.append(f"{name} comes")
            train(Noted(name, sort, notes))
        return name

    return task


def test_a_phase_without_company_is_done_alone():
    notes: list[str] = []
    assert visits("a", "xy", notes)() == "a"
    assert notes == ["a comes", "a", "a comes", "a"]


def test_tasks_move_one_by_one_and_train_as_one():
    notes: list[str] = []
    tasks = [visits(name, "xx", notes) for name in "abc"]
    assert together(tasks) == ["a", "b", "c"]
    comes = ["a comes", "b comes", "c comes"]
    assert notes == [*comes, "a+b+c", *comes, "a+b+c"]


def test_who_has_come_apart_meets_again():
    notes: list[str] = []
    together([visits("a", "xyz", notes), visits("b", "xwz", notes), visits("c", "xyz", notes)])
    trained = [note for note in notes if "comes" not in note]
    assert trained == ["a+b+c", "a+c", "b", "a+b+c"]


def test_a_task_that_fails_leaves_the_others_to_end():
    notes: list[str] = []

    def fails() -> str:
        train(Noted("b", "x", notes))
        raise LookupError("b")

    with pytest.raises(LookupError, match="b"):
        together([visits("a", "xx", notes), fails])
    assert notes[-1] == "a"


def test_each_of_a_phase_that_fails_is_told():
    told: list[str] = []

    def task() -> None:
        try:
            train(Noted("?", "x", []))
        except RuntimeError as error:
            told.append(f"{error} {type(error.__cause__).__name__}")

    together([task, task])
    assert len(told) == 2 and all("training of 2 runs as one failed" in each for each in told)
    assert all(each.endswith("ArithmeticError") for each in told)


def test_a_phase_whose_kind_cannot_be_told_fails_its_task_alone():
    class Unkind(Noted):
        @property
        def kind(self) -> Hashable:
            raise KeyError("step")

    notes: list[str] = []
    with pytest.raises(KeyError, match="step"):
        together([visits("a", "xx", notes), lambda: str(train(Unkind("b", "x", notes)))])
    assert notes[-1] == "a"


@pytest.mark.parametrize("where", ["while one moves", "while they wait"])
def test_who_is_interrupted_leaves_no_task_behind(where: str):
    """Ctrl-C reaches the thread that called `together`, wherever the tasks are."""
    ended: list[str] = []

    def interrupts() -> None:
        raise KeyboardInterrupt

    def task() -> None:
        try:
            train(Noted("a", "x", [], takes=interrupts if where == "while they wait" else bool))
            train(Noted("a", "y", []))
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
            deadline = time.monotonic() + 30.0
            while time.monotonic() < deadline:  # until it is abandoned
                time.sleep(0.001)
        finally:
            ended.append("ended")

    before = threading.active_count()
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's "&" ignores it
    try:
        with pytest.raises(KeyboardInterrupt):
            together([task, task])
    finally:
        signal.signal(signal.SIGINT, usual)
    assert ended == ["ended", "ended"]
    assert threading.active_count() == before


def test_each_task_keeps_the_global_generators_to_itself():
    def task(seed: int) -> list[float]:
        set_random_seed(seed)
        found = []
        for _ in range(2):
            train(Noted("a", "x", []))
            found += [float(th.rand(1)), float(np.random.rand()), random.random()]
        return found

    tasks = [lambda seed=seed: task(seed) for seed in range(2)]
    assert together(tasks) == [each() for each in tasks]


def test_a_task_trains_whatever_mode_the_caller_is_in():
    fits = ensemble_fits(split=False)
    with th.no_grad():
        beside = together(fits)
    assert th.allclose(beside[0].linear, fits[0]().linear, atol=1e-5)


def test_time_spent_on_others_is_not_counted(monkeypatch: pytest.MonkeyPatch):
    """Each works for 1 s, and they train together for 4 s: of 6 s each took half."""
    now = [0.0]

    def pass_by(seconds: float) -> None:
        now[0] += seconds

    monkeypatch.setattr(lockstep, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    took: list[float] = []

    def task() -> None:
        begin = clock()
        pass_by(1.0)
        train(Noted("a", "x", [], takes=lambda: pass_by(4.0)))
        took.append(clock() - begin)

    together([task, task])
    assert took == [3.0, 3.0]


class Counted:
    """Notes how many phases of a class are done as one."""

    def __init__(self, phase: type[TrainingPhase], monkeypatch: pytest.MonkeyPatch) -> None:
        self.sizes: list[int] = []
        as_one: Any = phase.as_one

        def counted(phases: Sequence[TrainingPhase]) -> None:
            self.sizes.append(len(phases))
            as_one(phases)

        monkeypatch.setattr(phase, "as_one", staticmethod(counted))


def ensemble_fits(split: bool) -> list[Callable[[], Ensemble]]:
    """Return fits of three ensembles to data of their own, of different lengths."""

    def fit(seed: int) -> Ensemble:
        rng = np.random.default_rng(seed)
        generator = th.Generator().manual_seed(seed)
        ensemble = Ensemble([3, 8, 2], 2, generator)
        inputs = th.as_tensor(rng.normal(size=(20 + seed, 3)), dtype=th.float32)
        targets = (inputs[:, :2] > 0).float() if split else th.sin(3 * inputs[:, :2])
        shares = rng.dirichlet(np.ones(len(inputs)))
        loss = success_and_score if split else None
        ensemble.fit(inputs, targets, 40, EnsembleTraining(1e-2, 0.1, 8), generator, loss, shares)
        return ensemble

    return [lambda seed=seed: fit(seed) for seed in range(3)]


@pytest.mark.parametrize("split", [False, True])
def test_ensembles_learn_as_one_what_they_learn_alone(split: bool, monkeypatch: pytest.MonkeyPatch):
    fits = ensemble_fits(split)
    joint = Counted(Regression, monkeypatch)
    alone, beside = [fit() for fit in fits], together(fits)
    assert joint.sizes == [3]
    for one, other in zip(alone, beside, strict=True):
        for mine, theirs in zip(one.parameters(), other.parameters(), strict=True):
            assert th.allclose(mine, theirs, atol=1e-5)
            assert not theirs.requires_grad
    assert not th.allclose(beside[0].linear, beside[1].linear, atol=1e-2)


def phase_of(seed: int, network: NeuralProcess, optimizer: th.optim.Optimizer) -> ElboPhase:
    rng = np.random.default_rng(seed)
    values = th.as_tensor(rng.normal(size=(7, 15, 2)).cumsum(axis=1), dtype=th.float32)
    drawn = batches(
        SETTINGS,
        th.linspace(0, 1, 15),
        values,
        th.as_tensor(rng.normal(size=(7, 1)), dtype=th.float32),
        np.full(7, 1 / 7),
        3,
        rng,
    )
    return ElboPhase(network, optimizer, SETTINGS, drawn, beta=0.3)


def networks(n_categories: int) -> list[tuple[NeuralProcess, th.optim.Optimizer]]:
    found = []
    for seed in range(3):
        th.manual_seed(seed)
        network = NeuralProcess(2, 1, 3, [8], [8], 2, 0.1, nn.Tanh, n_categories)
        found.append((network, th.optim.Adam(network.parameters(), 1e-2, fused=True)))
    return found


@pytest.mark.parametrize("n_categories", [1, 2])
def test_neural_processes_learn_as_one_what_they_learn_alone(n_categories: int):
    """Twice, so that the second time begins with the optimizer's state of the first."""
    alone, beside = networks(n_categories), networks(n_categories)
    for again in (0, 10):
        single = [phase_of(again + seed, *each) for seed, each in enumerate(alone)]
        joint = [phase_of(again + seed, *each) for seed, each in enumerate(beside)]
        for phase in single:
            phase.alone()
        assert len({phase.kind for phase in joint}) == 1
        ElboPhase.as_one(joint)
        for one, other in zip(single, joint, strict=True):
            assert one.bound is not None and other.bound is not None
            for name, term in vars(one.bound).items():
                assert th.allclose(term, vars(other.bound)[name], rtol=1e-3, atol=1e-4), name
    for (one, one_adam), (other, other_adam) in zip(alone, beside, strict=True):
        for mine, theirs in zip(one.parameters(), other.parameters(), strict=True):
            assert th.allclose(mine, theirs, atol=1e-4)
            for key, state in one_adam.state.get(mine, {}).items():
                assert th.allclose(state, other_adam.state[theirs][key], rtol=1e-2, atol=1e-2)
    untrained, trained = (next(each[0][0].parameters()) for each in (networks(1), beside))
    assert n_categories > 1 or (untrained - trained).abs().max() > 0.01


def test_what_differs_is_not_trained_as_one():
    (network, adam), (other, _), _ = networks(1)
    faster = th.optim.Adam(other.parameters(), 2e-2, fused=True)
    decayed = th.optim.AdamW(other.parameters(), 1e-2, fused=True)
    wider = NeuralProcess(2, 1, 3, [9], [8], 2, 0.1, nn.Tanh)
    adam_too = th.optim.Adam(wider.parameters(), 1e-2, fused=True)
    phase = phase_of(0, network, adam)
    others = [
        phase_of(0, other, faster),
        phase_of(0, other, decayed),
        phase_of(0, wider, adam_too),
        replace(phase, beta=0.4),
        replace(phase, settings=RCNMPTraining(n_steps=13)),
    ]
    assert replace(phase).kind == phase.kind
    assert all(each.kind != phase.kind for each in others)
    before = phase.kind
    phase.alone()
    assert phase.kind != before  # Adam corrects by the number of its steps


def test_ensembles_that_differ_are_not_trained_as_one():
    ensemble = Ensemble([3, 8, 2], 2, th.Generator())
    inputs, targets = th.zeros(9, 3), th.zeros(9, 2)
    fit = Regression(
        ensemble, inputs, targets, 5, EnsembleTraining(), th.Generator(), None, shares=None
    )
    assert replace(fit, inputs=inputs + 1.0).kind == fit.kind
    for changed in (
        {"ensemble": Ensemble([3, 9, 2], 2, th.Generator())},
        {"inputs": inputs[:8]},  # a smaller batch
        {"n_steps": 6},
        {"training": EnsembleTraining(huber=1.0)},
        {"loss": success_and_score},
    ):
        assert replace(fit, **changed).kind != fit.kind, changed


def test_an_optimizer_that_mixes_numbers_is_like_none_but_itself():
    (network, _), (other, _), _ = networks(1)
    one, two = (th.optim.LBFGS(each.parameters()) for each in (network, other))
    assert stage_of(one) != stage_of(two)


def learned(seed: int, **settings: Any) -> Callable[[], RCNMP]:
    def task() -> RCNMP:
        model = RCNMP("MlpPolicy", "nmp/Bottles-v0", seed=seed, **settings)
        return model.learn(model.population_size * 2)

    return task


@pytest.mark.parametrize("settings", [{}, {"n_modes": 2}], ids=["one way", "two ways"])
def test_rcnmp_learns_side_by_side_what_it_learns_alone(
    settings: dict[str, Any], monkeypatch: pytest.MonkeyPatch
):
    """The second generation is proposed by the network and judged by the ensemble."""
    tasks = [learned(seed, **settings) for seed in range(3)]
    network, ensemble = Counted(ElboPhase, monkeypatch), Counted(Regression, monkeypatch)
    alone, beside = [task() for task in tasks], together(tasks)
    assert network.sizes[0] == 3 and sum(network.sizes) > 3  # two ways ask for more ensembles
    assert sum(ensemble.sizes) > 1
    for one, other in zip(alone, beside, strict=True):
        mine, theirs = one.replay_buffer, other.replay_buffer
        first = slice(0, one.population_size)
        assert np.array_equal(mine.rewards[first], theirs.rewards[first])
        assert np.abs(mine.trajectories - theirs.trajectories).max() < 1e-5
    rewards = [model.replay_buffer.rewards for model in beside]
    assert not np.array_equal(rewards[0], rewards[1])
