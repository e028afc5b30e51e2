"""That ACNMP's network learns by its policy gradient and drives the search (thesis 5.1, VI-VII).

Each test fails by name where the gradient is taken out, where its sign is wrong, or where the
search does not follow the network.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from torch import nn

from sb3_nmp import (
    ACNMP,
    ACNMPAdaptation,
    ACNMPExploration,
    Demonstrations,
    UntrainedWarning,
)
from sb3_nmp.acnmp import losses
from sb3_nmp.acnmp.losses import PolicyGradient, policy_gradient_loss
from sb3_nmp.acnmp.search import PolicySearch
from sb3_nmp.acnmp.settings import Advantage
from sb3_nmp.bayesian.search import CriticSearch, Subspace
from sb3_nmp.common.rollouts import Generation
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.cnmp_training import CNMPPretraining, pretrain
from tests import test_acnmp as toy
from tests import test_algorithms as contract
from tests.registry import DEMONSTRATIONS, ENV_ID, POPULATION
from tests.test_acnmp import SHOWN, Reach, T, build, expert

GOAL = np.array([0.5], np.float32)
#: all of it is learned: of one that begins as a regression, few of its few units are in use
SMALL = replace(toy.SMALL, fitted_trend=False, activation_fn=nn.ReLU)
LEARNED: dict[str, Any] = {"policy_kwargs": {"cnmp": SMALL}}
#: how much higher than demonstrated a trajectory has to end
HIGHER = 0.5


class Higher(Reach):
    """Where the demonstrations do not suffice: end higher than they do."""

    def step(self, action: Any) -> Any:
        return super().step(action - HIGHER)


@pytest.fixture(scope="module")
def demonstrations() -> Demonstrations:
    return Demonstrations(SHOWN, expert(SHOWN))


@pytest.fixture(scope="module")
def pretrained(demonstrations: Demonstrations) -> dict[str, th.Tensor]:
    model = build(demonstrations, Reach(float(GOAL[0])), **LEARNED).pretrain()
    return {name: value.clone() for name, value in model.policy.state_dict().items()}


def begun(
    demonstrations: Demonstrations, pretrained: dict[str, th.Tensor], env: Reach, **settings: Any
) -> ACNMP:
    """Return a model that has the pre-trained network."""
    model = build(demonstrations, env, **LEARNED, **settings)
    model.policy.load_state_dict(pretrained)
    model.is_pretrained = True
    return model


def driven(
    demonstrations: Demonstrations,
    pretrained: dict[str, th.Tensor],
    n_rollouts: int = 60,
    **settings: Any,
) -> ACNMP:
    """Return a model whose network drove a search, without any solution to assimilate."""
    env = Higher(float(GOAL[0]), tolerance=-1.0)  # no rollout succeeds: only the gradient teaches
    kinds = {"search": "policy", "population_size": 5, **settings}
    return begun(demonstrations, pretrained, env, **kinds).learn(n_rollouts)


def miss(model: ACNMP) -> float:
    """Return by how much the network's own answer misses the goal."""
    answered = model.policy.own_answer(GOAL[None])
    assert answered is not None
    return abs(float(answered[0, -1, 0] - GOAL[0] - HIGHER))


def drift(demonstrations: Demonstrations, pretrained: dict[str, th.Tensor], **more: Any) -> float:
    """Return the median of `miss` over three searches."""
    runs = (driven(demonstrations, pretrained, seed=seed, **more) for seed in range(3))
    return float(np.median([miss(model) for model in runs]))


@pytest.mark.parametrize(
    "adaptation",
    [ACNMPAdaptation(), ACNMPAdaptation.preset("to_go"), ACNMPAdaptation.preset("step")],
    ids=["place", "to_go", "step"],
)
def test_the_networks_own_answer_learns_by_the_policy_gradient(
    demonstrations: Demonstrations,
    pretrained: dict[str, th.Tensor],
    adaptation: ACNMPAdaptation,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    learned = drift(demonstrations, pretrained, adaptation=adaptation)
    off = replace(adaptation, n_training_steps=0)
    still = drift(demonstrations, pretrained, adaptation=off)
    assert learned < 0.7 * still

    def negated(*args: Any) -> th.Tensor:
        return -policy_gradient_loss(*args)

    monkeypatch.setattr(losses, "policy_gradient_loss", negated)
    assert drift(demonstrations, pretrained, adaptation=adaptation, n_rollouts=20) > still


def test_with_a_learning_rate_of_nearly_0_the_search_stays_where_it_is(
    demonstrations: Demonstrations, pretrained: dict[str, th.Tensor]
) -> None:
    def off(rate: float) -> float:
        """Return by how much the search's centre misses the goal, median of three."""
        runs = (
            driven(demonstrations, pretrained, learning_rate=rate, seed=seed) for seed in range(3)
        )
        ends = [float(searched(model).space.origin[-1, 0]) for model in runs]
        return float(np.median([abs(end - GOAL[0] - HIGHER) for end in ends]))

    assert off(1e-3) < 0.5 * off(1e-12)


def searched(model: ACNMP) -> PolicySearch:
    """Return the search that is under way."""
    found = model.searches[0].search
    assert isinstance(found, PolicySearch)
    return found


def test_the_search_follows_the_network(
    demonstrations: Demonstrations, pretrained: dict[str, th.Tensor]
) -> None:
    model = driven(demonstrations, pretrained, 20)
    answered = model.policy.own_answer(GOAL[None])
    assert answered is not None
    np.testing.assert_allclose(searched(model).space.origin, answered[0], atol=1e-5)


def test_what_the_network_learns_by_place_comes_from_all_rollouts(
    demonstrations: Demonstrations, pretrained: dict[str, th.Tensor]
) -> None:
    model = driven(demonstrations, pretrained, 20)
    assert len(model._learned_from(searched(model))) == 20
    model.adaptation = ACNMPAdaptation("to_go")
    assert len(model._learned_from(searched(model))) == 5


def test_the_draws_shrink_without_a_new_best_rollout_and_grow_with_one() -> None:
    rng = np.random.default_rng(0)
    space = Subspace(np.zeros((T, 1)), rng.standard_normal((3, T, 1)))
    settings = ACNMPExploration(radius=0.8, growth=2.0, shrinkage=0.5, radius_limits=(0.3, 1.0))
    search, radii = PolicySearch(space, settings), []
    for rewards in ([-3.0, -2.0], [-1.0, -2.0], [-4.0, -4.0], [-4.0, -4.0], [0.0, -4.0]):
        tried = search.ask(2, rng).astype(np.float32)
        contexts, none = np.zeros((2, 1), np.float32), np.zeros(2, bool)
        search.tell(Generation(contexts, tried, np.array(rewards), none))
        radii.append(search.region.radius)
    assert radii == [0.8, 1.0, 0.5, 0.3, 0.6]


def test_a_found_solution_becomes_the_networks_own_answer_beside_a_critic(
    demonstrations: Demonstrations, pretrained: dict[str, th.Tensor]
) -> None:
    """The memory's answer succeeds anyway; the network's has to be learned."""
    env = Higher(float(GOAL[0]))
    model = begun(demonstrations, pretrained, env)
    before = miss(model)
    model.learn(40)
    assert before > 0.1
    assert miss(model) < 0.05  # the tolerance of `Reach`


def found(model: ACNMP) -> Generation:
    """Return the rollouts of the search beside a critic."""
    search = model.searches[0].search
    assert isinstance(search, CriticSearch)
    return Generation.concatenate(search.rollouts)


def test_when_learning_ends_the_own_answer_comes_nearer_to_what_was_found(
    demonstrations: Demonstrations, pretrained: dict[str, th.Tensor]
) -> None:
    """And the search goes on as if it had not."""

    def learned(seed: int, n_final_steps: int, *budgets: int) -> ACNMP:
        adaptation = ACNMPAdaptation(n_final_steps=n_final_steps)
        env = Higher(float(GOAL[0]))
        model = begun(demonstrations, pretrained, env, adaptation=adaptation, seed=seed)
        for budget in budgets:
            model.learn(budget, reset_num_timesteps=False)
        return model

    def off(model: ACNMP) -> float:
        answered, rollouts = model.policy.own_answer(GOAL[None]), found(model)
        assert answered is not None
        best = np.flatnonzero(rollouts.successes)[rollouts.rewards[rollouts.successes].argmax()]
        return float(np.sqrt(np.mean((answered[0] - rollouts.trajectories[best]) ** 2)))

    without = [learned(seed, 0, 30) for seed in range(3)]
    models = [learned(seed, 100, 15, 15) for seed in range(3)]
    for one, other in zip(without, models, strict=True):
        np.testing.assert_array_equal(found(one).trajectories, found(other).trajectories)
    assert np.median([*map(off, models)]) < 0.7 * np.median([*map(off, without)])


class Misleading(Reach):
    """An end too high by 0.3 earns more than the right one, which succeeds."""

    def step(self, action: Any) -> Any:
        observation, _, *rest, info = super().step(action - HIGHER)
        too_high = float(action[-1, 0] - HIGHER - self.context[0])
        return observation, -abs(too_high - 0.3), *rest, {"is_success": info["is_success"]}


def test_the_network_learns_what_succeeded_where_failures_earn_more(
    demonstrations: Demonstrations, pretrained: dict[str, th.Tensor]
) -> None:
    env = Misleading(float(GOAL[0]))
    model = begun(demonstrations, pretrained, env).learn(60)
    assert miss(model) < 0.15  # and not 0.3 too high
    search = model.searches[0].search
    assert isinstance(search, CriticSearch)
    assert search.rewards.max() > -0.25  # of a failure
    assert 60 / 1.15 < search.n_taught <= 60


def test_without_policy_gradient_a_pinned_solution_is_learned_all_the_same(
    demonstrations: Demonstrations, pretrained: dict[str, th.Tensor]
) -> None:
    env, off = Higher(float(GOAL[0])), ACNMPAdaptation(n_training_steps=0)
    model = begun(demonstrations, pretrained, env, adaptation=off)
    before = miss(model)
    model.learn(40)
    assert miss(model) < 0.8 * before


def test_assimilation_does_not_put_off_the_policy_gradient(
    demonstrations: Demonstrations, pretrained: dict[str, th.Tensor]
) -> None:
    """By step a new solution is assimilated each time; only the gradient's own steps count."""
    env, adaptation = Higher(float(GOAL[0]), tolerance=9.0), ACNMPAdaptation.preset("step")
    settings: Any = {"adaptation": adaptation, "population_size": 2}
    model = begun(demonstrations, pretrained, env, **settings).learn(20)
    search = model.searches[0].search
    assert isinstance(search, CriticSearch)
    search.n_taught = before = len(search.points) - 1
    assert not search.is_to_be_taught
    model._adapt(model.searches, model.searches)  # solved anew, and no time to be taught
    assert search.n_taught == before


def test_only_by_place_the_policy_gradient_teaches_a_solution_by_itself() -> None:
    assert ACNMPAdaptation().imitates
    assert not any(ACNMPAdaptation.preset(name).imitates for name in ("to_go", "step"))


def test_the_network_learns_at_the_first_success_and_then_less_and_less_often() -> None:
    space = Subspace(np.zeros((T, 1)), np.random.default_rng(0).standard_normal((3, T, 1)))
    search, taught = CriticSearch(space, 0.7), []

    def tell(success: bool = False) -> None:
        one = np.zeros((1, T, 1), np.float32)
        told = np.array([-1.0]), np.array([success])
        search.tell(Generation(np.zeros((1, 1), np.float32), one, *told))
        if search.is_to_be_taught:
            search.was_taught()
            taught.append(len(search.points))

    for _ in range(31):
        tell()
    assert taught == [1, 2, 3, 4, 5, 6, 7, 9, 11, 13, 15, 18, 21, 25, 29]
    for success in (False, True, True):
        tell(success)
    assert taught[-1] == 33  # the first success


def test_beside_weights_that_are_alike_over_time_the_gradient_takes_some_time_points() -> None:
    cnmp = CNMP(context_dim=1, trajectory_shape=(300, 2))
    tried = Generation(
        np.zeros((4, 1), np.float32),
        np.random.default_rng(0).standard_normal((4, 300, 2)).astype(np.float32),
        np.arange(4.0),
        np.zeros(4, bool),
    )

    def points(advantage: Advantage) -> int:
        settings = ACNMPAdaptation(advantage)
        gradient = PolicyGradient(cnmp, settings, np.zeros((1, 1)), [tried])
        assert gradient.loss().isfinite()
        return gradient.tried[0][0].shape[1]

    assert (points("place"), points("step"), points("to_go")) == (50, 300, 300)


@pytest.mark.parametrize("latent", [0.0, 0.5])
def test_an_interrupted_search_that_the_network_drives_goes_on_as_if_it_was_not(
    latent: float, tmp_path: Path
) -> None:
    """The contract tests resume a search by a critic."""
    settings = {"search": "policy", "exploration": ACNMPExploration(latent=latent)}
    n_rollouts, cut = 5 * POPULATION, 3 * POPULATION + 1
    whole = contract.run(contract.build(ACNMP, **settings), n_rollouts)
    first = contract.build(ACNMP, **settings)
    begun = contract.run(first, cut)
    first.save(tmp_path / "model")
    first.save_replay_buffer(tmp_path / "buffer.npz")
    loaded = ACNMP.load(tmp_path / "model", env=gym.make(ENV_ID), demonstrations=DEMONSTRATIONS)
    loaded.load_replay_buffer(str(tmp_path / "buffer.npz"))
    rest = contract.run(loaded, n_rollouts - cut, reset_num_timesteps=False)
    np.testing.assert_array_equal(whole.trajectories, [*begun.trajectories, *rest.trajectories])


def test_before_any_training_it_says_that_its_answers_mean_nothing(
    demonstrations: Demonstrations,
) -> None:
    model = build(demonstrations, Reach())
    context = demonstrations.contexts[0]
    for ask in (model.predict, model.predict_distribution):
        with pytest.warns(UntrainedWarning, match="call learn, or pretrain"):
            ask(context)
    model.pretrain().predict(context)  # warnings are errors in these tests


def test_each_step_takes_the_gradient_of_the_present_weights(
    demonstrations: Demonstrations, pretrained: dict[str, th.Tensor]
) -> None:
    """PyTorch tells where weights were changed before a backward pass, but not of fused Adam."""
    env = Higher(float(GOAL[0]), tolerance=-1.0)
    model = begun(demonstrations, pretrained, env, search="policy", population_size=5)
    model.policy.optimizer = th.optim.Adam(model.policy.cnmp.parameters(), 1e-3)
    assert model.learn(10).num_timesteps == 10


def test_a_network_may_be_trained_without_conditioning_points(
    demonstrations: Demonstrations,
) -> None:
    cnmp = pretrain(
        demonstrations,
        CNMPPretraining(n_steps=3, max_conditioning_points=0),
        np.random.default_rng(0),
    )
    assert np.isfinite(cnmp.trajectories(demonstrations.contexts)).all()
