"""Results that do not depend on units, and inputs at the edge of what can be learned from."""

import pickle
from typing import Any

import numpy as np
import pytest
import torch as th

from baselines import BO
from sb3_nmp import (
    ACNMP,
    RCNMP,
    AlgorithmContractError,
    CNMPPretraining,
    ConfigurationError,
    PDController,
    RCNMPTraining,
    SmoothNoise,
)
from sb3_nmp.bayesian.gaussian_process import GaussianProcess, Hypotheses
from sb3_nmp.common import environment
from sb3_nmp.common.buffer import scale_rewards
from sb3_nmp.common.contextual import ContextualExploration, ContextualSearch
from sb3_nmp.models.standardised import Standardised
from tests.registry import SMALL
from tests.test_interruptions import SHOWN, Reach, envs

#: powers of two, so that nothing is rounded otherwise
SCALES = [2.0**-30, 2.0**-10, 2.0**20]


class Scaled(Reach):
    """Its reward and terms in another unit.

    :param unit: of the reward
    """

    def __init__(self, unit: float) -> None:
        super().__init__(pinned=0.95, tolerance=0.0)
        self.unit = unit

    def step(self, action: Any) -> Any:
        context, _, _, _, info = super().step(action)
        terms = [-abs(float(action[0, 0])), -abs(float(action[-1, 0]) - float(context[0]))]
        info |= {f"reward_{n}": self.unit * t for n, t in zip(("start", "end"), terms, strict=True)}
        return context, self.unit * sum(terms), True, False, info


@pytest.mark.parametrize("unit", SCALES)
@pytest.mark.parametrize("algorithm", [ACNMP, BO], ids=lambda each: each.__name__)
def test_a_critics_search_does_not_depend_on_the_unit_of_the_reward(
    algorithm: Any, unit: float
) -> None:
    settings: dict[str, Any] = {"demonstrations": SHOWN, "seed": 0}
    if algorithm is ACNMP:
        settings |= {"pretraining": CNMPPretraining(5), "policy_kwargs": {"cnmp": SMALL}}
    executed = []
    for each in (1.0, unit):
        env = Scaled(each)
        algorithm("MlpPolicy", env, **settings).learn(30)
        executed.append(env.executed)
    np.testing.assert_allclose(executed[1], executed[0], rtol=1e-6)


def test_a_process_does_not_depend_on_the_unit_of_its_values() -> None:
    points = np.linspace(-2.0, 2.0, 9)[:, None]
    hypotheses = Hypotheses((np.eye(1),), (0.3, 0.6, 1.3), (1e-4, 1e-2))
    asked = np.array([[0.3], [5.0]])
    first = GaussianProcess.fit(points, np.sin(points[:, 0]), hypotheses)
    for unit in SCALES:
        other = GaussianProcess.fit(points, unit * np.sin(points[:, 0]), hypotheses)
        assert other.length == first.length and other.noise == first.noise
        np.testing.assert_allclose(
            np.array(other.predict(asked)) / unit, np.array(first.predict(asked)), rtol=1e-9
        )


@pytest.mark.parametrize("value", [0.0, 0.1, -1e9])
def test_a_process_of_equal_values_predicts_them(value: float) -> None:
    points = np.linspace(-2.0, 2.0, 9)[:, None]
    hypotheses = Hypotheses((np.eye(1),), (0.6,), (1e-4,))
    mean, std = GaussianProcess.fit(points, np.full(9, value), hypotheses).predict(points + 0.1)
    np.testing.assert_allclose(mean, value, atol=1e-6)
    assert (std < 1e-4).all()


def test_an_entry_that_never_changed_keeps_its_unit() -> None:
    rows = th.tensor([[0.3, 1.0, 0.0], [0.3, 1.0 + 1e-3, 0.0], [0.3, 1.0 - 1e-3, 0.0]])
    inputs = Standardised(3)
    inputs.take(rows)
    assert inputs.std.tolist() == pytest.approx([1.0, 8.16e-4, 1.0], rel=1e-2)
    assert inputs(th.tensor([0.31, 1.0, 0.01])).tolist() == pytest.approx([0.01, 0, 0.01], abs=1e-4)
    tiny = Standardised(1)
    tiny.take(1e-9 * th.tensor([[1.0], [3.0]]))
    assert tiny.std.item() == pytest.approx(1e-9)
    outputs = Standardised(3)
    outputs.take(rows[:, [0, 2, 2]], groups=3)
    assert outputs.std.tolist() == pytest.approx([1e-6] * 3), "an output stays where it was"


class TwoEntries(Reach):
    """A context of two entries, the second of which is always 0 while it learns."""

    observation_space = environment.spaces.Box(-1.0, 1.0, (2,))

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        context, info = super().reset(seed=seed)
        return np.append(context, np.float32(0.0)), info

    def step(self, action: Any) -> Any:
        context, *rest = super().step(action)
        return np.append(context, np.float32(0.0)), *rest


def test_a_skill_answers_where_an_entry_differs_for_the_first_time() -> None:
    make: Any = RCNMP
    settings: dict[str, Any] = {"training": RCNMPTraining(3), "n_crossover": 4, "seed": 0}
    model = make("MlpPolicy", TwoEntries(tolerance=1.0), population_size=8, **settings).learn(160)
    same, other = (
        model.predict(np.array([0.3, second], np.float32), deterministic=True)[0]
        for second in (0.0, 0.01)
    )
    assert np.abs(other - same).max() < 0.2
    assert np.abs(other).max() < 2.5, "it was sent to the bounds of the actions"


@pytest.mark.parametrize("n", [2, 3, 5, 8, 10, 11, 12, 14, 16, 17, 18, 20, 200])
def test_the_controller_does_not_oscillate_however_few_the_time_points(n: int) -> None:
    noise = np.random.default_rng(0).normal(size=(400, n, 1))
    filtered = PDController()(noise, np.zeros(1), np.zeros(1))
    assert np.sqrt(np.mean(filtered**2)) < 1.7
    straight = np.linspace([0.0], [1.0], n)
    ends = PDController()(straight[None], straight[0], straight[-1])[0]
    assert ends[0, 0] == 0.0 and ends[-1, 0] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("kp", "kd"), [(3.0, 1.0), (3.0, 0.0), (3.0, 2.0), (10.0, 1.0)])
def test_the_longest_step_is_where_errors_no_longer_fade(kp: float, kd: float) -> None:
    longest = PDController(kp=kp, kd=kd).longest_step
    for share, fades in ((0.98, True), (1.02, False)):
        s = share * longest
        roots = np.roots([1.0, -(1.0 - s * kp + s * kd), s * kd])
        assert (np.abs(roots).max() < 1.0) == fades


def test_models_are_pickled_after_they_have_answered() -> None:
    model = BO("MlpPolicy", envs(), demonstrations=SHOWN, seed=0).learn(4)
    asked = np.array([[0.3]], np.float32)
    answer = model.predict(asked, deterministic=True)[0]
    again = pickle.loads(pickle.dumps(model.policy))
    np.testing.assert_array_equal(again.predict(asked, deterministic=True)[0], answer)


def test_a_single_time_point_cannot_be_filtered() -> None:
    with pytest.raises(ConfigurationError, match="pd_controller=None"):
        PDController()(np.zeros((1, 1, 1)), np.zeros(1), np.zeros(1))


def test_bases_too_narrow_to_meet_are_refused_and_nothing_else_gives_nan() -> None:
    with pytest.raises(ConfigurationError, match=r"at least 0\.05"):
        SmoothNoise(n_bases=10, width=0.01)
    drawn = SmoothNoise(n_bases=10, width=0.05).sample(np.random.default_rng(0), 2, (200, 1))
    assert np.isfinite(drawn).all()


def test_nan_is_not_sent_to_an_environment() -> None:
    space = environment.spaces.Box(-1.0, 1.0, (4, 1))
    proposed = np.zeros((1, 4, 1))
    proposed[0, 2] = np.nan
    with pytest.raises(AlgorithmContractError, match="1 NaN"):
        environment.executable(proposed, 1, space, "Mine")


def test_exploration_that_achieves_nothing_widens_to_an_end() -> None:
    search = ContextualSearch(ContextualExploration())
    for _ in range(2000):
        search.widen(0.0)
    assert search.scale == 1e4


@pytest.mark.parametrize("unit", [1e-15, 1.0, 1e15])
def test_standardised_rewards_do_not_depend_on_their_unit(unit: float) -> None:
    scaled = scale_rewards(unit * np.array([-1.0, -2.0, -4.0]), "standardize")
    assert scaled.mean() == pytest.approx(0.0, abs=1e-12)
    assert scaled.std() == pytest.approx(1.0)


def test_the_last_training_counts_where_a_schedule_ends_at_nothing() -> None:
    found = []
    for rate in (1e-3, lambda progress: 1e-3 * progress):
        model = ACNMP(
            "MlpPolicy",
            envs(pinned=0.95),
            demonstrations=SHOWN,
            pretraining=CNMPPretraining(5),
            policy_kwargs={"cnmp": SMALL},
            learning_rate=rate,
            seed=0,
        )
        before: list[Any] = []
        end = model._end_learning

        def remember(model: Any = model, before: Any = before, end: Any = end) -> None:
            context = th.tensor([[0.95]])
            before.append(model.policy.generalise(context).detach().numpy().copy())
            end()
            before.append(model.policy.generalise(context).detach().numpy().copy())

        model._end_learning = remember
        model.learn(30)
        found.append(float(np.abs(before[1] - before[0]).max()))
    assert found[0] > 1e-4
    assert found[1] > 1e-4, "the schedule's last value is 0"
