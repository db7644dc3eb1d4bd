"""Fits the linear form: principal components, and a mean of likely kernels and networks of proven worth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import Tensor

from pelsvae.config import SurrogateConfig
from pelsvae.device import keep_freed_memory
from pelsvae.epochs import EpochReport, TrainingDiverged
from pelsvae.kernel import Kernel
from pelsvae.kernel_search import Candidate, candidates
from pelsvae.linear_vae import LinearVae
from pelsvae.member_shares import best_part, best_shares
from pelsvae.network_ensemble import NetworkEnsemble, trained_networks
from pelsvae.standardize import Array

MEMBER_ROWS = 4096  # members times rows at most: what a prediction costs
CHOOSING_ROWS = 1024  # from so many rows at most it is chosen which kernels are members
# Part of the validation set's squared codes that processes leave, above which networks are tried. Where they
# leave 2 to 9 %, on 64 rows of buildings, networks improve the error by 0 to 1.3 %.
UNEXPLAINED = 0.1
# Of so many rows at most four processes are averaged, and networks are tried in any case: they take 3 to 10 %
# off the error on buildings.
MANY_ROWS = 1024
_STRETCH = 1.5  # of the lengths of further candidates where rows are fewer
_WORTH = 0.01  # part of the squares left by processes that networks must explain to be kept
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

    Many kernels are searched for, on few rows first; the validation set says what each counts in each code,
    and whether a few networks are worth their cost beside them.

    Args:
        config: Scales, degree, members and iterations.
        training: Features of theta, in random order, and standardized trajectories, float64. Shapes (n, f)
            and (n, d). [1]
        validation: As training, of rows that say what each kernel's process is worth and how far the stated
            deviations are right. Shapes (b, f) and (b, d). [1]
        n_outputs: Outputs k of a model; d is times x k.
        validation_error: Judges a network.
        seed: Of the searches' starts and of networks.
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

    keep_freed_memory()
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
                alone, rows = _Members(one.hyper[None], np.ones((1, len(basis)))), slice(one.n_rows)
                part = _assembled(kernel, features[rows], codes[rows], basis, rest, alone)
                report(part, one.loss, epoch)
        known = validation[0], validation[1] @ basis.T
        members = _members(kernel, (features, codes), known, found, config.n_members, seed)
        network = _assembled(kernel, features, codes, basis, rest, members)
        _inflate(network, *validation, n_outputs)
        report(network, found[0].loss, config.max_epochs)
    return network, history[-1:]


class _Members(NamedTuple):
    """What is averaged.

    Attributes:
        hypers: Of the processes. Shape (m, h).
        share: Of the processes in the codes. Shape (m, z).
        networks: With their own share; None where they are not worth it.
    """

    hypers: Array
    share: Array
    networks: NetworkEnsemble | None = None


def _members(
    kernel: Kernel,
    training: tuple[Tensor, Tensor],
    validation: tuple[Tensor, Tensor],
    found: list[Candidate],
    n_members: int,
    seed: int,
) -> _Members:
    """Choose members by the validation set, whose codes are known as the training set's are."""
    features, codes = training
    n, z = codes.shape
    if n < MANY_ROWS:
        found = [*found, *_stretched(kernel, found)]
    hypers, true = np.array([one.hyper for one in found]), validation[1].cpu().numpy()
    believed = np.zeros((len(found), z))
    for place, one in enumerate(found):
        believed[place, one.columns] = one.is_final
    n_most, seen = max(1, min(n_members, MEMBER_ROWS // n)), 0
    for rows in sorted({min(n, CHOOSING_ROWS), n}):
        if rows > CHOOSING_ROWS and len(hypers) == 1:
            break
        predicted = _predicted(kernel, (features[:rows], codes[:rows]), validation[0], hypers)
        chosen = best_shares(predicted, true, believed, n_most)
        hypers, believed, predicted = (values[chosen.members] for values in (hypers, believed, predicted))
        seen = rows
    members = _Members(hypers, chosen.share)
    if n < MANY_ROWS and _left(predicted, chosen.share, true) <= UNEXPLAINED * np.square(true).sum():
        return members
    if seen < n:
        predicted = _predicted(kernel, training, validation[0], hypers)
    return _with_networks(members, predicted, training, validation, seed)


def _stretched(kernel: Kernel, found: list[Candidate]) -> Iterator[Candidate]:
    """Yield the candidates with longer and with shorter lengths, of which few rows know little."""
    for one in found:
        for factor in (_STRETCH, 1.0 / _STRETCH):
            yield one._replace(hyper=kernel.stretched(one.hyper, factor), is_final=False)


def _with_networks(
    members: _Members,
    predicted: Array,
    training: tuple[Tensor, Tensor],
    validation: tuple[Tensor, Tensor],
    seed: int,
) -> _Members:
    """Train networks and let the validation set say what they count beside the processes.

    Args:
        members: Processes alone.
        predicted: Their codes of the validation set. Shape (m, b, z). [1]
        training: Features and codes. Shapes (n, f), (n, z). [1]
        validation: As training, b rows.
        seed: Of the networks.
    """
    networks, true = trained_networks(*training, seed), validation[1].cpu().numpy()
    mean = networks.each(validation[0]).mean(dim=0, keepdim=True).cpu().numpy()  # (1, b, z)
    if not np.isfinite(mean).all():
        return members
    everything = np.concatenate([predicted, mean])
    in_all, weight = best_part(np.einsum("mbz,mz->bz", predicted, members.share), mean[0], true)
    believed = np.concatenate([(1.0 - in_all) * members.share, np.full((1, true.shape[1]), in_all)])
    everything, true = weight * everything, weight * true
    chosen = best_shares(everything, true, believed, len(everything))
    share = np.zeros_like(believed)
    share[chosen.members] = chosen.share
    is_worth = _left(everything, share, true) <= (1.0 - _WORTH) * _left(everything[:-1], members.share, true)
    # What other shares of the processes gain is not the networks' merit.
    if not (is_worth and share[-1].any()):
        return members
    networks.share.copy_(torch.from_numpy(share[-1]))
    used = share[:-1].max(axis=1) > 0.0
    used[0] = True  # the form has a process at least
    return _Members(members.hypers[used], share[:-1][used], networks)


def _left(predicted: Array, share: Array, true: Array) -> float:
    """Return the squares that a mean leaves of codes (b, z): members' codes (m, b, z), shares (m, z)."""
    return float(np.square(true - np.einsum("mbz,mz->bz", predicted, share)).sum())


def _predicted(kernel: Kernel, training: tuple[Tensor, Tensor], points: Tensor, hypers: Array) -> Array:
    """Return the codes that processes predict at points, (b, f) -> (m, b, z)."""
    return np.array(
        [
            (kernel.matrix(hyper, points, training[0]) @ solved).cpu().numpy()
            for hyper, solved in _solved(kernel, *training, hypers)
        ]
    )


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
    kernel: Kernel, features: Tensor, codes: Tensor, basis: Tensor, rest: Tensor, members: _Members
) -> LinearVae:
    """Solve for the coefficients of every process."""
    known = list(_solved(kernel, features, codes, members.hypers))
    solved = torch.stack([found for _, found in known])  # (m, n, z)
    share = torch.from_numpy(members.share).to(features.device)
    return LinearVae(
        kernel,
        members.networks,
        basis=basis,
        x=features,
        hyper=torch.from_numpy(members.hypers).to(features.device),
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
