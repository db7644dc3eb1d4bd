"""The whole network: encoder, decoder and regressor, every one of them given theta (Fig. 3)."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from pelsvae.config import SurrogateConfig

_LOG_VARIANCE_BOUND = 12.0  # reached by no good training; a leap of the optimizer cannot overflow exp()


class _Linear(nn.Linear):
    """A layer whose weights are unset until they are drawn: torch would, from the global generator."""

    def reset_parameters(self) -> None:
        """Leave the weights as they are."""


class PelsVae(nn.Module):
    """Physics-enhanced latent space variational autoencoder.

    Shapes: b rows, f features of theta, d outputs (times x outputs), z latent, h hidden, L samples.
    A Gaussian in latent space is always a pair (mean, log-variance), each (b, z).
    """

    def __init__(
        self, n_features: int, n_outputs: int, config: SurrogateConfig, generator: torch.Generator
    ) -> None:
        """Build the three networks with weights drawn from a generator.

        Args:
            n_features: Features of theta, f.
            n_outputs: Numbers in a flattened trajectory, d.
            config: Widths, depth, activation.
            generator: Source of the initial weights (CPU).
        """
        super().__init__()
        z, h, n_inner = config.n_latent, config.n_hidden, config.n_layers - 2
        activation = {"relu": nn.ReLU, "silu": nn.SiLU}[config.activation]

        def linear(n_in: int, n_out: int, fan_in: int | None = None, bias: bool = True) -> nn.Linear:
            layer = _Linear(n_in, n_out, bias=bias)
            bound = 1.0 / math.sqrt(fan_in or n_in)  # torch's own default for nn.Linear
            for weight in layer.parameters():
                nn.init.uniform_(weight, -bound, bound, generator=generator)
            return layer

        def inner() -> list[nn.Module]:
            return [module for _ in range(n_inner) for module in (linear(h, h), activation())]

        self.encoding = nn.Sequential(
            linear(n_outputs + n_features, h), activation(), *inner(), linear(h, 2 * z)
        )
        self.regressing = nn.Sequential(linear(n_features, h), activation(), *inner(), linear(h, 2 * z))
        # The decoder's first layer on (z, theta), written as two: L samples of z share theta's half.
        self.decoding_z = linear(z, h, fan_in=z + n_features, bias=False)
        self.decoding_theta = linear(n_features, h, fan_in=z + n_features)
        self.decoding = nn.Sequential(activation(), *inner())
        self.decoding_out = linear(h, n_outputs)

    def encoder(self, x: Tensor, theta: Tensor) -> tuple[Tensor, Tensor]:
        """psi(x, theta): x (b, d), theta (b, f) -> mean, log-variance of z, each (b, z)."""
        return _gaussian(self.encoding(torch.cat([x, theta], dim=-1)))

    def regressor(self, theta: Tensor) -> tuple[Tensor, Tensor]:
        """varphi(theta), Eq. 6: theta (b, f) -> mean, log-variance of z, each (b, z)."""
        return _gaussian(self.regressing(theta))

    def decoder(self, z: Tensor, theta: Tensor) -> Tensor:
        """Mean of L decoded samples, Eq. 7: z (L, b, z), theta (b, f) -> x (b, d).

        The last layer is linear, so averaging before it gives the same mean and runs it once, not L times.
        """
        hidden = self.decoding(self.decoding_z(z) + self.decoding_theta(theta))  # (L, b, h)
        x: Tensor = self.decoding_out(hidden.mean(dim=0))  # (b, d)
        return x

    def predict(self, theta: Tensor, eps: Tensor) -> Tensor:
        """Eq. 6-7, without x: theta (b, f), eps (L, z) -> x (b, d)."""
        mean, log_variance = self.regressor(theta)
        z = latent_samples(mean, log_variance, eps[:, None, :])  # (L, b, z)
        return self.decoder(z, theta)


def _gaussian(heads: Tensor) -> tuple[Tensor, Tensor]:
    """Split (b, 2 z) into mean and log-variance, each (b, z); sigma lies between 0.0025 and 400."""
    mean, log_variance = heads.chunk(2, dim=-1)
    return mean, _LOG_VARIANCE_BOUND * torch.tanh(log_variance / _LOG_VARIANCE_BOUND)


def latent_samples(mean: Tensor, log_variance: Tensor, eps: Tensor) -> Tensor:
    """Draw z = mu + sigma * eps: mean, log-variance (b, z), eps (L, b or 1, z) -> z (L, b, z)."""
    return torch.addcmul(mean, torch.exp(0.5 * log_variance), eps)
