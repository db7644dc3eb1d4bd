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
from pelsvae.ensemble_training import NetworkTraining
from pelsvae.epochs import EpochReport, TrainingDiverged
from pelsvae.kernel import Kernel
from pelsvae.kernel_search import Candidate, candidates
from pelsvae.linear_vae import LinearVae
from pelsvae.member_shares import best_part, best_shares
from pelsvae.network_ensemble import NetworkEnsemble
from pelsvae.side_by_side import SideBySide, side_by_side
from pelsvae.standardize import Array

MEMBER_ROWS = 4096  # members times rows at most: what a prediction costs
CHOOSING_ROWS = 1024  # from so many rows at most it is chosen which kernels are members
THREADED_ROWS = 200  # with fewer, threads wait for the interpreter as long as they gain
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
    n_jobs: int,
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
        n_jobs: Threads that work side by side; a GPU and few rows have one.
        on_epoch: Called with searches, in parts of `max_epochs`, and last of what is returned.

    Returns:
        The network, and what was last reported, by name: its error, and the loss of the likeliest kernel of
        all codes. The searches' errors before are of a part of the rows.

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
    if features.is_cuda or len(features) < THREADED_ROWS:
        n_jobs = 1
    # Threads of the optimizer's small linear algebra would wait for each other most of the time.
    with torch.no_grad(), threadpool_limits(limits=1, user_api="blas"), side_by_side(n_jobs) as threads:
        kernel = Kernel(features.shape[1], config.n_scales, config.degree)
        basis, rest = _principal_components(x, config.n_latent)
        codes = x @ basis.T  # (n, z)
        rows = _Rows(kernel, features, codes)
        networks = NetworkTraining(features, codes, seed, threads)
        if len(features) >= MANY_ROWS:
            networks.begin(n_jobs - 1)
        found: list[Candidate] = []
        for one in candidates(kernel, features, codes, seed, config.max_epochs, threads):
            found.append(one)
            epoch, last = int(one.done * (config.max_epochs - 1)), history[-1]["epoch"] if history else 0
            if one.n_rows and epoch > last:
                alone = _Members(one.hyper[None], np.ones((1, len(basis))))
                report(_assembled(rows.first(one.n_rows), basis, rest, alone), one.loss, epoch)
        found.sort(key=lambda one: one.place)
        if len(features) >= MANY_ROWS:
            networks.begin(n_jobs)
        known = validation[0], validation[1] @ basis.T
        members = _members(rows, known, found, config.n_members, networks, threads)
        network = _assembled(rows, basis, rest, members)
        _inflate(network, *validation, n_outputs)
        of_all_codes = next(one.loss for one in found if one.is_final)
        report(network, of_all_codes, config.max_epochs)
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


class _Rows:
    """Training rows, and what processes of them were solved for where that takes long.

    Attributes:
        kernel: Form of the processes' kernels.
        features: Of theta. Shape (n, f). [1]
        codes: Principal coordinates. Shape (n, z). [1]
    """

    def __init__(self, kernel: Kernel, features: Tensor, codes: Tensor) -> None:
        self.kernel, self.features, self.codes = kernel, features, codes
        self._known: dict[bytes, tuple[Tensor, Tensor]] = {}

    def __len__(self) -> int:
        return len(self.features)

    def first(self, n: int) -> _Rows:
        """Return the first n rows; all are these."""
        return self if n >= len(self) else _Rows(self.kernel, self.features[:n], self.codes[:n])

    def solved(self, hyper: Array) -> tuple[Tensor, Tensor]:
        """Return the factor of a process's covariances (n, n), and their inverse times the codes (n, z)."""
        known = self._known.get(hyper.tobytes())
        if known is None:
            at = torch.from_numpy(hyper).to(self.features.device)
            factor = torch.linalg.cholesky(self.kernel.noisy(at, self.features))
            known = factor, torch.cholesky_solve(self.codes, factor)
            if len(self) > CHOOSING_ROWS:  # where few processes are left
                self._known[hyper.tobytes()] = known
        return known


def _members(
    rows: _Rows,
    validation: tuple[Tensor, Tensor],
    found: list[Candidate],
    n_members: int,
    networks: NetworkTraining,
    threads: SideBySide,
) -> _Members:
    """Choose members by the validation set, whose codes are known as the training set's are."""
    n, z = rows.codes.shape
    if n < MANY_ROWS:
        found = [*found, *_stretched(rows.kernel, found)]
    hypers, true = np.array([one.hyper for one in found]), validation[1].cpu().numpy()
    believed = np.zeros((len(found), z))
    for place, one in enumerate(found):
        believed[place, one.columns] = one.is_final
    n_most, seen = max(1, min(n_members, MEMBER_ROWS // n)), 0
    for n_rows in sorted({min(n, CHOOSING_ROWS), n}):
        if n_rows > CHOOSING_ROWS and len(hypers) == 1:
            break
        predicted = _predicted(rows.first(n_rows), validation[0], hypers, threads)
        chosen = best_shares(predicted, true, believed, n_most)
        hypers, believed, predicted = (values[chosen.members] for values in (hypers, believed, predicted))
        seen = n_rows
    members = _Members(hypers, chosen.share)
    if n < MANY_ROWS and _left(predicted, chosen.share, true) <= UNEXPLAINED * np.square(true).sum():
        return members
    if seen < n:
        predicted = _predicted(rows, validation[0], hypers, threads)
    return _with_networks(members, predicted, validation, networks.result())


def _stretched(kernel: Kernel, found: list[Candidate]) -> Iterator[Candidate]:
    """Yield the candidates with longer and with shorter lengths, of which few rows know little."""
    for one in found:
        for factor in (_STRETCH, 1.0 / _STRETCH):
            yield one._replace(hyper=kernel.stretched(one.hyper, factor), is_final=False)


def _with_networks(
    members: _Members,
    predicted: Array,
    validation: tuple[Tensor, Tensor],
    networks: NetworkEnsemble,
) -> _Members:
    """Let the validation set say what networks count beside the processes.

    Args:
        members: Processes alone.
        predicted: Their codes of the validation set. Shape (m, b, z). [1]
        validation: Features and codes of b rows. Shapes (b, f), (b, z). [1]
        networks: Trained on what the processes were.
    """
    true = validation[1].cpu().numpy()
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


def _predicted(rows: _Rows, points: Tensor, hypers: Array, threads: SideBySide) -> Array:
    """Return the codes that processes predict at points, (b, f) -> (m, b, z)."""

    def codes_at_points(hyper: Array) -> Array:
        threads.check()
        at, (_, solved) = torch.from_numpy(hyper).to(points.device), rows.solved(hyper)
        return (rows.kernel.matrix(at, points, rows.features) @ solved).cpu().numpy()

    return np.array(list(threads.each(codes_at_points, hypers)))


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


def _assembled(rows: _Rows, basis: Tensor, rest: Tensor, members: _Members) -> LinearVae:
    """Solve for the coefficients of every process."""
    factors, solved = zip(*(rows.solved(hyper) for hyper in members.hypers), strict=True)
    coefficients = torch.stack(solved)  # (m, n, z)
    device = rows.features.device
    share = torch.from_numpy(members.share).to(device)
    return LinearVae(
        rows.kernel,
        members.networks,
        factors,
        basis=basis,
        x=rows.features,
        hyper=torch.from_numpy(members.hypers).to(device),
        share=share,
        coefficients=coefficients * (share > 0)[:, None],
        amplitude=(rows.codes * coefficients).sum(dim=1) / len(rows),
        rest=rest,
        inflation=torch.ones_like(rest),
    )
