"""A few networks from theta to the principal coordinates, trained side by side: one more candidate.

Where trajectories shift in time, coordinates turn over and over along a parameter, and stationary bumps need
many rows for every turn; layers need fewer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import torch
from torch import Tensor, nn

from pelsvae.device import denormals_flushed

N_NETWORKS = 4
WIDTH = 96
N_HIDDEN = 6
STEPS = 300  # at least
EPOCHS = 225  # at least
BATCH_ROWS = 1024  # half as many cost the oscillator a tenth of its error at n = 1,024
_LEARNING_RATE = 8e-3
_WEIGHT_DECAY = 1.5
_WARM_UP = 0.2  # part of the steps in which the learning rate rises


class NetworkEnsemble(nn.Module):
    """Layers with a leading dimension of e networks; computes in double precision as the processes do.

    Shapes: b rows, f features of theta, z latent, e networks, layers of i inputs and o outputs.

    Attributes:
        share: Of the networks' mean in each code. Shape (z,).
    """

    share: Tensor

    def __init__(self, layers: Mapping[str, Tensor]) -> None:
        """Take what was learnt.

        Args:
            layers: "share", and by layer from 0 "weight_0", "bias_0" and so on.
        """
        super().__init__()
        for name, value in layers.items():
            self.register_buffer(name, value)
        self._n_layers = (len(layers) - 1) // 2

    @property
    def layers(self) -> list[tuple[Tensor, Tensor]]:
        """Weights (e, i, o) and biases (e, 1, o), first to last."""
        return [
            (self.get_buffer(f"weight_{place}"), self.get_buffer(f"bias_{place}"))
            for place in range(self._n_layers)
        ]

    def each(self, theta: Tensor) -> Tensor:
        """What every network says of features (b, f) -> (e, b, z)."""
        return _forward(self.layers, theta)


def trained_networks(features: Tensor, codes: Tensor, seed: int) -> NetworkEnsemble:
    """Train networks from different first weights, by AdamW with one cycle of the learning rate.

    Codes count by their variance, as in the error of the trajectories. Heavy decay of the weights and depth
    keep the networks from learning few rows by heart.

    Args:
        features: Features of theta, of variance 1 or so. Shape (n, f). [1]
        codes: Principal coordinates. Shape (n, z). [1]
        seed: Of first weights and batches.

    Returns:
        The networks, with share 1 in every code.
    """
    scale = codes.square().mean().sqrt().clamp_min(torch.finfo(codes.dtype).tiny)
    with torch.enable_grad(), denormals_flushed():
        layers = _trained(features.float(), (codes / scale).float(), seed)
    buffers = {"share": torch.ones_like(codes[0])}
    for place, (weight, bias) in enumerate(layers):
        factor = scale if place == len(layers) - 1 else 1.0
        buffers[f"weight_{place}"] = weight.detach().to(codes.dtype) * factor
        buffers[f"bias_{place}"] = bias.detach().to(codes.dtype) * factor
    return NetworkEnsemble(buffers)


def _trained(x: Tensor, y: Tensor, seed: int) -> list[tuple[Tensor, Tensor]]:
    """Return the layers, in single precision: features (n, f), codes of variance 1 in all (n, z)."""
    n, generator = len(x), torch.Generator().manual_seed(seed)  # CPU: the same on every device
    deviation = y.square().mean(dim=0).sqrt().clamp_min(1e-12)  # (z,)
    sizes = [x.shape[1], *[WIDTH] * N_HIDDEN, y.shape[1]]
    layers = []
    for i, o in pairwise(sizes):
        weight = torch.randn(N_NETWORKS, i, o, generator=generator) / math.sqrt(i)
        layers.append((weight.to(x.device).requires_grad_(), x.new_zeros(N_NETWORKS, 1, o).requires_grad_()))
    weights = [weight for layer in layers for weight in layer]
    n_steps = max(STEPS, EPOCHS * n // BATCH_ROWS)
    optimizer = torch.optim.AdamW(
        weights, lr=_LEARNING_RATE, betas=(0.9, 0.99), weight_decay=_WEIGHT_DECAY, fused=True
    )
    size = min(BATCH_ROWS, n)
    batches: list[Tensor] = []
    for step in range(1, n_steps + 1):
        if not batches:
            order = torch.randperm(n, generator=generator).to(x.device)
            batches = [order[start : start + size] for start in range(0, n - size + 1, size)]
        rows = batches.pop()
        optimizer.param_groups[0]["lr"] = _LEARNING_RATE * _part_of_rate(step / n_steps)
        wrong = _forward(layers, x[rows]) * deviation - y[rows]
        optimizer.zero_grad(set_to_none=True)
        wrong.square().mean(dim=(1, 2)).sum().backward()  # type: ignore[no-untyped-call]
        optimizer.step()
    last_weight, last_bias = layers[-1]
    return [*layers[:-1], (last_weight * deviation, last_bias * deviation)]


def _forward(layers: list[tuple[Tensor, Tensor]], x: Tensor) -> Tensor:
    """Return what all networks say: (b, f) -> (e, b, z)."""
    x = x.expand(len(layers[0][0]), *x.shape)
    for weight, bias in layers[:-1]:
        x = nn.functional.silu(torch.baddbmm(bias, x, weight))
    return torch.baddbmm(layers[-1][1], x, layers[-1][0])


def _part_of_rate(progress: float) -> float:
    """Return the part of the peak learning rate: a cosine up, then a cosine down."""
    phase = 1.0 - progress / _WARM_UP if progress < _WARM_UP else (progress - _WARM_UP) / (1.0 - _WARM_UP)
    return 0.5 * (1.0 + math.cos(math.pi * phase))
