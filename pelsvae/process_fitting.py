"""Fits the linear form: principal components, likely kernels, and a mean of those that prove their worth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import Tensor

from pelsvae.config import SurrogateConfig
from pelsvae.epochs import EpochReport, TrainingDiverged
from pelsvae.kernel import Kernel
from pelsvae.kernel_search import Candidate, candidates
from pelsvae.linear_vae import LinearVae
from pelsvae.member_shares import best_shares
from pelsvae.standardize import Array

MEMBER_ROWS = 4096  # members times rows at most: what a prediction costs
CHOOSING_ROWS = 1024  # from so many rows at most it is chosen which kernels are members
_LEFT_OUT = 1e-5  # part of the variance outside the basis
_SHARE = 0.9  # of the validation values that the band shall cover


def fit_processes(
    config: SurrogateConfig,
    training: tuple[Tensor, Tensor],
    validation: tuple[Tensor, Tensor],
    *,
    n_outputs: int,
    validation_error: Callable[[LinearVae], float],
    seed: int,
    on_epoch: Callable[[EpochReport], None] | None,
) -> tuple[LinearVae, list[dict[str, float]]]:
    """Fit principal components and the Gaussian processes of their coordinates.

    Many kernels are searched for, on few rows first; the validation set says what each counts in each code.

    Args:
        config: Scales, degree, members and iterations.
        training: Features of theta, in random order, and standardized trajectories, float64. Shapes (n, f)
            and (n, d). [1]
        validation: As training, of rows that say what each kernel's process is worth and how far the stated
            deviations are right. Shapes (b, f) and (b, d). [1]
        n_outputs: Outputs k of a model; d is times x k.
        validation_error: Judges a network.
        seed: Of the searches' starts.
        on_epoch: Told of searches, in parts of `max_epochs`, and last of what is returned.

    Returns:
        The network, and what was last reported, by name: the searches' errors are of a part of the rows.

    Raises:
        TrainingDiverged: The loss or the validation error became NaN or infinite.
    """
    features, x = training
    history: list[dict[str, float]] = []

    def report(network: LinearVae, loss: float, epoch: int) -> None:
        mae = validation_error(network)
        if not math.isfinite(loss + mae):
            raise TrainingDiverged(f"loss {loss:g}, validation error {mae:g} at epoch {epoch}")
        history.append({"epoch": float(epoch), "loss": loss, "validation_mae": mae})
        if on_epoch is not None:
            on_epoch(EpochReport(epoch, config.max_epochs, loss, mae))

    # Threads of the optimizer's small linear algebra would wait for each other most of the time.
    with torch.no_grad(), threadpool_limits(limits=1, user_api="blas"):
        kernel = Kernel(features.shape[1], config.n_scales, config.degree)
        basis, rest = _principal_components(x, config.n_latent)
        codes = x @ basis.T  # (n, z)
        found: list[Candidate] = []
        for one in candidates(kernel, features, codes, seed, config.max_epochs):
            found.append(one)
            epoch, last = int(one.done * (config.max_epochs - 1)), history[-1]["epoch"] if history else 0
            if one.n_rows and epoch > last:
                alone, rows = np.ones((1, len(basis))), slice(one.n_rows)
                part = _assembled(kernel, features[rows], codes[rows], basis, rest, one.hyper[None], alone)
                report(part, one.loss, epoch)
        hypers, shares = _members(
            kernel, (features, codes), (validation[0], validation[1] @ basis.T), found, config.n_members
        )
        network = _assembled(kernel, features, codes, basis, rest, hypers, shares)
        _inflate(network, *validation, n_outputs)
        report(network, found[0].loss, config.max_epochs)
    return network, history[-1:]


def _members(
    kernel: Kernel,
    training: tuple[Tensor, Tensor],
    validation: tuple[Tensor, Tensor],
    found: list[Candidate],
    n_members: int,
) -> tuple[Array, Array]:
    """Choose members by the validation set, whose codes are known as the training set's are.

    Returns:
        Their hyperparameters and their shares in the codes. Shapes (m, h) and (m, z).
    """
    (features, codes), (known, true) = training, validation
    n, z = codes.shape
    hypers = np.array([one.hyper for one in found])
    believed = np.zeros((len(found), z))
    for place, one in enumerate(found):
        believed[place, one.columns] = one.is_final
    n_most = max(1, min(n_members, MEMBER_ROWS // n))
    for rows in sorted({min(n, CHOOSING_ROWS), n}):
        if rows > CHOOSING_ROWS and len(hypers) == 1:
            break
        predicted = [
            (kernel.matrix(hyper, known, features[:rows]) @ solved).cpu().numpy()
            for hyper, solved in _solved(kernel, features[:rows], codes[:rows], hypers)
        ]
        chosen = best_shares(np.array(predicted), true.cpu().numpy(), believed, n_most)
        hypers, believed = hypers[chosen.members], believed[chosen.members]
    return hypers, chosen.share


def _inflate(network: LinearVae, features: Tensor, x: Tensor, n_outputs: int) -> None:
    """Scale the stated deviations so that 90 % bands cover 90 % of rows that were not trained on.

    Each output has a factor of its own. Shapes (b, f) and (b, d).
    """
    error = (x - network.decoder(network.regressor_mean(features))).abs()
    ratio = (error / network.deviation(features).clamp_min(1e-12)).reshape(-1, n_outputs)
    by_output = torch.quantile(_thinned(ratio), _SHARE, dim=0)
    normal = math.sqrt(2.0) * float(torch.erfinv(torch.tensor(_SHARE, dtype=torch.float64)))
    network.inflation.mul_((by_output / normal).clamp_min(1e-6).repeat(x.shape[1] // n_outputs))


def _thinned(values: Tensor) -> Tensor:
    """Return at most a million rows, evenly: torch.quantile takes no more than 16 million values."""
    return values[:: 1 + len(values) // 1_000_000]


def _principal_components(x: Tensor, n_latent: int) -> tuple[Tensor, Tensor]:
    """Return as many components as matter, (z, d), and the variance outside them, (d,)."""
    _, singular, components = torch.linalg.svd(x, full_matrices=False)
    explained = singular.square().cumsum(dim=0)
    needed = int((explained < (1.0 - _LEFT_OUT) * explained[-1]).sum()) + 1
    basis = components[: min(needed, n_latent)].clone()
    outside = x - (x @ basis.T) @ basis
    return basis, outside.square().mean(dim=0)


def _assembled(
    kernel: Kernel, features: Tensor, codes: Tensor, basis: Tensor, rest: Tensor, hypers: Array, shares: Array
) -> LinearVae:
    """Solve for the coefficients of every member."""
    solved = torch.stack([found for _, found in _solved(kernel, features, codes, hypers)])  # (m, n, z)
    share = torch.from_numpy(shares).to(features.device)
    return LinearVae(
        kernel,
        basis=basis,
        x=features,
        hyper=torch.from_numpy(hypers).to(features.device),
        share=share,
        coefficients=solved * (share > 0)[:, None],
        amplitude=(codes * solved).sum(dim=1) / len(codes),
        rest=rest,
        inflation=torch.ones_like(rest),
    )


def _solved(
    kernel: Kernel, features: Tensor, codes: Tensor, hypers: Array
) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield hyperparameters, (h,), and the inverse of their covariances times the codes, (n, z)."""
    for hyper in torch.from_numpy(hypers).to(features.device):
        yield hyper, torch.cholesky_solve(codes, torch.linalg.cholesky(kernel.noisy(hyper, features)))
