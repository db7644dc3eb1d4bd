"""Principal coordinates and dense networks: one, and an ensemble (torch)."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from simulation.arrays import FloatArray
from surrogate_rivals.coordinates import Z_90, Clock, Features, Fitted, Principal
from surrogate_rivals.problems import Data

N_TRIED = 12  # settings, drawn at random, four of one shape at once
N_AT_ONCE = 4
SEARCH_STEPS, STEPS, ENSEMBLE_STEPS = 300, 3000, 1500
N_MEMBERS = 5
BATCH_ROWS = 256
N_VALIDATIONS = 40
WARM_UP = 0.2


@dataclass(frozen=True)
class _Settings:
    """Networks of one shape that are trained at once, side by side.

    Attributes:
        width: Of the hidden layers.
        n_hidden: Hidden layers.
        evenness: Power of its deviation by which a coordinate's error is divided: 0 weighs by variance.
        rates: Peak learning rate of each network.
        decays: Decoupled weight decay of each network, in parts of its rate.
    """

    width: int
    n_hidden: int
    evenness: float
    rates: tuple[float, ...]
    decays: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class _Trained:
    """Networks with the weights of their best validation.

    Attributes:
        layers: Weights (m, i, o) and biases (m, 1, o), layer by layer.
        mae: Validation error of each network. Shape (m,).
    """

    layers: list[tuple[Tensor, Tensor]]
    mae: Tensor

    def __call__(self, x: Tensor) -> Tensor:
        """Predict standardized coordinates (n, q). Shape (m, n, q)."""
        return _forward(self.layers, x.expand(len(self.mae), *x.shape))


@dataclass(frozen=True, eq=False)
class _Task:
    """Training and validation set in standardized coordinates, float32."""

    x: Tensor
    z: Tensor
    x_validation: Tensor
    z_validation: Tensor
    deviation: Tensor


def network(data: Data, seed: int) -> Fitted:
    """Choose shape, rate and decay among twelve random settings by the validation set, then train longer."""
    task, chosen, rows, principal = _searched(data, seed)
    clock = Clock()
    trained = _train(task, chosen, STEPS, seed)
    fit_s = clock.s

    def predict(theta: FloatArray) -> FloatArray:
        with torch.inference_mode():
            z = trained(rows(theta))[0] * task.deviation
        return principal.outputs(z.double().numpy())

    return Fitted(predict, fit_s, _said(chosen))


def ensemble(data: Data, seed: int) -> Fitted:
    """Train five networks of the best settings from different weights; their mean and their spread.

    The band is the spread times what makes it cover 90 % of the validation set.
    """
    task, chosen, rows, principal = _searched(data, seed)
    clock = Clock()
    many = replace(chosen, rates=chosen.rates * N_MEMBERS, decays=chosen.decays * N_MEMBERS)
    trained = _train(task, many, ENSEMBLE_STEPS, seed)
    fit_s = clock.s

    def members(theta: FloatArray) -> FloatArray:
        with torch.inference_mode():
            z = trained(rows(theta)) * task.deviation
        return np.stack([principal.outputs(one) for one in z.double().numpy()])

    def predict(theta: FloatArray) -> FloatArray:
        with torch.inference_mode():
            z = trained(rows(theta)).mean(dim=0) * task.deviation
        return principal.outputs(z.double().numpy())

    spread = members(data.validation[0]).std(axis=0, ddof=1) + 1e-12
    ratio = np.abs(predict(data.validation[0]) - data.validation[1]) / spread
    factor = float(np.quantile(ratio, 0.9)) / Z_90

    def deviation(theta: FloatArray) -> FloatArray:
        return np.asarray(factor * members(theta).std(axis=0, ddof=1))

    return Fitted(predict, fit_s, _said(chosen), deviation)


def _said(chosen: _Settings) -> str:
    return (
        f"{chosen.n_hidden} x {chosen.width}, evenness {chosen.evenness:g}, rate {chosen.rates[0]:.1e}, "
        f"decay {chosen.decays[0]:.1e}"
    )


def _searched(data: Data, seed: int) -> tuple[_Task, _Settings, "_Rows", Principal]:
    """Return the task, the best settings and what turns parameters into rows of features."""
    principal = Principal.of(data)
    z, z_validation = principal.coordinates(data.y), principal.coordinates(data.validation[1])
    rows = _Rows(Features.of(data.space))
    deviation = z.std(axis=0) + 1e-12
    task = _Task(
        rows(data.theta),
        torch.from_numpy(z / deviation).float(),
        rows(data.validation[0]),
        torch.from_numpy(z_validation / deviation).float(),
        torch.from_numpy(deviation).float(),
    )
    rng = np.random.default_rng([11, seed])
    found: list[tuple[float, _Settings]] = []
    for shape in ((128, 2), (128, 3), (256, 2))[: N_TRIED // N_AT_ONCE]:
        tried = _Settings(
            *shape,
            evenness=float(rng.choice([0.0, 0.5])),
            rates=tuple(10.0 ** rng.uniform(-3.0, -1.7, N_AT_ONCE)),
            decays=tuple(10.0 ** rng.uniform(-3.0, 0.3, N_AT_ONCE)),
        )
        trained = _train(task, tried, SEARCH_STEPS, seed)
        for mae, rate, decay in zip(trained.mae.tolist(), tried.rates, tried.decays, strict=True):
            found.append((mae, replace(tried, rates=(rate,), decays=(decay,))))
    return task, min(found, key=lambda one: one[0])[1], rows, principal


@dataclass(frozen=True)
class _Rows:
    """Turns parameters into what networks see: both kinds of features, of variance 1 or so."""

    features: Features

    def __call__(self, theta: FloatArray) -> Tensor:
        return torch.from_numpy(self.features.both(theta) * math.sqrt(12.0)).float()


def _forward(layers: list[tuple[Tensor, Tensor]], x: Tensor) -> Tensor:
    for weight, bias in layers[:-1]:
        x = torch.nn.functional.silu(torch.baddbmm(bias, x, weight))
    return torch.baddbmm(layers[-1][1], x, layers[-1][0])


def _train(task: _Task, settings: _Settings, steps: int, seed: int) -> _Trained:
    """Train networks side by side by AdamW with a rise and fall of the rate; keep each one's best weights."""
    m, n = len(settings.rates), len(task.x)
    generator = torch.Generator().manual_seed(seed)
    sizes = [task.x.shape[1], *[settings.width] * settings.n_hidden, task.z.shape[1]]
    layers = [
        (
            (torch.randn(m, i, o, generator=generator) / math.sqrt(i)).requires_grad_(),
            torch.zeros(m, 1, o, requires_grad=True),
        )
        for i, o in pairwise(sizes)
    ]
    weights = [weight for layer in layers for weight in layer]
    first, second = [torch.zeros_like(w) for w in weights], [torch.zeros_like(w) for w in weights]
    rates = torch.tensor(settings.rates)[:, None, None]
    decays = torch.tensor(settings.decays)[:, None, None]
    importance = task.deviation ** (1.0 - settings.evenness)
    importance = importance / importance.square().mean().sqrt()
    kept = _Trained([(w.detach().clone(), b.detach().clone()) for w, b in layers], torch.full((m,), math.inf))
    size, order, place = min(BATCH_ROWS, n), torch.randperm(n, generator=generator), 0
    for step in range(1, steps + 1):
        if place + size > n:
            order, place = torch.randperm(n, generator=generator), 0
        rows = order[place : place + size] if size < n else slice(None)
        place += size
        x, z = task.x[rows], task.z[rows]
        wrong = (_forward(layers, x.expand(m, *x.shape)) - z) * importance
        gradients = torch.autograd.grad(wrong.square().mean(dim=(1, 2)).sum(), weights)
        rate = rates * _schedule(step / steps)
        with torch.no_grad():
            for weight, gradient, mean, square in zip(weights, gradients, first, second, strict=True):
                mean.lerp_(gradient, 0.1)
                square.mul_(0.99).addcmul_(gradient, gradient, value=0.01)
                weight.mul_(1.0 - rate * decays)
                size_of = (square / (1.0 - 0.99**step)).sqrt_().add_(1e-8)
                weight.sub_(rate * mean / (1.0 - 0.9**step) / size_of)
            if step % max(1, steps // N_VALIDATIONS) == 0:
                _keep_best(kept, layers, task)
    return kept


def _schedule(progress: float) -> float:
    """Return the part of the peak rate: a cosine up, then a cosine down."""
    phase = 1.0 - progress / WARM_UP if progress < WARM_UP else (progress - WARM_UP) / (1.0 - WARM_UP)
    return 0.5 * (1.0 + math.cos(math.pi * phase))


def _keep_best(kept: _Trained, layers: list[tuple[Tensor, Tensor]], task: _Task) -> None:
    """Copy the weights of networks that are better than before."""
    predicted = _forward(layers, task.x_validation.expand(len(kept.mae), *task.x_validation.shape))
    wrong = (predicted - task.z_validation) * task.deviation
    mae = wrong.square().sum(dim=2).sqrt().mean(dim=1)
    better = mae < kept.mae
    kept.mae[better] = mae[better]
    for (weight, bias), (best_weight, best_bias) in zip(layers, kept.layers, strict=True):
        best_weight[better], best_bias[better] = weight[better], bias[better]
