"""`fit` turns simulated trajectories into a surrogate, whatever its form."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from pelsvae.config import SurrogateConfig
from pelsvae.device import n_threads_set, resolve_device
from pelsvae.epochs import EpochReport
from pelsvae.linear_network.drive import Drive
from pelsvae.linear_vae import LinearVae
from pelsvae.metrics import errors
from pelsvae.network import LayersVae, PelsVae
from pelsvae.network_training import train_network
from pelsvae.process_fitting import fit_processes
from pelsvae.standardize import Array, OutputStandardizer, ThetaStandardizer
from pelsvae.state_space import StateSpaceVae, scaled_outputs
from pelsvae.state_space_training import train_state_space
from pelsvae.surrogate import Surrogate, draw_prediction_eps, require_positive


@dataclass(frozen=True)
class FitResult:
    """A trained surrogate and how it came about.

    Attributes:
        surrogate: With the weights of the best validated epoch; of the last one without a validation set.
        best_epoch: Epoch whose weights were kept, from 1.
        n_epochs: Epochs done.
        stop_reason: "max_epochs", "patience", or what `StopTraining` said; "fitted" for processes.
    """

    surrogate: Surrogate
    best_epoch: int
    n_epochs: int
    stop_reason: str


def fit(
    theta: npt.ArrayLike,
    y: npt.ArrayLike,
    validation: tuple[npt.ArrayLike, npt.ArrayLike] | None,
    *,
    config: SurrogateConfig,
    seed: int,
    log_columns: npt.ArrayLike | None = None,
    output_scales: Array | None = None,
    drive: Drive | None = None,
    on_epoch: Callable[[EpochReport], None] | None = None,
) -> FitResult:
    """Train a PELS-VAE by Eq. 5 and keep the weights with the smallest validation error.

    With regressor "gaussian-process" there are no epochs: a search for likely kernels is reported in parts of
    `max_epochs`, and the last report is of the surrogate itself.

    Args:
        theta: Training parameters. Shape (n, p). [per parameter]
        y: Training trajectories. Shape (n, t, k). [output's unit]
        validation: Parameters and trajectories that decide when to stop; None to train to the last epoch, and
            to choose kernels by each row's error where it is left out. Shapes (m, p), (m, t, k).
        config: Network and training.
        seed: Of initial weights, batches and draws; the same seed gives the same surrogate on a machine.
        log_columns: Parameters whose logarithm is a feature too, for theta_features "linear+log"; None
            means every column that is positive throughout. Shape (p,), bool.
        output_scales: Makes validation errors of different units comparable (see `metrics.errors`).
            Shape (k,).
        drive: The model's inputs, for decoder "state-space".
        on_epoch: Called after each validated epoch; what it raises ends the training and reaches the caller,
            but `StopTraining` of networks: these are returned with their best weights so far.

    Returns:
        The surrogate.

    Raises:
        ValueError: Shapes do not fit, values are not finite (drop failed rows first), or several rows
            that a process shall learn from have the same theta.
        TrainingDiverged: The loss or the validation error became NaN or infinite.
    """
    theta, y = _checked(theta, y, "training")
    judging = None if validation is None else _checked(*validation, "validation")
    if config.regressor == "gaussian-process" and len(theta) > 1 and (theta == theta[0]).all():
        raise ValueError(f"all {len(theta)} training rows have the same parameters; a process learns nothing")
    if judging is not None and (theta.shape[1:], y.shape[1:]) != tuple(one.shape[1:] for one in judging):
        raise ValueError(
            f"validation has shapes {judging[0].shape} and {judging[1].shape}, "
            f"which do not go with training's {theta.shape} and {y.shape}"
        )
    # Validation rows too, as they are predicted by the same logarithms.
    rows_of_all = theta if judging is None else np.concatenate([theta, judging[0]])
    log = _log_columns(log_columns, config, rows_of_all)
    theta_map, output_map = ThetaStandardizer.fit(theta, log), OutputStandardizer.fit(y)
    if config.regressor != "network" or config.decoder == "layers":
        drive = None
    elif drive is None:
        raise ValueError('decoder "state-space" needs the model\'s inputs: give drive')
    else:
        output_map = scaled_outputs(y, drive)
    # The network of states is solved by numba, on the CPU.
    device = resolve_device(config.device if drive is None else "cpu")

    def surrogate_of(network: PelsVae | LinearVae, eps: Tensor) -> Surrogate:
        return Surrogate(config, network, eps, theta_map, output_map)

    def validation_error(surrogate: Surrogate) -> float | None:
        if judging is None:
            return None
        return errors(surrogate.predict(judging[0]), judging[1], output_scales).mae

    def prepared(theta: Array, y: Array, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
        features = theta_map.features(torch.from_numpy(theta), dtype)  # (n, f)
        return features.to(device), torch.from_numpy(output_map.standardized(y)).to(device, dtype)  # (n, d)

    with n_threads_set(config.n_threads):
        if config.regressor == "network":
            generator = torch.Generator().manual_seed(seed)  # CPU: weights, batches; the same on every device
            network: LayersVae | StateSpaceVae
            if drive is not None:
                network = StateSpaceVae(theta_map, output_map, drive, config, generator)
            else:
                network = LayersVae(theta_map.n_features, y[0].size, config, generator).to(device)
            # After the weights: the order of draws is part of what a seed means.
            eps = draw_prediction_eps(config.n_prediction_samples, config.n_latent, generator).to(device)
            surrogate = surrogate_of(network, eps)
            how: dict[str, Any] = {
                "validation_error": lambda: validation_error(surrogate),
                "generator": generator,
                "on_epoch": on_epoch,
            }
            rows = prepared(theta, y, torch.float32)
            if isinstance(network, StateSpaceVae):
                best_epoch, n_epochs, stop_reason = train_state_space(network, config, *rows, **how)
            else:
                best_epoch, n_epochs, stop_reason = train_network(network, config, *rows, **how)
        else:
            made = fit_processes(
                config,
                # Double: in single precision errors were up to a third of the deviation at n = 1,024.
                prepared(theta, y, torch.float64),
                None if judging is None else prepared(*judging, torch.float64),
                validation_error=lambda network: validation_error(surrogate_of(network, network.no_draw)),
                seed=seed,
                on_epoch=on_epoch,
            )
            surrogate = surrogate_of(made, made.no_draw)
            best_epoch = n_epochs = config.max_epochs
            stop_reason = "fitted"
    surrogate.network.eval().requires_grad_(False)
    return FitResult(surrogate, best_epoch, n_epochs, stop_reason)


def _checked(theta: npt.ArrayLike, y: npt.ArrayLike, what: str) -> tuple[Array, Array]:
    """Return both as float64 arrays; ValueError where shapes do not fit or values are not finite."""
    theta, y = np.array(theta, dtype=np.float64), np.array(y, dtype=np.float64)
    if theta.ndim != 2 or y.ndim != 3 or len(theta) != len(y) or not theta.size or not y.size:
        raise ValueError(
            f"{what} needs theta (n, p) and y (n, t, k), not empty; got {theta.shape} and {y.shape}"
        )
    n_bad = int((~(np.isfinite(theta).all(axis=1) & np.isfinite(y).all(axis=(1, 2)))).sum())
    if n_bad:
        raise ValueError(f"{n_bad} of {len(y)} {what} rows are not finite; drop failed rows first")
    return theta, y


def _log_columns(asked: npt.ArrayLike | None, config: SurrogateConfig, theta: Array) -> npt.NDArray[np.bool_]:
    """Return which columns of all rows' theta get a logarithm. Shape (p,)."""
    if config.theta_features == "linear":
        return np.zeros(theta.shape[1], dtype=bool)
    if asked is None:
        positive: npt.NDArray[np.bool_] = theta.min(axis=0) > 0.0
        return positive
    log = np.array(asked)
    if log.dtype != np.bool_ or log.shape != (theta.shape[1],):
        raise ValueError(
            f"log_columns must be {theta.shape[1]} booleans, got shape {log.shape} of {log.dtype}"
        )
    require_positive(theta, np.flatnonzero(log))
    return log
