"""Fits the linear form: principal components, then likely kernels, then one factorization for each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits
from torch import Tensor

from pelsvae.config import SurrogateConfig
from pelsvae.epochs import EpochReport, TrainingDiverged
from pelsvae.kernel import Kernel
from pelsvae.linear_vae import LinearVae
from pelsvae.standardize import Array

# Rows on which the kernels are searched for, and how many of them go on from each to the next: a search on
# few rows costs little, and tells which of several likely kernels is worth more.
ROWS = (128, 256, 512, 1024)
SURVIVORS = (6, 2, 1, 1)
# With more rows one kernel for all codes, searched for on 1,024 of them, costs a third of the predictions;
# with fewer, kernels for groups of codes, each searched for on 512 at most, are better in the same time.
MOST_GROUPED_ROWS = 1024
MOST_AVERAGED_ROWS = 512  # members of a group times rows
LEADING = 0.9  # part of the variance that the leading codes hold
_LEFT_OUT = 1e-5  # part of the variance outside the basis
_SPREAD = 0.7  # of the starts, in deviations of the prior: equal scales would stay equal
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

    The kernels are searched for on few rows first, and the most likely ones go on to more of them.

    Args:
        config: Scales, degree, members and iterations.
        training: Features of theta, in random order, and standardized trajectories, float64. Shapes (n, f)
            and (n, d). [1]
        validation: As training, of rows that say how far the stated deviations are right. Shapes (b, f) and
            (b, d). [1]
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
        if epoch <= (history[-1]["epoch"] if history else 0):
            return
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
        groups = _groups(codes)
        plan = list(_stages(len(x), config.n_members))
        all_work = len(groups) * sum(n_starts * float(n_rows) ** 3 for n_rows, n_starts, _ in plan)
        hypers, shares, loss, done = [], [], 0.0, 0.0
        for place, group in enumerate(groups):
            likely = _starts(kernel, [seed, place])
            for n_rows, n_starts, n_kept in plan:
                rows = slice(n_rows)
                found: list[tuple[float, Array]] = []
                for hyper in likely[:n_starts]:
                    known = codes[rows, group.columns]
                    loss, better = _most_probable(kernel, features[rows], known, hyper, config.max_epochs)
                    found.append((loss, better))
                    done += float(n_rows) ** 3 / all_work
                    alone = [torch.ones_like(codes[0])]
                    network = _assembled(kernel, features[rows], codes[rows], basis, rest, [better], alone)
                    report(network, loss / n_rows, int(done * (config.max_epochs - 1)))
                found.sort(key=lambda pair: pair[0])
                likely, loss = [hyper for _, hyper in found[:n_kept]], found[0][0] / n_rows
            hypers += likely
            shares += [group.share / len(likely)] * len(likely)
        network = _assembled(kernel, features, codes, basis, rest, hypers, shares)
        _inflate(network, *validation, n_outputs)
        report(network, loss, config.max_epochs)
    return network, history[-1:]


class _Group(NamedTuple):
    """Codes that have kernels of their own: their places, and these kernels' share in each code, (z,)."""

    columns: slice
    share: Tensor


def _groups(codes: Tensor) -> list[_Group]:
    """Return all codes together and, of few rows, beside them the leading codes and the others.

    One kernel for all is determined best, by the leading codes, and the others depend on other parameters:
    the mean of both views is better than either.
    """
    n, z = codes.shape
    explained = codes.square().sum(dim=0).cumsum(dim=0)
    n_leading = int((explained < LEADING * explained[-1]).sum()) + 1
    whole = torch.ones_like(codes[0])
    if n > MOST_GROUPED_ROWS or n_leading >= z:
        return [_Group(slice(z), whole)]
    leading = (torch.arange(z, device=codes.device) < n_leading).to(codes.dtype)
    return [
        _Group(slice(z), 0.5 * whole),
        _Group(slice(n_leading), 0.5 * leading),
        _Group(slice(n_leading, z), 0.5 * (whole - leading)),
    ]


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


def _starts(kernel: Kernel, seed: list[int]) -> list[Array]:
    """Draw where the searches begin."""
    mean, deviation = kernel.prior
    random = np.random.default_rng(seed)
    return [mean + _SPREAD * deviation * random.standard_normal(mean.size) for _ in range(SURVIVORS[0])]


def _stages(n: int, n_members: int) -> Iterator[tuple[int, int, int]]:
    """Yield rows, kernels that start and kernels that go on, for a training set of n rows."""
    n_final = max(1, min(n_members, MOST_AVERAGED_ROWS // n))
    sizes = ROWS[:-1] if n <= MOST_GROUPED_ROWS else ROWS
    last = next((place for place, rows in enumerate(sizes) if rows >= n), len(sizes) - 1)
    for place in range(last + 1):
        n_next = n_final if place == last else SURVIVORS[place + 1]
        yield min(n, sizes[place]), max(SURVIVORS[place], n_final), max(n_next, n_final)


def _most_probable(
    kernel: Kernel, features: Tensor, codes: Tensor, start: Array, max_iterations: int
) -> tuple[float, Array]:
    """Return the smallest loss found from a start, and the hyperparameters there."""
    total = float(codes.square().sum())
    if total <= 0.0:  # every trajectory is the same: nothing to learn from
        return 0.0, kernel.prior[0]
    found = minimize(
        kernel.loss,
        start,
        args=(features, codes * math.sqrt(len(features) / total)),
        jac=True,
        method="L-BFGS-B",
        bounds=kernel.bounds,
        options={"maxiter": max_iterations, "maxcor": 20},
    )
    return float(found.fun), np.asarray(found.x, dtype=np.float64)


def _assembled(
    kernel: Kernel,
    features: Tensor,
    codes: Tensor,
    basis: Tensor,
    rest: Tensor,
    hypers: list[Array],
    shares: list[Tensor],
) -> LinearVae:
    """Solve for the coefficients of every member."""
    points = torch.from_numpy(np.array(hypers)).to(features.device)
    coefficients, amplitudes = [], []
    for hyper, share in zip(points, shares, strict=True):
        factor = torch.linalg.cholesky(kernel.noisy(hyper, features))
        solved = torch.cholesky_solve(codes * (share > 0), factor)
        coefficients.append(solved)
        amplitudes.append((codes * solved).sum(dim=0) / len(codes))
    return LinearVae(
        kernel,
        basis=basis,
        x=features,
        hyper=points,
        share=torch.stack(shares),
        coefficients=torch.stack(coefficients),
        amplitude=torch.stack(amplitudes),
        rest=rest,
        inflation=torch.ones_like(rest),
    )
