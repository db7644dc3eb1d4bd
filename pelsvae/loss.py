"""The objective of Eq. 3-5, one function per term; every term is a mean over the rows of the batch."""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import mse_loss

from pelsvae.network import PelsVae, latent_samples


class LossTerms(NamedTuple):
    """The objective and its parts, each a scalar tensor; beta is already in total, not in reconstruction."""

    total: Tensor
    kl: Tensor
    reconstruction: Tensor
    regression_mean: Tensor
    regression_scale: Tensor


def kl_divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL(N(mu, sigma²) || N(0, I)), summed over latent dimensions (first line of Eq. 4, sign reversed).

    Args:
        mean: mu. Shape (b, z).
        log_variance: log sigma². Shape (b, z).

    Returns:
        Mean over rows; scalar.
    """
    # expm1 keeps the smallest divergences from rounding below zero.
    per_row = 0.5 * (torch.expm1(log_variance) - log_variance + mean.square()).sum(dim=-1)
    return per_row.mean()


def reconstruction(decoded: Tensor, x: Tensor) -> Tensor:
    """Mean squared error over times and outputs of the mean decoded sample (second line of Eq. 4).

    Args:
        decoded: Mean of L decoded samples. Shape (b, d).
        x: Standardized trajectories. Shape (b, d).

    Returns:
        Mean over rows, not yet times beta; scalar.
    """
    return mse_loss(decoded, x)


def regression_mean(mean: Tensor, mean_regressed: Tensor) -> Tensor:
    """MSE(mu, mu_re) of Eq. 5: both (b, z) -> scalar."""
    return mse_loss(mean_regressed, mean)


def regression_scale(log_variance: Tensor, log_variance_regressed: Tensor) -> Tensor:
    """MSE(sigma, sigma_re) of Eq. 5, of sigma itself and not of its logarithm: both (b, z) -> scalar."""
    return mse_loss(torch.exp(0.5 * log_variance_regressed), torch.exp(0.5 * log_variance))


def objective(
    network: PelsVae, x: Tensor, theta: Tensor, *, eps: Tensor, beta: float, detach_encoder: bool = False
) -> LossTerms:
    """Eq. 5 for one batch.

    Args:
        network: The three networks.
        x: Standardized trajectories. Shape (b, d).
        theta: Features of theta. Shape (b, f).
        eps: Standard normal draws. Shape (L, b, z).
        beta: Weight of the reconstruction, Eq. 4.
        detach_encoder: Let the regressor learn from the encoder without pulling on it.

    Returns:
        The sum to minimize and its terms.
    """
    mean, log_variance = network.encoder(x, theta)
    mean_regressed, log_variance_regressed = network.regressor(theta)
    decoded = network.decoder(latent_samples(mean, log_variance, eps), theta)
    # Before a possible detach(): the encoder always learns from the terms of Eq. 4.
    kl = kl_divergence(mean, log_variance)
    if detach_encoder:
        mean, log_variance = mean.detach(), log_variance.detach()
    error = reconstruction(decoded, x)
    of_mean = regression_mean(mean, mean_regressed)
    of_scale = regression_scale(log_variance, log_variance_regressed)
    return LossTerms(kl + beta * error + of_mean + of_scale, kl, error, of_mean, of_scale)
