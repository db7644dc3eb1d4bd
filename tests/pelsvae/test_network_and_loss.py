"""Eq. 3-7 term by term, against slow loops over rows and samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from rc_step_for_tests import SMALL

from pelsvae.loss import objective
from pelsvae.network import LayersVae

FLOAT64_TOL = 1e-12  # rounding of some hundred float64 operations on numbers near 1
N_FEATURES, N_OUTPUTS, N_ROWS, N_SAMPLES = 3, 7, 5, 4


def network(seed: int = 0) -> LayersVae:
    return LayersVae(N_FEATURES, N_OUTPUTS, SMALL, torch.Generator().manual_seed(seed)).double()


def batch() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    shapes = [(N_ROWS, N_OUTPUTS), (N_ROWS, N_FEATURES), (N_SAMPLES, N_ROWS, SMALL.n_latent)]
    x, theta, eps = (torch.randn(shape, generator=generator, dtype=torch.float64) for shape in shapes)
    return x, theta, eps


def test_every_term_equals_its_slow_loop() -> None:
    net, (x, theta, eps), beta = network(), batch(), 7.0
    totals = np.zeros(4)
    for i in range(N_ROWS):
        mean, log_variance = (m[0].tolist() for m in net.encoder(x[i : i + 1], theta[i : i + 1]))
        mean_re, log_variance_re = (m[0].tolist() for m in net.regressor(theta[i : i + 1]))
        decoded = np.zeros(N_OUTPUTS)
        for sample in eps[:, i]:
            z = [m + math.exp(v / 2) * e for m, v, e in zip(mean, log_variance, sample.tolist(), strict=True)]
            z_one = torch.tensor([[z]], dtype=torch.float64)  # (1, 1, z): one sample, one row
            decoded += net.decoder(z_one, theta[i : i + 1])[0].detach().numpy() / N_SAMPLES
        n_latent = len(mean)
        kl = sum(-0.5 * (1 + v - math.exp(v) - m * m) for m, v in zip(mean, log_variance, strict=True))
        error = sum((decoded[j] - x[i, j].item()) ** 2 for j in range(N_OUTPUTS)) / N_OUTPUTS
        of_mean = sum((a - b) ** 2 for a, b in zip(mean, mean_re, strict=True)) / n_latent
        of_scale = (
            sum(
                (math.exp(a / 2) - math.exp(b / 2)) ** 2
                for a, b in zip(log_variance, log_variance_re, strict=True)
            )
            / n_latent
        )
        totals += np.array([kl, error, of_mean, of_scale]) / N_ROWS
    terms = objective(net, x, theta, eps=eps, beta=beta)
    np.testing.assert_allclose([t.item() for t in terms[1:]], totals, rtol=1e-10)
    assert terms.total.item() == pytest.approx(totals @ [1.0, beta, 1.0, 1.0], rel=1e-10)


def test_prediction_is_regressor_then_mean_of_samples() -> None:
    net, (_, theta, _) = network(), batch()
    eps = torch.randn(N_SAMPLES, SMALL.n_latent, dtype=torch.float64, generator=torch.Generator())
    mean, log_variance = net.regressor(theta)
    samples = [net.decoder((mean + torch.exp(0.5 * log_variance) * e)[None], theta) for e in eps]
    expected = torch.stack(samples).mean(dim=0)
    torch.testing.assert_close(net.predict(theta, eps), expected, rtol=FLOAT64_TOL, atol=FLOAT64_TOL)


def test_residual_layers_are_what_the_equations_say() -> None:
    config = SMALL.replace(residual=True, n_layers=4)
    net = LayersVae(N_FEATURES, N_OUTPUTS, config, torch.Generator().manual_seed(0)).double()
    (_, theta, _), silu = batch(), torch.nn.functional.silu
    with torch.no_grad():
        net.scale.fill_(0.1)
        seen = theta * 1.6
        hidden = silu(net.regressing_first(seen))
        for layer, of_theta in zip(net.regressing.inner, net.regressing.inner_theta, strict=True):
            hidden = hidden + silu(layer(hidden) + of_theta(seen))
        mean, _ = (net.regressing.last(hidden) + net.regressing.last_theta(seen)).chunk(2, dim=-1)
        torch.testing.assert_close(net.regressor(theta)[0], mean)


def test_regression_terms_reach_the_encoder_unless_detached() -> None:
    def encoder_gradients(detach: bool) -> list[torch.Tensor | None]:
        net, (x, theta, eps) = network(), batch()
        terms = objective(net, x, theta, eps=eps, beta=1.0, detach_encoder=detach)
        (terms.regression_mean + terms.regression_scale).backward()
        assert net.regressing_first.weight.grad is not None
        return [weight.grad for weight in net.encoding_first.parameters()]

    assert all(gradient is None for gradient in encoder_gradients(detach=True))
    assert all(gradient is not None and gradient.any() for gradient in encoder_gradients(detach=False))


def test_weights_come_from_the_generator_alone() -> None:
    before = torch.get_rng_state()
    weights = [torch.cat([w.flatten() for w in network(seed).parameters()]) for seed in (3, 3, 4)]
    assert torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])
    assert torch.equal(torch.get_rng_state(), before)
