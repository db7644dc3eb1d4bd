"""Candidates for the kernels: likely hyperparameters for all codes, for parts of them, for single ones."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from pelsvae.kernel import N_INDEPENDENT, Kernel, Prior
from pelsvae.kernel_loss import kernel_loss
from pelsvae.standardize import Array

# Rows on which kernels are searched for, and how many of them go on from each to the next: a search on few
# rows costs little, and shows which of several likely kernels is worth more.
ROWS = (128, 256, 512, 1024)
SURVIVORS = (6, 2, 1, 1)
# With more rows the kernel of all codes is searched for on 1,024 of them, and leading ones have none.
MOST_GROUPED_ROWS = 1024
LEADING = 0.9  # part of the variance that the leading codes hold
N_FINAL = 2  # kernels of a group that count without validation
# Twenty codes or 256 rows took too long (docs/notes/surrogates.md).
N_SINGLE = 10  # leading codes that have kernels of their own
SINGLE_ROWS = 128  # on which these are searched for
N_CORRECTIONS = 20  # that L-BFGS-B keeps; its default is 10
CLOSER = 0.7  # deviations of a single code's hyperparameters around those of all codes, in those of the prior
# Random starts: 0.480 instead of 0.493 K at n = 64, 0.165 instead of 0.171 K at n = 256.
_SPREAD = 0.7  # of the starts, in deviations of the prior: equal scales would stay equal


class Candidate(NamedTuple):
    """Hyperparameters that are likely for some codes.

    Attributes:
        place: Its own among candidates: group of codes, stage and rank; single codes come after all groups.
        hyper: The hyperparameters. Shape (h,).
        columns: The codes that they are likely for.
        is_final: Whether they are among the likeliest two of a group's last searches.
        n_rows: Rows of the search; None for a single code.
        loss: Minus the logarithm of the posterior density, per row.
        done: Part of all searches that is done with this one.
    """

    place: tuple[int, int, int]
    hyper: Array
    columns: slice
    is_final: bool
    n_rows: int | None
    loss: float
    done: float


class _Search(NamedTuple):
    """One search: the rows and codes it is for, its start and belief, and how many values of a row count."""

    rows: slice
    columns: slice
    start: Array
    prior: Prior
    n_independent: float = N_INDEPENDENT


def candidates(
    kernel: Kernel, features: Tensor, codes: Tensor, seed: int, max_iterations: int
) -> Iterator[Candidate]:
    """Search for likely kernels, each group of codes from several starts, then for single codes.

    Args:
        kernel: Their form.
        features: Features of theta, in random order. Shape (n, f). [1]
        codes: Principal coordinates, the leading ones first. Shape (n, z). [1]
        seed: Of the starts.
        max_iterations: Of each search.

    Yields:
        What each search ended with, as they end.
    """

    def found(search: _Search) -> tuple[float, Array]:
        return _most_probable(kernel, features, codes, search, max_iterations)

    n, z = codes.shape
    groups = _groups(codes)
    plan = list(_stages(n))
    n_single = min(N_SINGLE, z)
    n_few = min(n, SINGLE_ROWS)
    # A search costs about n³, its factorizations.
    work = [len(groups) * n_starts * float(rows) ** 3 for rows, n_starts in plan]
    all_work, done = sum(work) + 2 * n_single * float(n_few) ** 3, 0.0
    likely = [_starts(kernel, [seed, group]) for group in range(len(groups))]
    for stage, (n_rows, n_starts) in enumerate(plan):
        for group, columns in enumerate(groups):
            searches = [_Search(slice(n_rows), columns, start, kernel.prior) for start in likely[group]]
            ranked = sorted(map(found, searches[:n_starts]), key=lambda pair: pair[0])
            for rank, (loss, hyper) in enumerate(ranked):
                done += float(n_rows) ** 3 / all_work
                is_final = stage == len(plan) - 1 and rank < N_FINAL
                place = (group, stage, rank)
                yield Candidate(place, hyper, columns, is_final, n_rows, loss / n_rows, done)
            # The likeliest first: the next stage begins with so many from the front.
            likely[group] = [hyper for _, hyper in ranked]
    mean, deviation = kernel.prior
    # Group 0 is that of all codes.
    shared = likely[0][0]
    singles = [
        _Search(slice(n_few), slice(code, code + 1), shared, prior, n_independent=1.0)
        for code in range(n_single)
        # Near the kernel of all codes for a code that resembles them, the wide prior for one that does not.
        for prior in ((shared, CLOSER * deviation), (mean, deviation))
    ]
    for rank, (loss, hyper) in enumerate(map(found, singles)):
        done += float(n_few) ** 3 / all_work
        place = (len(groups), 0, rank)
        yield Candidate(place, hyper, singles[rank].columns, False, None, loss / n_few, done)


def _groups(codes: Tensor) -> list[slice]:
    """Return all codes together and, of few rows, beside them the leading codes and the others.

    One kernel for all is determined best, by the leading codes, and the others depend on other parameters.
    """
    n, z = codes.shape
    explained = codes.square().sum(dim=0).cumsum(dim=0)
    n_leading = int((explained < LEADING * explained[-1]).sum()) + 1
    if n > MOST_GROUPED_ROWS or n_leading >= z:
        return [slice(0, z)]
    # Office, n = 512: 0.085 instead of 0.101 K with one kernel for all.
    return [slice(0, z), slice(0, n_leading), slice(n_leading, z)]


def _starts(kernel: Kernel, seed: list[int]) -> list[Array]:
    """Draw where the searches begin."""
    mean, deviation = kernel.prior
    random = np.random.default_rng(seed)
    return [mean + _SPREAD * deviation * random.standard_normal(mean.size) for _ in range(SURVIVORS[0])]


def _stages(n: int) -> Iterator[tuple[int, int]]:
    """Yield rows, and kernels that start, for a training set of n rows."""
    # Groups on 512 of 1,024 rows err less than one kernel on all, in equal time: 0.052 for 0.054 K.
    sizes = ROWS[:-1] if n <= MOST_GROUPED_ROWS else ROWS
    for rows, n_starts in zip(sizes, SURVIVORS, strict=False):
        yield min(n, rows), n_starts
        if rows >= n:
            return


def _most_probable(
    kernel: Kernel, features: Tensor, codes: Tensor, search: _Search, max_iterations: int
) -> tuple[float, Array]:
    """Return the smallest loss found from the start of a search, and the hyperparameters there."""
    x, known = features[search.rows], codes[search.rows, search.columns]
    total = known.square().sum()
    if total == 0.0:  # where every trajectory is the same there is nothing to learn from
        return 0.0, search.prior[0]
    # Of squares that sum up to n, as `kernel_loss` expects: a part of rows or codes has another sum.
    known = known * torch.sqrt(len(x) / total)

    def loss(hyper: Array) -> tuple[float, Array]:
        return kernel_loss(kernel, hyper, x, known, search.prior, search.n_independent)

    found = minimize(
        loss,
        search.start,
        jac=True,
        method="L-BFGS-B",
        bounds=kernel.bounds,
        options={"maxiter": max_iterations, "maxcor": N_CORRECTIONS},
    )
    return float(found.fun), np.asarray(found.x, dtype=np.float64)
