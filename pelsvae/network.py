"""The whole network: encoder, decoder and regressor, every one of them given theta (Fig. 3)."""

import math
from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor, nn

from pelsvae.config import SurrogateConfig

_LOG_VARIANCE_BOUND = 12.0  # reached by no good training; a leap of the optimizer cannot overflow exp()
# Without learnt scales the error is 0.224 instead of 0.208 K at n = 256 (docs/paper.md).
_SCALE_RATE = 6.0  # a feature's scale learns so many times faster than a weight; 12 and 20 gain no more


class PelsVae(nn.Module):
    """Physics-enhanced latent space variational autoencoder: encoder and regressor; subclasses decode.

    With `residual` each hidden layer adds to what the layers before gave and reads theta too, and each
    feature of theta has a learnt scale. So the networks can be deep; measured in docs/paper.md.

    Shapes: b rows, f features of theta, d outputs (times x outputs), z latent, h hidden, L samples.
    A Gaussian in latent space is always a pair (mean, log-variance), each (b, z).

    Attributes:
        rows_at_once: Rows whose prediction fits near a core.
    """

    rows_at_once = 128  # 8 samples of 128 rows at h = 256 are 1 MiB: they stay in a core's cache

    def __init__(
        self, n_features: int, n_outputs: int, config: SurrogateConfig, generator: torch.Generator
    ) -> None:
        """Build encoder and regressor with weights drawn from a generator.

        Args:
            n_features: Features of theta, f.
            n_outputs: Numbers in a flattened trajectory, d.
            config: Widths, depth, activation.
            generator: Source of the initial weights (CPU).
        """
        super().__init__()
        f, z, h = n_features, config.n_latent, config.n_hidden
        linear = partial(_drawn, generator)
        self.encoding_first = linear(n_outputs + f, h)
        self.encoding = _Layers(f, 2 * z, config, linear)
        self.regressing_first = linear(f, h)
        self.regressing = _Layers(f, 2 * z, config, linear)
        self.scale = nn.Parameter(torch.zeros(f)) if config.residual else None

    def encoder(self, x: Tensor, theta: Tensor) -> tuple[Tensor, Tensor]:
        """psi(x, theta): x (b, d), theta (b, f) -> mean, log-variance of z, each (b, z)."""
        theta = self._scaled(theta)
        return _gaussian(self.encoding(self.encoding_first(torch.cat([x, theta], dim=-1)), theta))

    def regressor(self, theta: Tensor) -> tuple[Tensor, Tensor]:
        """varphi(theta), Eq. 6: theta (b, f) -> mean, log-variance of z, each (b, z)."""
        theta = self._scaled(theta)
        return _gaussian(self.regressing(self.regressing_first(theta), theta))

    def decoder(self, z: Tensor, theta: Tensor) -> Tensor:
        """Mean of L decoded samples, Eq. 7: z (L, b, z), theta (b, f) -> x (b, d)."""
        raise NotImplementedError

    def predict(self, theta: Tensor, eps: Tensor) -> Tensor:
        """Eq. 6-7, without x: theta (b, f), eps (L, z) -> x (b, d)."""
        mean, log_variance = self.regressor(theta)
        z = latent_samples(mean, log_variance, eps[:, None, :])  # (L, b, z)
        return self.decoder(z, theta)

    def _scaled(self, theta: Tensor) -> Tensor:
        # Adam's steps are of one size whatever the gradient, so the factor alone makes the rate.
        # The parameter is the distance from 1: weight decay draws the scale to 1, not to 0.
        return theta if self.scale is None else theta * (1.0 + _SCALE_RATE * self.scale)


class LayersVae(PelsVae):
    """PELS-VAE whose decoder is layers too."""

    def __init__(
        self, n_features: int, n_outputs: int, config: SurrogateConfig, generator: torch.Generator
    ) -> None:
        """Build the three networks with weights drawn from a generator; arguments as of `PelsVae`."""
        super().__init__(n_features, n_outputs, config, generator)
        f, z, h = n_features, config.n_latent, config.n_hidden
        linear = partial(_drawn, generator)
        # The decoder's first layer on (z, theta), written as two: L samples of z share theta's half.
        self.decoding_z = linear(z, h, fan_in=z + f, bias=False)
        self.decoding_theta = linear(f, h, fan_in=z + f)
        self.decoding = _Layers(f, n_outputs, config, linear)

    def decoder(self, z: Tensor, theta: Tensor) -> Tensor:
        """Mean of L decoded samples, Eq. 7: z (L, b, z), theta (b, f) -> x (b, d)."""
        theta = self._scaled(theta)
        x: Tensor = self.decoding(self.decoding_z(z) + self.decoding_theta(theta), theta)
        return x


class _Layers(nn.Module):
    """What follows a first linear layer: activation, hidden layers, a last linear layer."""

    def __init__(
        self, n_features: int, n_outputs: int, config: SurrogateConfig, linear: Callable[..., nn.Linear]
    ) -> None:
        super().__init__()
        h, n_inner = config.n_hidden, config.n_layers - 2
        self.activation = {"relu": nn.ReLU, "silu": nn.SiLU}[config.activation]()
        self.inner = nn.ModuleList([linear(h, h) for _ in range(n_inner)])
        self.last = linear(h, n_outputs)
        self.residual = config.residual
        if config.residual:
            self.inner_theta = nn.ModuleList(
                [linear(n_features, h, fan_in=h, bias=False) for _ in range(n_inner)]
            )
            self.last_theta = linear(n_features, n_outputs, fan_in=h, bias=False)

    def forward(self, first: Tensor, theta: Tensor) -> Tensor:
        """First sums (b, h) or (L, b, h), theta (b, f) -> outputs (b, n_outputs), the mean over L.

        The last layer is linear, so averaging before it gives the same mean and runs it once, not L times.
        """
        hidden = self.activation(first)
        for place, layer in enumerate(self.inner):
            if self.residual:
                # theta again in each layer: without it 0.224 instead of 0.208 K at n = 256.
                hidden = hidden + self.activation(layer(hidden) + self.inner_theta[place](theta))
            else:
                hidden = self.activation(layer(hidden))
        out: Tensor = self.last(hidden.mean(dim=0) if hidden.ndim == 3 else hidden)
        return out + self.last_theta(theta) if self.residual else out


# torch's own way to unset weights, `to_empty`, loads SymPy: 1 to 1.7 s in every process.
class _Linear(nn.Linear):
    """A layer whose weights are unset until they are drawn: torch would, from the global generator."""

    def reset_parameters(self) -> None:
        """Leave the weights as they are."""


def _drawn(
    generator: torch.Generator, n_in: int, n_out: int, fan_in: int | None = None, bias: bool = True
) -> nn.Linear:
    """Return a layer with weights drawn from a generator."""
    layer = _Linear(n_in, n_out, bias=bias)
    bound = 1.0 / math.sqrt(fan_in or n_in)  # torch's own default for nn.Linear
    for weight in layer.parameters():
        nn.init.uniform_(weight, -bound, bound, generator=generator)
    return layer


def _gaussian(heads: Tensor) -> tuple[Tensor, Tensor]:
    """Split (b, 2 z) into mean and log-variance, each (b, z); sigma lies between 0.0025 and 400."""
    mean, log_variance = heads.chunk(2, dim=-1)
    # tanh and not a clamp: beyond a clamp there is no gradient that leads back.
    return mean, _LOG_VARIANCE_BOUND * torch.tanh(log_variance / _LOG_VARIANCE_BOUND)


def latent_samples(mean: Tensor, log_variance: Tensor, eps: Tensor) -> Tensor:
    """Draw z = mu + sigma * eps: mean, log-variance (b, z), eps (L, b or 1, z) -> z (L, b, z)."""
    return torch.addcmul(mean, torch.exp(0.5 * log_variance), eps)
