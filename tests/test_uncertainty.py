"""How sure ACNMP is: ensembles, their spreads, and contexts outside the observation space."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import torch as th

from sb3_nmp import (
    ACNMP,
    CNMPArchitecture,
    CNMPPretraining,
    ConfigurationError,
    ContextWarning,
    Demonstrations,
    TrajectoryDistribution,
)
from sb3_nmp.acnmp.exploration import latent_axes
from sb3_nmp.models import cnmp_training
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.cnmp_training import PointBatch, PointSampler, negative_log_likelihood
from sb3_nmp.models.conditional_neural_process import ConditionalNeuralProcess
from sb3_nmp.models.networks import MemberLinear
from tests.test_acnmp import SHOWN, Reach, T, expert

E = 3
ENSEMBLE = CNMPArchitecture(
    representation_dim=4, encoder_arch=(16,), decoder_arch=(32,), n_frequencies=2, n_members=E
)
DEMONSTRATIONS = Demonstrations(SHOWN, expert(SHOWN))
QUICK = CNMPPretraining(600)


def build(architecture: CNMPArchitecture = ENSEMBLE) -> ACNMP:
    return ACNMP(
        "MlpPolicy",
        Reach(),
        demonstrations=DEMONSTRATIONS,
        pretraining=QUICK,
        policy_kwargs={"cnmp": architecture},
        seed=0,
    ).pretrain()


@pytest.fixture(scope="module")
def model() -> ACNMP:
    return build()


def test_the_ensemble_answers_with_its_members_mean(model: ACNMP) -> None:
    contexts = np.array([[-0.7], [0.4]], np.float32)
    found = model.predict_distribution(contexts)
    assert found.mean.shape == found.aleatoric_std.shape == found.epistemic_std.shape == (2, T, 1)
    assert found.member_means.shape == (E, 2, T, 1)
    answers, _ = model.predict(contexts, deterministic=True)
    np.testing.assert_allclose(found.mean, answers, atol=1e-5)
    np.testing.assert_allclose(found.member_means.mean(axis=0), answers, atol=1e-5)
    single = model.predict_distribution(contexts[1])
    for part in ("mean", "aleatoric_std", "epistemic_std"):
        np.testing.assert_allclose(getattr(single, part), getattr(found, part)[1], atol=1e-5)


def test_each_member_learns_the_demonstrations(model: ACNMP) -> None:
    found = model.predict_distribution(SHOWN)
    assert np.abs(found.member_means - expert(SHOWN)).mean(axis=(1, 2, 3)).max() < 0.05


def test_members_disagree_far_from_the_demonstrations_and_agree_on_them(model: ACNMP) -> None:
    inside = model.predict_distribution(np.array([[-0.5], [0.1], [0.8]])).epistemic_std
    outside = model.predict_distribution(np.array([[-3.0], [2.5], [3.0]])).epistemic_std
    assert outside.mean(axis=(1, 2)).min() > 5 * inside.mean(axis=(1, 2)).max() > 0


def test_the_aleatoric_spread_is_that_of_the_demonstrations() -> None:
    """Where equal contexts were answered differently, the network says so."""
    contexts = np.repeat(SHOWN, 20, axis=0)
    rng = np.random.default_rng(0)
    spread = 0.2 * rng.standard_normal((len(contexts), 1, 1)) * np.ones((1, T, 1))
    shown = Demonstrations(contexts, expert(contexts) + spread)
    model = ACNMP(
        "MlpPolicy",
        Reach(),
        demonstrations=shown,
        pretraining=CNMPPretraining(600, batch_size=32),
        policy_kwargs={"cnmp": ENSEMBLE},
        seed=0,
    ).pretrain()
    found = model.predict_distribution(np.array([[0.0]]))
    assert 0.1 < found.aleatoric_std.mean() < 0.3
    assert found.epistemic_std.mean() < 0.5 * found.aleatoric_std.mean()


def test_both_spreads_are_near_zero_at_a_via_point_alone(model: ACNMP) -> None:
    moment, context = 12, np.array([0.3])
    points = ([moment / (T - 1)], [[0.5]])
    free, found = (model.predict_distribution(context, at) for at in (None, points))
    assert found.mean[moment, 0] == pytest.approx(0.5, abs=1e-3)
    for part in ("aleatoric_std", "epistemic_std"):
        there = getattr(found, part)
        assert there[moment, 0] < 0.02 * getattr(free, part).mean()
        assert there[0].mean() > 0.1 * getattr(free, part)[0].mean()


def test_one_network_has_no_epistemic_spread_and_says_so() -> None:
    arrays = np.zeros((T, 1)), np.ones((T, 1)), np.zeros((1, T, 1))
    with pytest.raises(ConfigurationError, match=r"n_members is 1.*CNMPArchitecture\(n_members=5"):
        _ = TrajectoryDistribution(*arrays).epistemic_std
    for wrong in (0, 1.5):
        with pytest.raises(ConfigurationError, match=f"n_members is {wrong}; it must be a whole"):
            CNMPArchitecture(n_members=wrong)  # pyright: ignore[reportArgumentType]


def test_a_layer_of_members_is_each_members_layer() -> None:
    layer, rows = MemberLinear(E, 3, 2), th.randn(E, 5, 4, 3)
    for member in range(E):
        assert layer.bias is not None
        wanted = rows[member] @ layer.weight[member] + layer.bias[member]
        th.testing.assert_close(layer(rows)[member], wanted)
    assert not th.equal(layer.weight[0], layer.weight[1])


def test_members_share_nothing() -> None:
    """A loss of one member has no gradient in the others."""
    th.manual_seed(0)
    cnmp = CNMP(1, (T, 1), ENSEMBLE)
    condition = cnmp.condition(th.zeros(2, 1))
    split = cnmp.network.split(cnmp.representation(condition))
    cnmp.network.decode_members(cnmp.times, split, condition).mean[1].sum().backward()
    gradients = [p.grad for p in cnmp.network.parameters() if p.grad is not None]
    assert len(gradients) > 4
    for gradient in gradients:
        assert not gradient[0].any()
        assert not gradient[2].any()
    assert any(gradient[1].any() for gradient in gradients)


def test_each_member_trains_on_batches_of_its_own() -> None:
    cnmp = CNMP(1, (T, 1), ENSEMBLE)
    sampler = PointSampler(
        CNMPPretraining(batch_size=4),
        cnmp.times,
        cnmp.times.new_tensor(DEMONSTRATIONS.trajectories),
        cnmp.times.new_tensor(SHOWN),
        np.random.default_rng(0),
        E,
    )
    batch = sampler.draw(2)[1]
    assert batch.times.shape == (E, 4, 10)
    assert batch.values.shape == (E, 4, 10, 1)
    assert not th.equal(batch.times[0], batch.times[1])
    assert not th.equal(batch.condition[0], batch.condition[1])
    assert negative_log_likelihood(cnmp.network, batch).shape == ()


def test_pretraining_gives_each_member_its_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[int, ...]] = []

    def loss(network: ConditionalNeuralProcess, batch: PointBatch, beta: float) -> th.Tensor:
        seen.append(tuple(batch.condition.shape))
        return negative_log_likelihood(network, batch, beta)

    monkeypatch.setattr(cnmp_training, "negative_log_likelihood", loss)
    cnmp = CNMP(1, (T, 1), ENSEMBLE)
    cnmp_training.pretrain(DEMONSTRATIONS, CNMPPretraining(1), np.random.default_rng(0), cnmp)
    assert seen == [(E, 7, 1)]


def test_latent_axes_span_all_members_and_move_the_answer(model: ACNMP) -> None:
    cnmp = model.policy.cnmp
    axes = latent_axes(cnmp, DEMONSTRATIONS, 3)
    assert axes.shape == (3, E * 4)
    assert bool((axes[0].view(E, 4).norm(dim=1) > 0).all())


@pytest.mark.parametrize("search", ["critic", "policy"])
def test_an_ensemble_adapts_and_is_saved(search: str, tmp_path: Path) -> None:
    model = ACNMP(
        "MlpPolicy",
        Reach(2.0),
        demonstrations=DEMONSTRATIONS,
        pretraining=QUICK,
        policy_kwargs={"cnmp": ENSEMBLE},
        search=search,  # pyright: ignore[reportArgumentType]
        seed=0,
    ).learn(9)
    model.save(tmp_path / "model")
    loaded = ACNMP.load(tmp_path / "model")
    for part in ("mean", "epistemic_std"):
        before, after = (
            getattr(each.predict_distribution(np.array([0.3])), part) for each in (model, loaded)
        )
        np.testing.assert_array_equal(before, after)


# -- contexts outside the observation space --------------------------------------------------------


def test_a_context_outside_the_observation_space_is_named_once_a_call(model: ACNMP) -> None:
    message = r"context \[3.5\] has 3.5 in dimension 0, outside .* -3 to 3: .*\(2 of 3 contexts"
    contexts, points = np.array([[0.0], [3.5], [-4.0]]), ([0.5], [[0.0]])
    for call in (
        lambda: model.predict(contexts, deterministic=True),
        lambda: model.predict(contexts, via_points=points),
        lambda: model.predict_distribution(contexts),
        lambda: model.policy.predict(contexts),
    ):
        with pytest.warns(ContextWarning, match=message) as caught:
            call()
        assert len(caught) == 1
    with pytest.warns(ContextWarning, match="extrapolation.$"):
        model.predict(np.array([-3.1]))


def test_contexts_inside_are_answered_without_a_word(model: ACNMP) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for context in (-3.0, 3.0, 0.1):
            model.predict(np.array([context]))
            model.predict_distribution(np.array([[context]]))
