"""The whole training loop: `fit` turns simulated trajectories into a surrogate."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pelsvae.config import SurrogateConfig
from pelsvae.device import denormals_flushed, n_threads_set, resolve_device
from pelsvae.loss import objective
from pelsvae.metrics import errors
from pelsvae.network import PelsVae
from pelsvae.standardize import Array, OutputStandardizer, ThetaStandardizer
from pelsvae.surrogate import Surrogate, SurrogateShape, draw_prediction_eps, require_positive

HISTORY_KEYS = (
    "epoch",
    "loss",
    "kl",
    "reconstruction",
    "regression_mean",
    "regression_scale",
    "validation_mae",
)
_WARM_UP = 0.2  # part of a one-cycle schedule in which the learning rate rises
_START = 0.04  # of the peak learning rate, where one-cycle begins
_END = 1e-3  # of the peak learning rate, where one-cycle ends


class TrainingDiverged(RuntimeError):  # noqa: N818 - an outcome to expect, like a pruned trial
    """The loss or the validation error is no longer a finite number."""


@dataclass(frozen=True)
class EpochReport:
    """What a caller learns after each validated epoch.

    Attributes:
        epoch: Epochs done, from 1.
        max_epochs: Epochs at most.
        train_loss: Eq. 5, mean over the epoch's batches. [1]
        validation_mae: Mean absolute error on the validation set. [output's unit]
    """

    epoch: int
    max_epochs: int
    train_loss: float
    validation_mae: float


@dataclass(frozen=True)
class FitResult:
    """A trained surrogate and how it came about.

    Attributes:
        surrogate: With the weights of the best validated epoch.
        history: One value per validated epoch, by HISTORY_KEYS. Each of shape (number of validations,).
        best_epoch: Epoch whose weights were kept, from 1.
        n_epochs: Epochs done.
        stop_reason: "max_epochs" or "patience".
        wall_s: Wall time of the training.
    """

    surrogate: Surrogate
    history: dict[str, npt.NDArray[np.float64]]
    best_epoch: int
    n_epochs: int
    stop_reason: str
    wall_s: float


def fit(
    theta: npt.ArrayLike,
    y: npt.ArrayLike,
    validation: tuple[npt.ArrayLike, npt.ArrayLike],
    *,
    config: SurrogateConfig,
    seed: int,
    log_columns: npt.ArrayLike | None = None,
    output_scales: Array | None = None,
    on_epoch: Callable[[EpochReport], None] | None = None,
) -> FitResult:
    """Train a PELS-VAE by Eq. 5 and keep the weights with the smallest validation error.

    Args:
        theta: Training parameters. Shape (n, p). [per parameter]
        y: Training trajectories. Shape (n, t, k). [output's unit]
        validation: Parameters and trajectories that decide when to stop. Shapes (m, p), (m, t, k).
        config: Network and training.
        seed: Of initial weights, batches and draws; the same seed gives the same surrogate on a machine.
        log_columns: Parameters whose logarithm is a feature too, for theta_features "linear+log"; None
            means every column that is positive throughout. Shape (p,), bool.
        output_scales: Makes validation errors of different units comparable (see `metrics.errors`).
            Shape (k,).
        on_epoch: Called after each validated epoch; what it raises ends the training and reaches the caller.

    Returns:
        The surrogate and its history.

    Raises:
        ValueError: Shapes do not fit, or there are values that are not finite (drop failed rows first).
        TrainingDiverged: The loss or the validation error became NaN or infinite.
    """
    started = time.perf_counter()
    theta, y = _checked(theta, y, "training")
    theta_validation, y_validation = _checked(*validation, "validation")
    if theta.shape[1:] != theta_validation.shape[1:] or y.shape[1:] != y_validation.shape[1:]:
        raise ValueError(
            f"validation has shapes {theta_validation.shape} and {y_validation.shape}, "
            f"which do not go with training's {theta.shape} and {y.shape}"
        )
    log = _log_columns(log_columns, config, theta, theta_validation)
    theta_map, output_map = ThetaStandardizer.fit(theta, log), OutputStandardizer.fit(y)
    device = resolve_device(config.device)
    generator = torch.Generator().manual_seed(seed)  # CPU: weights, batches; the same on every device
    network = PelsVae(theta_map.n_features, y[0].size, config, generator).to(device)
    surrogate = Surrogate(
        config=config,
        shape=SurrogateShape(theta.shape[1], y.shape[1], y.shape[2]),
        network=network,
        eps=draw_prediction_eps(config.n_prediction_samples, config.n_latent, generator).to(device),
        theta_standardizer=theta_map,
        output_standardizer=output_map,
    )
    features = theta_map.features(torch.from_numpy(theta), torch.float32).to(device)  # (n, f)
    x = torch.from_numpy(output_map.standardized(y)).to(device, torch.float32)  # (n, d)
    with n_threads_set(config.n_threads), denormals_flushed():
        history, best_epoch, stop_reason = _train(
            surrogate,
            features,
            x,
            validation_error=lambda: (
                errors(surrogate.predict(theta_validation), y_validation, output_scales).mae
            ),
            generator=generator,
            on_epoch=on_epoch,
        )
    network.eval().requires_grad_(False)
    return FitResult(
        surrogate=surrogate,
        history={
            key: np.array(column)
            for key, column in zip(HISTORY_KEYS, zip(*history, strict=True), strict=True)
        },
        best_epoch=best_epoch,
        n_epochs=int(history[-1][0]),
        stop_reason=stop_reason,
        wall_s=time.perf_counter() - started,
    )


def _train(
    surrogate: Surrogate,
    theta: Tensor,  # (n, f)
    x: Tensor,  # (n, d)
    *,
    validation_error: Callable[[], float],
    generator: torch.Generator,
    on_epoch: Callable[[EpochReport], None] | None,
) -> tuple[list[tuple[float, ...]], int, str]:
    """Train the surrogate's network in place; return history rows, best epoch and stop reason."""
    config, network, n = surrogate.config, surrogate.network, len(x)
    size = min(config.batch_size, n)
    starts = range(0, n, size)
    noise = torch.Generator(x.device).manual_seed(generator.initial_seed())
    optimizer = _optimizer(network, config)
    weights: list[Tensor] = list(network.parameters())
    best = [weight.detach().clone() for weight in weights]
    best_mae, best_epoch, step, n_steps = math.inf, 0, 0, config.max_epochs * len(starts)
    history: list[tuple[float, ...]] = []
    for epoch in range(1, config.max_epochs + 1):
        order = torch.randperm(n, generator=generator).to(x.device) if size < n else None
        sums = torch.zeros(5, device=x.device)
        for start in starts:
            rows = slice(None) if order is None else order[start : start + size]
            x_batch, theta_batch = x[rows], theta[rows]  # (b, d), (b, f)
            eps = torch.randn(
                config.n_latent_samples, len(x_batch), config.n_latent, generator=noise, device=x.device
            )  # (L, b, z)
            optimizer.param_groups[0]["lr"] = _learning_rate(config, step / n_steps)
            terms = objective(
                network, x_batch, theta_batch, eps=eps, beta=config.beta, detach_encoder=config.detach_encoder
            )
            optimizer.zero_grad(set_to_none=True)
            terms.total.backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            step += 1
            if epoch % config.validate_every == 0 or epoch == config.max_epochs:
                sums += torch.stack(terms).detach() * (len(x_batch) / n)
        if epoch % config.validate_every and epoch != config.max_epochs:
            continue
        mae = validation_error()
        row = (float(epoch), *sums.tolist(), mae)
        if not all(map(math.isfinite, row)):
            raise TrainingDiverged(
                f"loss {row[1]:g}, validation error {mae:g} at epoch {epoch}; lower learning_rate or beta"
            )
        history.append(row)
        if mae < best_mae:
            best_mae, best_epoch = mae, epoch
            with torch.no_grad():
                torch._foreach_copy_(best, weights)
        if on_epoch is not None:
            on_epoch(EpochReport(epoch, config.max_epochs, row[1], mae))
        if epoch - best_epoch >= config.patience:
            break
    with torch.no_grad():
        torch._foreach_copy_(weights, best)
    return history, best_epoch, "max_epochs" if epoch == config.max_epochs else "patience"


def _optimizer(network: PelsVae, config: SurrogateConfig) -> torch.optim.Optimizer:
    """Return the update rule; fused, because at these sizes its overhead is a third of an epoch."""
    if config.optimizer == "adamw":
        # Where the latent code has settled on the prior its gradients vanish, and with Adam's usual memory of
        # a thousand steps the first larger one is a leap: seen as spikes of the loss, and once as NaN.
        return torch.optim.AdamW(
            network.parameters(),
            lr=config.learning_rate,
            betas=(0.9, 0.99),
            weight_decay=config.weight_decay,
            fused=True,
        )
    return torch.optim.Adam(network.parameters(), lr=config.learning_rate, fused=True)


def _learning_rate(config: SurrogateConfig, progress: float) -> float:
    """Return the learning rate at a progress in [0, 1); one-cycle is a cosine up, then a cosine down."""
    if config.schedule == "constant":
        return config.learning_rate
    if progress < _WARM_UP:
        low, phase = _START, 1.0 - progress / _WARM_UP
    else:
        low, phase = _END, (progress - _WARM_UP) / (1.0 - _WARM_UP)
    return config.learning_rate * (low + (1.0 - low) * 0.5 * (1.0 + math.cos(math.pi * phase)))


def _checked(theta: npt.ArrayLike, y: npt.ArrayLike, what: str) -> tuple[Array, Array]:
    """Return both as float64 arrays, or say what is wrong with them."""
    theta, y = np.array(theta, dtype=np.float64), np.array(y, dtype=np.float64)
    if theta.ndim != 2 or y.ndim != 3 or len(theta) != len(y) or not theta.size or not y.size:
        raise ValueError(
            f"{what} needs theta (n, p) and y (n, t, k), not empty; got {theta.shape} and {y.shape}"
        )
    n_bad = int((~(np.isfinite(theta).all(axis=1) & np.isfinite(y).all(axis=(1, 2)))).sum())
    if n_bad:
        raise ValueError(f"{n_bad} of {len(y)} {what} rows are not finite; drop failed rows first")
    return theta, y


def _log_columns(
    asked: npt.ArrayLike | None, config: SurrogateConfig, theta: Array, theta_validation: Array
) -> npt.NDArray[np.bool_]:
    """Return which columns of theta get a logarithm. Shape (p,)."""
    if config.theta_features == "linear":
        return np.zeros(theta.shape[1], dtype=bool)
    if asked is None:
        positive: npt.NDArray[np.bool_] = np.concatenate([theta, theta_validation]).min(axis=0) > 0.0
        return positive
    log = np.array(asked)
    if log.dtype != np.bool_ or log.shape != (theta.shape[1],):
        raise ValueError(
            f"log_columns must be {theta.shape[1]} booleans, got shape {log.shape} of {log.dtype}"
        )
    for rows in (theta, theta_validation):
        require_positive(rows, np.flatnonzero(log))
    return log
