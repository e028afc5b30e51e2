"""Eq. 4.1 in the training of a CNMP, and the weights that keep what is met badly in it."""

from dataclasses import replace

import numpy as np
import pytest
import torch as th

from results.algorithms import NETWORK_DRIVES, THESIS_NETWORK
from sb3_nmp import CNMPArchitecture, CNMPPretraining, ConfigurationError, Demonstrations
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.cnmp_training import PointSampler, negative_log_likelihood, pretrain

T = 30
TIMES = np.linspace(0.0, 1.0, T)
CONTEXTS = np.linspace(-1.0, 1.0, 9)[:, None]
#: all about alike, but for a turn between two contexts
TURNED = (np.tanh(20 * (CONTEXTS - 0.1)) * np.sin(3 * np.pi * TIMES))[..., None]
WEIGHED = CNMPArchitecture(
    representation_dim=4, encoder_arch=(32,), decoder_arch=(32, 32), n_members=3
)
LIKELIHOOD_ALONE = replace(WEIGHED, beta_nll=0.0)


def worst_error(architecture: CNMPArchitecture, seed: int) -> float:
    """Return the root mean square error in the demonstration that is met worst."""
    th.manual_seed(seed)
    cnmp = CNMP(1, (T, 1), architecture)
    shown = Demonstrations(CONTEXTS, TURNED)
    pretrain(shown, CNMPPretraining(600), np.random.default_rng(seed), cnmp)
    errors = np.square(cnmp.trajectories(CONTEXTS) - TURNED).mean(axis=(1, 2))
    return float(np.sqrt(errors.max()))


def test_the_demonstration_that_is_met_worst_is_met_better() -> None:
    """By likelihood alone it is taken for noise: its standard deviation grows, and it is left."""
    weighed, alone = (
        np.median([worst_error(each, seed) for seed in range(3)])
        for each in (WEIGHED, LIKELIHOOD_ALONE)
    )
    assert weighed < 0.6 * alone


@pytest.mark.parametrize("beta", [0.0, 0.5, 1.0])
def test_points_weigh_as_their_predicted_variance_to_the_power_of_beta(beta: float) -> None:
    th.manual_seed(0)
    cnmp = CNMP(1, (T, 1), replace(WEIGHED, n_members=1))
    values, contexts = cnmp.times.new_tensor(TURNED), cnmp.times.new_tensor(CONTEXTS)
    training = CNMPPretraining(max_conditioning_points=0)
    (batch,) = PointSampler(training, cnmp.times, values, contexts, np.random.default_rng(0)).draw(
        1
    )
    code = cnmp.network.encode_condition(batch.condition)
    predicted = cnmp.network.decode_members(batch.times, code, batch.condition)
    weights = predicted.variance.detach() ** beta
    assert weights.std() > 0 or beta == 0
    expected = -(weights * predicted.log_prob(batch.values)).mean()
    parameters = list(cnmp.network.decoder.parameters())
    loss = negative_log_likelihood(cnmp.network, batch, beta)
    th.testing.assert_close(loss, expected)
    for own, asked in zip(
        th.autograd.grad(loss, parameters), th.autograd.grad(expected, parameters), strict=True
    ):
        th.testing.assert_close(own, asked)


def test_rows_that_name_the_thesis_have_its_likelihood() -> None:
    assert CNMPArchitecture().beta_nll == 0.5
    drives = NETWORK_DRIVES["policy_kwargs"]
    assert isinstance(drives, dict)
    for each in (THESIS_NETWORK, CNMPArchitecture.preset("latent"), drives["cnmp"]):
        assert each.beta_nll == 0.0


@pytest.mark.parametrize("wrong", [-0.1, 1.5, float("nan")])
def test_a_power_that_nothing_is_known_of_is_refused(wrong: float) -> None:
    with pytest.raises(ConfigurationError, match=rf"beta_nll is {wrong}; it must be in \[0, 1\]"):
        CNMPArchitecture(beta_nll=wrong)
