"""A few networks from theta to the principal coordinates, trained side by side: one more candidate.

Where trajectories shift in time, coordinates turn over and over along a parameter, and stationary bumps need
many rows for every turn; layers need fewer. What they say is multiplied by powers of the parameters, because
the size of trajectories often is one, and layers can only add.
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
N_HIDDEN = 8
STEPS = 300  # at least
EPOCHS = 225  # at least
BATCH_ROWS = 128
_LEARNING_RATE = 8e-3
# By so much, as a logarithm, weights decay during the whole training if no gradient holds them; what many
# rows say needs less of it.
_DECAY = 1.8
_FEW_ROWS = 128  # up to which the decay is that; beyond it falls by the root of their number
_WARM_UP = 0.2  # part of the steps in which the learning rate rises


class NetworkEnsemble(nn.Module):
    """Layers with a leading dimension of e networks; computes in the precision of its layers.

    Shapes: b rows, f features of theta, z latent, e networks, layers of i inputs and o outputs.

    Attributes:
        share: Of the networks' mean in each code. Shape (z,).
        power: A feature's, in the factor of what the layers say. Shape (e, f, 1).
        origin: Codes where that factor is zero. Shape (e, 1, z).
    """

    share: Tensor
    power: Tensor
    origin: Tensor

    def __init__(self, layers: Mapping[str, Tensor]) -> None:
        """Take what was learnt.

        Args:
            layers: "share", "power", "origin", and by layer from 0 "weight_0", "bias_0" and so on.

        Raises:
            KeyError: One of the first three is missing.
        """
        super().__init__()
        others = ("share", "power", "origin")
        for name in (*others, *(name for name in layers if name not in others)):
            self.register_buffer(name, layers[name])
        self._n_layers = (len(layers) - len(others)) // 2

    @property
    def layers(self) -> list[tuple[Tensor, Tensor]]:
        """Weights (e, i, o) and biases (e, 1, o), first to last."""
        return [
            (self.get_buffer(f"weight_{place}"), self.get_buffer(f"bias_{place}"))
            for place in range(self._n_layers)
        ]

    def each(self, theta: Tensor) -> Tensor:
        """What every network says of features (b, f) -> (e, b, z), computed in the layers' precision."""
        said = _forward(self.layers, self.power, theta.to(self.power.dtype)) + self.origin
        return said.to(theta.dtype)


def trained_networks(features: Tensor, codes: Tensor, seed: int) -> NetworkEnsemble:
    """Train networks from different first weights, by AdamW with one cycle of the learning rate.

    Codes count by their variance, as in the error of the trajectories. Decay of the weights and depth keep
    the networks from learning few rows by heart.

    Args:
        features: Features of theta, of variance 1 or so. Shape (n, f). [1]
        codes: Principal coordinates. Shape (n, z). [1]
        seed: Of first weights and batches.

    Returns:
        The networks, in single precision, with share 1 in every code, in the codes'.
    """
    scale = codes.square().mean().sqrt().clamp_min(torch.finfo(codes.dtype).tiny)
    with torch.enable_grad(), denormals_flushed():
        layers, power, origin = _trained(features.float(), (codes / scale).float(), seed)
    scale = scale.float()
    buffers = {"share": torch.ones_like(codes[0]), "power": power, "origin": origin * scale}
    for place, (weight, bias) in enumerate(layers):
        factor = scale if place == len(layers) - 1 else 1.0
        buffers[f"weight_{place}"], buffers[f"bias_{place}"] = weight * factor, bias * factor
    return NetworkEnsemble({name: value.detach() for name, value in buffers.items()})


def _trained(x: Tensor, y: Tensor, seed: int) -> tuple[list[tuple[Tensor, Tensor]], Tensor, Tensor]:
    """Return layers, powers and origin, in single precision.

    Args:
        x: Features. Shape (n, f).
        y: Codes, of variance 1 in all. Shape (n, z).
        seed: As above.
    """
    n, generator = len(x), torch.Generator().manual_seed(seed)  # CPU: the same on every device
    deviation = y.square().mean(dim=0).sqrt().clamp_min(1e-12)  # (z,)
    sizes = [x.shape[1], *[WIDTH] * N_HIDDEN, y.shape[1]]
    layers = []
    for i, o in pairwise(sizes):
        weight = torch.randn(N_NETWORKS, i, o, generator=generator) / math.sqrt(i)
        layers.append((weight.to(x.device).requires_grad_(), x.new_zeros(N_NETWORKS, 1, o).requires_grad_()))
    power = x.new_zeros(N_NETWORKS, x.shape[1], 1).requires_grad_()
    origin = x.new_zeros(N_NETWORKS, 1, y.shape[1]).requires_grad_()
    size = min(BATCH_ROWS, n)
    n_steps = max(STEPS, EPOCHS * n // BATCH_ROWS)
    decay = _DECAY * min(1.0, math.sqrt(_FEW_ROWS / n)) / (0.5 * _LEARNING_RATE * n_steps)
    optimizer = torch.optim.AdamW(
        [
            {"params": [weight for layer in layers for weight in layer], "weight_decay": decay},
            {"params": [power, origin], "weight_decay": 0.0},
        ],
        lr=_LEARNING_RATE,
        betas=(0.9, 0.99),
        fused=True,
    )
    batches: list[Tensor] = []
    for step in range(1, n_steps + 1):
        if not batches:
            order = torch.randperm(n, generator=generator).to(x.device)
            batches = [order[start : start + size] for start in range(0, n - size + 1, size)]
        rows = batches.pop()
        for group in optimizer.param_groups:
            group["lr"] = _LEARNING_RATE * _part_of_rate(step / n_steps)
        wrong = (_forward(layers, power, x[rows]) + origin) * deviation - y[rows]
        optimizer.zero_grad(set_to_none=True)
        wrong.square().mean(dim=(1, 2)).sum().backward()  # type: ignore[no-untyped-call]
        optimizer.step()
    last_weight, last_bias = layers[-1]
    return [*layers[:-1], (last_weight * deviation, last_bias * deviation)], power, origin * deviation


def _forward(layers: list[tuple[Tensor, Tensor]], power: Tensor, x: Tensor) -> Tensor:
    """Return what all networks say but for their origin: (b, f) -> (e, b, z)."""
    x = x.expand(len(power), *x.shape)
    factor = torch.exp(x @ power)  # (e, b, 1)
    for weight, bias in layers[:-1]:
        x = nn.functional.silu(torch.baddbmm(bias, x, weight))
    return factor * torch.baddbmm(layers[-1][1], x, layers[-1][0])


def _part_of_rate(progress: float) -> float:
    """Return the part of the peak learning rate: a cosine up, then a cosine down."""
    phase = 1.0 - progress / _WARM_UP if progress < _WARM_UP else (progress - _WARM_UP) / (1.0 - _WARM_UP)
    return 0.5 * (1.0 + math.cos(math.pi * phase))
