"""Trains an ensemble's networks side by side, by AdamW with one cycle of the learning rate.

Derivatives are written out, and values and derivatives lie in two flat tensors each: layers of this size
take no longer than what automatic differentiation and an update of every tensor alone add to them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property, partial
from itertools import pairwise
from typing import NamedTuple, Self

import torch
from torch import Tensor, nn

from pelsvae.adam import Adam
from pelsvae.device import denormals_flushed
from pelsvae.network_ensemble import NetworkEnsemble
from pelsvae.side_by_side import SideBySide

N_NETWORKS = 4
WIDTH = 96
N_HIDDEN = 8
STEPS = 300  # at least
EPOCHS = 225  # at least
BATCH_ROWS = 128
_AT_ONCE = 2  # networks on a thread, where there are several
_LEARNING_RATE = 8e-3
# By so much, as a logarithm, weights decay during the whole training if no gradient holds them; what many
# rows say needs less of it.
_DECAY = 1.8
_FEW_ROWS = 128  # up to which the decay is that; beyond it falls by the root of their number
_WARM_UP = 0.2  # part of the steps in which the learning rate rises
_VECTOR = 64  # values; an update of whole vectors is the same bits wherever a value lies


class NetworkTraining:
    """Networks from theta to the codes, which differ in their first weights; trained when begun or asked for.

    Codes count by their variance, as in the error of the trajectories. Decay of the weights and depth keep
    the networks from learning few rows by heart.
    """

    def __init__(self, features: Tensor, codes: Tensor, seed: int, threads: SideBySide) -> None:
        """Take what is learnt.

        Args:
            features: Features of theta, of variance 1 or so. Shape (n, f). [1]
            codes: Principal coordinates. Shape (n, z). [1]
            seed: Of first weights and batches.
            threads: Where it runs; however many there are, the networks are the same.
        """
        self._features, self._codes, self._seed, self._threads = features, codes, seed, threads
        self._scale = codes.square().mean().sqrt().clamp_min(torch.finfo(codes.dtype).tiny)
        self._begun: list[Callable[[], _Values]] = []

    def begin(self, n_parts: int) -> None:
        """Let so many threads begin with their part, where there are several.

        Args:
            n_parts: Together with those begun before; at most all.
        """
        for train in self._parts[len(self._begun) : n_parts]:
            self._begun.append(self._threads.later(train))

    @cached_property
    def _parts(self) -> list[Callable[[], _Values]]:
        x, y = self._features.float(), (self._codes / self._scale).float()
        generator = torch.Generator().manual_seed(self._seed)  # CPU: the same on every device
        sizes = [x.shape[1], *[WIDTH] * N_HIDDEN, y.shape[1]]
        weights = [
            torch.randn(N_NETWORKS, i, o, generator=generator) / math.sqrt(i) for i, o in pairwise(sizes)
        ]
        n_at_once = _AT_ONCE if self._threads.are_several else N_NETWORKS
        parts: list[Callable[[], _Values]] = []
        for start in range(0, N_NETWORKS, n_at_once):
            first = [weight[start : start + n_at_once].to(x.device) for weight in weights]
            batches = torch.Generator()
            batches.set_state(generator.get_state())
            parts.append(partial(_trained, x, y, first, batches, self._threads.check))
        return parts

    def result(self) -> NetworkEnsemble:
        """Return the networks, in single precision, with share 1 in every code, in the codes'."""
        self.begin(len(self._parts))
        parts = [part() for part in self._begun]
        scale = self._scale.float()
        weights = [torch.cat(of_layer) for of_layer in zip(*(part.weights for part in parts), strict=True)]
        biases = [torch.cat(of_layer) for of_layer in zip(*(part.biases for part in parts), strict=True)]
        weights[-1], biases[-1] = weights[-1] * scale, biases[-1] * scale
        layers = {f"weight_{place}": weight for place, weight in enumerate(weights)}
        layers |= {f"bias_{place}": bias for place, bias in enumerate(biases)}
        return NetworkEnsemble(
            {
                "share": torch.ones_like(self._codes[0]),
                "power": torch.cat([part.power for part in parts]),
                "origin": torch.cat([part.origin for part in parts]) * scale,
                **layers,
            }
        )


class _Values(NamedTuple):
    """What e networks learn, or its derivatives: views of two flat tensors, of what decays and what does not.

    Attributes:
        flat: The two.
        weights: Of the layers. Shapes (e, i, o).
        biases: Shapes (e, 1, o).
        power: A feature's. Shape (e, f, 1).
        origin: Shape (e, 1, z).
    """

    flat: tuple[Tensor, Tensor]
    weights: list[Tensor]
    biases: list[Tensor]
    power: Tensor
    origin: Tensor

    @classmethod
    def zeros(cls, weights: list[Tensor]) -> Self:
        """Return zeros for layers with weights of these shapes."""
        e, f, z, n = len(weights[0]), weights[0].shape[1], weights[-1].shape[2], len(weights)
        shapes = [tuple(weight.shape) for weight in weights] + [(e, 1, weight.shape[2]) for weight in weights]
        decaying, layers = _views(shapes, weights[0])
        others, (power, origin) = _views([(e, f, 1), (e, 1, z)], weights[0])
        return cls((decaying, others), layers[:n], layers[n:], power, origin)


def _views(shapes: list[tuple[int, ...]], like: Tensor) -> tuple[Tensor, list[Tensor]]:
    """Return a flat tensor of zeros, and views of it in these shapes."""
    sizes = [math.prod(shape) for shape in shapes]
    flat = like.new_zeros(_VECTOR * math.ceil(sum(sizes) / _VECTOR))
    parts = torch.split(flat[: sum(sizes)], sizes)
    return flat, [part.view(shape) for part, shape in zip(parts, shapes, strict=True)]


def _trained(
    x: Tensor, y: Tensor, first: list[Tensor], generator: torch.Generator, check: Callable[[], None]
) -> _Values:
    """Return what e networks learnt, in single precision.

    Args:
        x: Features. Shape (n, f).
        y: Codes, of variance 1 in all. Shape (n, z).
        first: Weights. Shapes (e, i, o).
        generator: Of the batches; the same for all networks.
        check: Called at every step; what it raises ends the training.
    """
    n = len(x)
    deviation = y.square().mean(dim=0).sqrt().clamp_min(1e-12)  # (z,)
    learnt, slopes = _Values.zeros(first), _Values.zeros(first)
    for weight, value in zip(learnt.weights, first, strict=True):
        weight.copy_(value)
    for flat, slope in zip(learnt.flat, slopes.flat, strict=True):
        flat.grad = slope
    size = min(BATCH_ROWS, n)
    n_steps = max(STEPS, EPOCHS * n // BATCH_ROWS)
    decay = _DECAY * min(1.0, math.sqrt(_FEW_ROWS / n)) / (0.5 * _LEARNING_RATE * n_steps)
    optimizers = [
        Adam([flat], betas=(0.9, 0.99), decay=of_part)
        for flat, of_part in zip(learnt.flat, (decay, 0.0), strict=True)
    ]
    batches: list[Tensor] = []
    with torch.no_grad(), denormals_flushed():
        for step in range(1, n_steps + 1):
            check()
            if not batches:
                order = torch.randperm(n, generator=generator).to(x.device)
                batches = [order[start : start + size] for start in range(0, n - size + 1, size)]
            rows = batches.pop()
            _differentiate(learnt, slopes, x[rows], y[rows], deviation)
            for optimizer in optimizers:
                optimizer.step(_LEARNING_RATE * _part_of_rate(step / n_steps))
        learnt.weights[-1].mul_(deviation)
        learnt.biases[-1].mul_(deviation)
        learnt.origin.mul_(deviation)
    return learnt


def _differentiate(learnt: _Values, slopes: _Values, x: Tensor, y: Tensor, deviation: Tensor) -> None:
    """Write the derivatives of each network's mean squared error.

    Args:
        learnt: What e networks are; their codes are in units of the deviations.
        slopes: Where to write.
        x: Features. Shape (b, f).
        y: Codes. Shape (b, z).
        deviation: Of the codes. Shape (z,).
    """
    x = x.expand(len(learnt.power), *x.shape)
    factor = torch.exp(x @ learnt.power)  # (e, b, 1)
    sums, inputs = [], [x]
    for weight, bias in zip(learnt.weights[:-1], learnt.biases[:-1], strict=True):
        sums.append(torch.baddbmm(bias, inputs[-1], weight))
        inputs.append(nn.functional.silu(sums[-1]))
    said = torch.baddbmm(learnt.biases[-1], inputs[-1], learnt.weights[-1])  # (e, b, z)

    wrong = (factor * said + learnt.origin) * deviation - y
    slope = wrong.mul_(2.0 / y.numel()).mul_(deviation)
    torch.sum(slope, 1, keepdim=True, out=slopes.origin)
    by_factor = (slope * said).sum(dim=2, keepdim=True)
    torch.bmm(x.transpose(1, 2), by_factor * factor, out=slopes.power)
    slope = factor * slope
    for place in reversed(range(len(learnt.weights))):
        torch.sum(slope, 1, keepdim=True, out=slopes.biases[place])
        torch.bmm(inputs[place].transpose(1, 2), slope, out=slopes.weights[place])
        if place:
            by_input = torch.bmm(slope, learnt.weights[place].transpose(1, 2))
            slope = torch.ops.aten.silu_backward(by_input, sums[place - 1])


def _part_of_rate(progress: float) -> float:
    """Return the part of the peak learning rate: a cosine up, then a cosine down."""
    phase = 1.0 - progress / _WARM_UP if progress < _WARM_UP else (progress - _WARM_UP) / (1.0 - _WARM_UP)
    return 0.5 * (1.0 + math.cos(math.pi * phase))
