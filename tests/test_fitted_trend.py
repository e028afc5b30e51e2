"""The fitted trend: a CNMP begins as the linear regression of demonstrations on their contexts."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch as th

from sb3_nmp import CNMPArchitecture, CNMPPretraining, Demonstrations
from sb3_nmp.models.cnmp import CNMP
from sb3_nmp.models.cnmp_training import pretrain

T = 40
TIMES = np.linspace(0.0, 1.0, T)
SMALL = CNMPArchitecture(representation_dim=4, encoder_arch=(16,), decoder_arch=(16,), n_members=3)
FITTED = SMALL
BESIDE = replace(SMALL, context_in_decoder=False)  # the trend alone sees the contexts
RNG = np.random.default_rng(0)
SHOWN = RNG.uniform(-1.0, 1.0, (12, 2))
BEYOND = np.array([[3.0, -3.0], [-2.5, 2.5], [4.0, 4.0]])


def linear(contexts: np.ndarray) -> np.ndarray:
    """Start at 5 always, and go evenly to twice the contexts: shape (N, T, 2)."""
    return 5.0 + TIMES[:, None] * (2.0 * contexts[:, None] - 5.0)


def answer(architecture: CNMPArchitecture, n_steps: int) -> np.ndarray:
    """Return what a CNMP answers beyond its demonstrations, (N, T, 2)."""
    th.manual_seed(0)
    cnmp = CNMP(2, (T, 2), architecture)
    shown, training = Demonstrations(SHOWN, linear(SHOWN)), CNMPPretraining(n_steps)
    return pretrain(shown, training, np.random.default_rng(0), cnmp).trajectories(BEYOND)


@pytest.mark.parametrize("architecture", [FITTED, BESIDE])
@pytest.mark.parametrize("n_members", [1, 3])
def test_before_any_step_the_trend_is_the_regression(
    architecture: CNMPArchitecture, n_members: int
) -> None:
    th.manual_seed(0)
    cnmp = CNMP(2, (T, 2), replace(architecture, n_members=n_members))
    demonstrations = Demonstrations(SHOWN, linear(SHOWN))
    cnmp.set_scale(demonstrations)
    decoder = cnmp.network.decoder
    assert decoder.trend is not None
    for part in (decoder.trend, decoder.layers[-1]):
        for parameter in part.parameters():  # learned earlier
            th.nn.init.normal_(parameter)
    cnmp.fit_trend(demonstrations, th.zeros(len(SHOWN), dtype=th.long))
    # the ridge, 0.01, takes that share of the slopes
    np.testing.assert_allclose(cnmp.trajectories(BEYOND), linear(BEYOND), atol=0.12)
    np.testing.assert_allclose(cnmp.trajectories(BEYOND)[:, 0], 5.0, atol=0.02)


def test_single_precision_suffices() -> None:
    """Over half of their period waves are nearly collinear: weights must not cancel each other."""
    times = np.linspace(0.0, 1.0, 200)[:, None]
    bent = np.where(times < 0.3, 0.0, times - 0.3) * SHOWN[:, None] + (times > 0.7)
    th.manual_seed(0)
    cnmp = CNMP(2, (200, 2), FITTED)
    pretrain(Demonstrations(SHOWN, bent), CNMPPretraining(0), np.random.default_rng(0), cnmp)
    exact = copy.deepcopy(cnmp).double().trajectories(SHOWN)
    np.testing.assert_allclose(cnmp.trajectories(SHOWN), exact, atol=1e-5)


@pytest.mark.parametrize("architecture", [FITTED, BESIDE])
def test_what_is_linear_is_met_sooner_and_beyond_the_demonstrations(
    architecture: CNMPArchitecture,
) -> None:
    fitted, learned = (
        np.abs(answer(each, 200) - linear(BEYOND)).max()
        for each in (architecture, replace(architecture, fitted_trend=False))
    )
    assert fitted < 0.5 * learned


@pytest.mark.parametrize("architecture", [FITTED, BESIDE])
def test_the_rest_is_still_learned(architecture: CNMPArchitecture) -> None:
    bent = linear(SHOWN) + np.sin(np.pi * TIMES)[:, None] * SHOWN[:, None] ** 2
    th.manual_seed(0)
    cnmp = CNMP(2, (T, 2), architecture)
    training = CNMPPretraining(600)
    pretrain(Demonstrations(SHOWN, bent), training, np.random.default_rng(0), cnmp)
    error = np.abs(cnmp.trajectories(SHOWN) - bent).mean()
    assert error < 0.2 * np.abs(bent - linear(SHOWN)).mean()


def test_with_modes_each_has_a_trend_of_its_own() -> None:
    few = SHOWN[::2]
    contexts = np.concatenate([SHOWN, few])
    both = np.concatenate([linear(SHOWN) + 3.0, linear(few) - 3.0])
    th.manual_seed(0)
    cnmp = CNMP(2, (T, 2), replace(FITTED, n_modes=2))
    pretrain(Demonstrations(contexts, both), CNMPPretraining(0), np.random.default_rng(0), cnmp)
    ways = cnmp.each_mode(th.as_tensor(SHOWN[:1], dtype=th.float32))[0].mean(dim=(1, 2)).numpy()
    both_means = linear(SHOWN[:1]).mean() + np.array([-3.0, 3.0])
    np.testing.assert_allclose(np.sort(ways), both_means, atol=0.6)


def test_without_a_trend_none_is_fitted() -> None:
    plain = replace(BESIDE, linear_trend=False)
    np.testing.assert_array_equal(answer(plain, 0), answer(replace(plain, fitted_trend=False), 0))
