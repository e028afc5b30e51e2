"""RC-NMP's discrete latent beside the Gaussian one: its bound, its draws, and that it is used."""

import math

import numpy as np
import pytest
import torch as th
from torch.distributions import Normal, kl_divergence

from benchmark_envs.tasks.bottles import BOTTLES
from results.sampling.curves import BUNDLES, bundle_heights, curves
from results.sampling.measures import bundles_found, in_gap
from results.sampling.models import Sampler, SamplingTraining, Start, train_sampler
from sb3_nmp import RCNMP, ConfigurationError, RCNMPTraining
from sb3_nmp.models.cnmp_training import cosine
from sb3_nmp.models.neural_process import NeuralProcess
from sb3_nmp.rcnmp.training import Batch, elbo

K = 3


def network(n_categories: int = K) -> NeuralProcess:
    th.manual_seed(0)
    return NeuralProcess(2, 1, 4, [8], [8], 1, 0.5, th.nn.Tanh, n_categories)


def some_batch() -> Batch:
    th.manual_seed(1)
    return Batch(
        observed_times=th.rand(5, 4),
        observed_values=th.randn(5, 4, 2),
        target_times=th.rand(5, 6),
        target_values=th.randn(5, 6, 2),
        condition=th.randn(5, 1),
        noise=th.randn(5, 4),
    )


# -- the network -----------------------------------------------------------------------------------


def test_the_decoder_sees_the_category_as_a_one_hot_vector_beside_the_latent() -> None:
    net, latent = network(), th.randn(2, 4)
    code = net.code(latent, th.tensor([2, 0]))
    expected = th.tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    th.testing.assert_close(code, th.cat([latent, expected], dim=1))
    times, condition = th.linspace(0, 1, 7), th.zeros(3, 1)
    same = net.code(latent[:1].expand(3, -1), th.arange(3))
    decoded = net.decode(times, same, condition).mean
    assert all((decoded[i] - decoded[j]).abs().max() > 1e-3 for i, j in ((0, 1), (0, 2), (1, 2)))
    with th.no_grad():
        net.decoder.from_latent.weight[:, 4:7] = 0.0
    alike = net.decode(times, same, condition).mean
    th.testing.assert_close(alike[0], alike[2], msg="only the one-hot vector told them apart")


def test_one_category_has_the_parameters_and_the_draws_of_a_network_without_any() -> None:
    plain = network(1)
    assert plain.prior is None and plain.code_dim == 4
    assert plain.encoder[-1].out_features == 8
    assert plain.decoder.from_latent.in_features == 5
    latent = th.randn(2, 4)
    assert plain.code(latent, th.zeros(2, dtype=th.long)) is latent
    posterior = plain.encode(th.rand(2, 3), th.randn(2, 3, 2), th.zeros(2, 1))
    assert bool((posterior.category.probs == 1).all())
    policy = RCNMP("MlpPolicy", "nmp/Bottles-v0", seed=0).policy
    drawn = policy.draw_codes(np.random.default_rng(3), BOTTLES, (2, 5), 1.5)
    rng = np.random.default_rng(3)
    np.testing.assert_array_equal(drawn, 1.5 * rng.standard_normal((2, 5, 4)).astype(np.float32))


def test_no_category_at_all_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="n_categories is 0; it must be >= 1"):
        network(0)


# -- the bound -------------------------------------------------------------------------------------


def test_the_bound_of_one_category_is_that_of_equation_6_2() -> None:
    net, batch = network(1), some_batch()
    bound = elbo(net, batch, 0.3)
    posterior = net.encode(batch.observed_times, batch.observed_values, batch.condition).latent
    mean, std = posterior.mean[:, 0], posterior.stddev[:, 0]
    predicted = net.decode(batch.target_times, mean + std * batch.noise, batch.condition)
    divergence = kl_divergence(Normal(mean, std), Normal(th.zeros(5, 4), 1.0)).sum(-1).mean()
    likelihood = predicted.log_prob(batch.target_values).sum(-1).mean()
    assert th.equal(bound.loss, 0.3 * divergence - likelihood), "bit for bit"
    assert bound.imbalance == 0


def test_the_expectation_over_categories_is_the_exact_sum() -> None:
    net, batch = network(), some_batch()
    bound = elbo(net, batch, 0.3, balance=2.0)
    posterior = net.encode(batch.observed_times, batch.observed_values, batch.condition)
    shares = posterior.category.probs
    likelihood, divergence = th.zeros(()), th.zeros(())
    for b in range(5):
        for k in range(K):
            q = Normal(posterior.latent.mean[b, k], posterior.latent.stddev[b, k])
            code = th.cat([q.mean + q.stddev * batch.noise[b], th.eye(K)[k]])[None]
            predicted = net.decode(batch.target_times[b], code, batch.condition[b : b + 1])
            told = predicted.log_prob(batch.target_values[b : b + 1]).sum(-1).mean()
            likelihood = likelihood + shares[b, k] * told / 5
            divergence = divergence + shares[b, k] * kl_divergence(q, Normal(0.0, 1.0)).sum() / 5
    th.testing.assert_close(bound.log_likelihood, likelihood)
    th.testing.assert_close(bound.divergence, divergence)
    mean = shares.mean(0)
    th.testing.assert_close(bound.imbalance, (mean * (mean * K).log()).sum())
    cross_entropy = th.tensor(math.log(K))  # of an untrained prior, which is uniform
    expected = 0.3 * divergence - likelihood + 2.0 * bound.imbalance + cross_entropy
    th.testing.assert_close(bound.loss, expected)


def test_the_gradient_reaches_every_parameter_and_the_prior_follows_the_posterior_alone() -> None:
    net, batch = network(), some_batch()
    assert net.prior is not None
    elbo(net, batch, 0.3).loss.backward()
    assert all(p.grad is not None and bool(p.grad.abs().sum() > 0) for p in net.parameters())
    shares = net.encode(batch.observed_times, batch.observed_values, batch.condition).category.probs
    th.testing.assert_close(net.prior.bias.grad, 1 / K - shares.mean(0), atol=1e-6, rtol=1e-4)
    before = [p.grad.clone() for p in net.encoder.parameters() if p.grad is not None]
    with th.no_grad():
        net.prior.bias.copy_(th.tensor([2.0, 0.0, -1.0]))
    net.zero_grad()
    elbo(net, batch, 0.3).loss.backward()
    after = [p.grad for p in net.encoder.parameters()]
    for one, other in zip(before, after, strict=True):
        th.testing.assert_close(one, other, msg="the prior acts on the posterior")


# -- what is drawn ---------------------------------------------------------------------------------


def test_categories_are_drawn_as_often_as_the_prior_says_and_reach_what_is_generated() -> None:
    model = RCNMP(
        "MlpPolicy", "nmp/Bottles-v0", seed=0, policy_kwargs={"n_categories": K},
        population_size=10, n_crossover=6, training=RCNMPTraining(3),
    ).learn(30)  # fmt: skip
    policy = model.policy
    prior = policy.network.prior
    assert prior is not None
    with th.no_grad():
        prior.weight.zero_()
        prior.bias.copy_(th.tensor([0.7, 0.3, 1e-9]).log())
    codes = policy.draw_codes(np.random.default_rng(0), BOTTLES, (2, 1000), 3.0)
    assert codes.shape == (2, 1000, 4 + K)
    assert codes[..., :4].std() == pytest.approx(3.0, rel=0.05)
    np.testing.assert_allclose(codes[..., 4:].mean(axis=(0, 1)), [0.7, 0.3, 0.0], atol=0.03)
    context = th.as_tensor(BOTTLES[None], dtype=th.float32)
    likeliest = policy.network.code(th.zeros(1, 4), th.tensor([0]))
    with th.no_grad():
        th.testing.assert_close(policy.generalise(context), policy.generate(context, likeliest))


# -- that categories are used ----------------------------------------------------------------------

SHORT = SamplingTraining(n_steps=1000, n_starts=2, start_steps=200)


def two_bundles(n_categories: int) -> Sampler:
    shown = curves(bundle_heights(BUNDLES["two bundles"]))
    return train_sampler(shown, n_categories, seed=1000, training=SHORT)


def test_two_categories_leave_the_gap_between_two_bundles_empty() -> None:
    """A collapse would fail here: with one category, z crosses the gap."""
    rng, bundles = np.random.default_rng(0), BUNDLES["two bundles"]
    drawn, category = two_bundles(2).draw(500, rng)
    signs = [np.sign(drawn[category == k].mean(axis=(1, 2))).mean() for k in (0, 1)]
    assert sorted(np.round(signs)) == [-1, 1], "each category holds one bundle"
    assert 0.4 < category.mean() < 0.6
    assert in_gap(drawn, bundles).mean() < 0.1
    without, _ = two_bundles(1).draw(500, rng)
    assert in_gap(without, bundles).mean() > 0.25


def test_the_start_of_the_least_loss_goes_on_and_one_category_has_one_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told, trained = [[9.0, 3.0], [9.0, 2.0], [0.0, 4.0], []], list[tuple[Start, int]]()
    monkeypatch.setattr("results.sampling.models.JUDGED", 1)

    def train(start: Start, until: int) -> list[float]:
        trained.append((start, until))
        return told[len(trained) - 1]

    monkeypatch.setattr(Start, "train", train)
    shown, three = curves([0.1, 0.2]), SamplingTraining(50, n_starts=3, start_steps=20)
    sampler = train_sampler(shown, 2, 0, three)
    assert [until for _, until in trained] == [20, 20, 20, 50]
    assert trained[3][0] is trained[1][0] and sampler.network is trained[1][0].network
    weights = [start.network.decoder.from_latent.weight for start, _ in trained[:2]]
    assert not th.equal(*weights), "starts differ"
    trained.clear()
    train_sampler(shown, 1, 0, three)
    assert len({start for start, _ in trained}) == 1


def test_training_in_two_parts_is_training_in_one() -> None:
    values, times = th.as_tensor(curves([0.1, 0.2]), dtype=th.float32), th.linspace(0, 1, 200)
    once, twice = (
        (th.manual_seed(0), Start(values, times, 2, 0, SamplingTraining(8)))[1] for _ in range(2)
    )
    losses = once.train(6)
    assert twice.train(2) + twice.train(6) == losses and len(losses) == 6
    assert twice.optimizer.param_groups[0]["lr"] == cosine(5e-3, 5 / 8), "that of the sixth step"


@pytest.mark.slow
def test_six_categories_find_six_bundles_where_a_single_start_does_not() -> None:
    bundles = BUNDLES["six bundles"]
    found = []
    for n_starts in (1, 5):
        sampler = train_sampler(
            curves(bundle_heights(bundles)), 6, 1000, SamplingTraining(n_starts=n_starts)
        )
        found.append(bundles_found(*sampler.draw(1000, np.random.default_rng(0)), bundles))
    assert found[0] < found[1] == 6
