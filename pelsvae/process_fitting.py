"""Fits the linear form: principal components, and a mean of processes with likely kernels."""

import math
from collections.abc import Callable, Iterator

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
from pelsvae.member_shares import best_shares
from pelsvae.standardize import Array

MEMBER_ROWS = 4096  # members times rows at most: what a prediction costs
CHOOSING_ROWS = 1024  # from so many rows at most it is chosen which kernels are members
# Up to so many rows the kernels found are also tried with longer and with shorter lengths.
MANY_ROWS = 1024
# 1.8 % less error at n = 32, 0.9 % at 256, none at 1,024; factors 1.3 and 2 gain less from 64 on.
_STRETCH = 1.5  # of these lengths
_LEFT_OUT = 1e-5  # part of the variance outside the basis


def fit_processes(
    config: SurrogateConfig,
    training: tuple[Tensor, Tensor],
    validation: tuple[Tensor, Tensor] | None,
    *,
    validation_error: Callable[[LinearVae], float | None],
    seed: int,
    on_epoch: Callable[[EpochReport], None] | None,
) -> LinearVae:
    """Fit principal components and the Gaussian processes of their coordinates.

    Many kernels are searched for, on few rows first; the validation set says what each counts in each code,
    or, without one, every training row where it is left out.

    Args:
        config: Scales, degree, members and iterations.
        training: Features of theta, in random order, and standardized trajectories, float64. Shapes (n, f)
            and (n, d). [1]
        validation: As training, of rows that say what each kernel's process is worth; None for the training
            rows. Shapes (b, f) and (b, d). [1]
        validation_error: Judges a network; None where nothing does.
        seed: Of the searches' starts.
        on_epoch: Called with searches, in parts of `max_epochs`, whose errors are of a part of the rows; last
            with the error of what is returned, and the loss of the likeliest kernel of all codes.

    Returns:
        The network.

    Raises:
        TrainingDiverged: The loss or the validation error became NaN or infinite.
    """
    features, x = training
    last = 0

    def report(network: LinearVae, loss: float, epoch: int) -> None:
        mae = validation_error(network)
        if not math.isfinite(loss + (mae or 0.0)):
            raise TrainingDiverged(f"loss {loss:g}, validation error {mae} at epoch {epoch}")
        if on_epoch is not None:
            on_epoch(EpochReport(epoch, config.max_epochs, loss, math.nan if mae is None else mae))

    keep_freed_memory()
    # Threads of the optimizer's small linear algebra would wait for each other most of the time.
    with torch.no_grad(), threadpool_limits(limits=1, user_api="blas"):
        kernel = Kernel(features.shape[1], config.n_scales, config.degree)
        basis = _principal_components(x, config.n_latent)
        codes = x @ basis.T  # (n, z)
        rows = _Rows(kernel, features, codes)
        found: list[Candidate] = []
        for one in candidates(kernel, features, codes, seed, config.max_epochs):
            found.append(one)
            epoch = int(one.done * (config.max_epochs - 1))
            if one.n_rows and epoch > last:
                last = epoch
                # One kernel for all codes: shares are chosen at the end, and this shows how far it is.
                alone = _assembled(rows.first(one.n_rows), basis, one.hyper[None], np.ones((1, len(basis))))
                report(alone, one.loss, epoch)
        # By place, so the result does not depend on the order in which searches end.
        found.sort(key=lambda one: one.place)
        known = None if validation is None else (validation[0], validation[1] @ basis.T)
        network = _assembled(rows, basis, *_members(rows, known, found, config.n_members))
        of_all_codes = next(one.loss for one in found if one.is_final)
        report(network, of_all_codes, config.max_epochs)
    return network


class _Rows:
    """Training rows, and what processes of them were solved for where that takes long.

    Attributes:
        kernel: Form of the processes' kernels.
        features: Of theta. Shape (n, f). [1]
        codes: Principal coordinates. Shape (n, z). [1]
    """

    def __init__(self, kernel: Kernel, features: Tensor, codes: Tensor) -> None:
        self.kernel, self.features, self.codes = kernel, features, codes
        self._known: dict[bytes, Tensor] = {}

    def __len__(self) -> int:
        return len(self.features)

    def first(self, n: int) -> "_Rows":
        """Return the first n rows; all are these."""
        return self if n >= len(self) else _Rows(self.kernel, self.features[:n], self.codes[:n])

    def left_out(self, hyper: Array) -> Array:
        """Return each row's codes as a process of all other rows predicts them. Shape (n, z).

        Rasmussen and Williams 2006, eq. 5.12.
        """
        at = torch.from_numpy(hyper).to(self.features.device)
        inverse = torch.cholesky_inverse(torch.linalg.cholesky(self.kernel.noisy(at, self.features)))
        predicted = self.codes - (inverse @ self.codes) / inverse.diagonal()[:, None]
        return np.asarray(predicted.cpu().numpy())

    def solved(self, hyper: Array) -> Tensor:
        """Return the inverse of a process's covariances times the codes. Shape (n, z)."""
        # A fit once factorized the same 4,096 rows three times.
        known = self._known.get(hyper.tobytes())
        if known is None:
            at = torch.from_numpy(hyper).to(self.features.device)
            factor = torch.linalg.cholesky(self.kernel.noisy(at, self.features))
            known = torch.cholesky_solve(self.codes, factor)
            if len(self) > CHOOSING_ROWS:  # where few processes are left
                self._known[hyper.tobytes()] = known
        return known


def _members(
    rows: _Rows,
    validation: tuple[Tensor, Tensor] | None,
    found: list[Candidate],
    n_members: int,
) -> tuple[Array, Array]:
    """Choose members by the validation set, whose codes are known as the training set's are.

    Without one by the training rows, each where it is left out.

    Returns:
        Hyperparameters of the members, shape (m, h), and their shares in the codes, shape (m, z).
    """
    n, z = rows.codes.shape
    if n < MANY_ROWS:
        found = [*found, *_stretched(rows.kernel, found)]
    hypers = np.array([one.hyper for one in found])
    believed = np.zeros((len(found), z))
    for place, one in enumerate(found):
        believed[place, one.columns] = one.is_final
    n_most = max(1, min(n_members, MEMBER_ROWS // n))
    # On few rows first, as each candidate costs a factorization, n³; the shares then follow from all rows.
    n_rows = min(n, CHOOSING_ROWS)
    while True:
        part = rows.first(n_rows)
        if validation is None:
            predicted, true = np.array([part.left_out(hyper) for hyper in hypers]), part.codes
        else:
            predicted, true = _predicted(part, validation[0], hypers), validation[1]
        chosen = best_shares(predicted, true.cpu().numpy(), believed, n_most)
        hypers, believed = hypers[chosen.members], believed[chosen.members]
        # A single member counts 1 whatever the rows.
        if n_rows == n or len(hypers) == 1:
            return hypers, chosen.share
        n_rows = n


def _stretched(kernel: Kernel, found: list[Candidate]) -> Iterator[Candidate]:
    """Yield the candidates with longer and with shorter lengths, of which few rows know little."""
    for one in found:
        for factor in (_STRETCH, 1.0 / _STRETCH):
            yield one._replace(hyper=kernel.stretched(one.hyper, factor), is_final=False)


def _predicted(rows: _Rows, points: Tensor, hypers: Array) -> Array:
    """Return the codes that processes predict at points, (b, f) -> (m, b, z)."""

    def codes_at_points(hyper: Array) -> Array:
        at = torch.from_numpy(hyper).to(points.device)
        return (rows.kernel.matrix(at, points, rows.features) @ rows.solved(hyper)).cpu().numpy()

    return np.array([codes_at_points(hyper) for hyper in hypers])


def _principal_components(x: Tensor, n_latent: int) -> Tensor:
    """Return as many components as matter. Shape (z, d)."""
    # Of the trajectories themselves: their d x d covariance would be larger and of squared condition.
    _, singular, components = torch.linalg.svd(x, full_matrices=False)
    explained = singular.square().cumsum(dim=0)
    needed = int((explained < (1.0 - _LEFT_OUT) * explained[-1]).sum()) + 1
    # A copy, as a view would hold all components in memory.
    return components[: min(needed, n_latent)].clone()


def _assembled(rows: _Rows, basis: Tensor, hypers: Array, shares: Array) -> LinearVae:
    """Solve for the coefficients of every process."""
    coefficients = torch.stack([rows.solved(hyper) for hyper in hypers])  # (m, n, z)
    device = rows.features.device
    share = torch.from_numpy(shares).to(device)
    buffers = {
        "basis": basis,
        "x": rows.features,
        "hyper": torch.from_numpy(hypers).to(device),
        "share": share,
        "coefficients": coefficients * (share > 0)[:, None],
    }
    return LinearVae(rows.kernel, buffers)
