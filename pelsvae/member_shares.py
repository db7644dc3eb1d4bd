"""How much each member of a mean counts in each principal coordinate, by rows that none was trained on."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

from pelsvae.standardize import Array

# As so many rows counts the belief that a share is what it would be without validation: few rows then move
# little, and of ten the shares are not worse than without.
# Shares so found: 0.518 and 0.433 K on the office at n = 64, before 0.529 and 0.497.
BELIEF = 30.0
_LEAST_NOISE = 1e-10  # in what all members leave; below, their squares are singular to all digits
_LEAST = 0.01  # share below which a member is left out of a code
# Leaving them out one by one gave 0 to 1 % less error, within chance.
_KEPT = 2.0 / 3.0  # of the members that remain when some are left out: the others' worth changes with it


class Shares(NamedTuple):
    """Members that are worth their cost, and what they count.

    Attributes:
        members: Their places. Shape (m,).
        share: Sums to 1 over the members in each code. Shape (m, z).
    """

    members: npt.NDArray[np.int64]
    share: Array


def best_shares(predicted: Array, true: Array, believed: Array, n_most: int) -> Shares:
    """Choose members and shares, not negative, that make the mean's squared error small.

    Args:
        predicted: Each member's codes. Shape (m, b, z). [1]
        true: The codes. Shape (b, z). [1]
        believed: Shares without validation, which sum to 1 in each code. Shape (m, z).
        n_most: Members that may remain.

    Returns:
        Those that matter most.
    """
    left = true - predicted  # (m, b, z)
    members = np.arange(len(left))
    while True:
        share = np.stack(
            [_of_code(left[members, :, j], believed[members, j]) for j in range(left.shape[2])], 1
        )
        if len(members) <= n_most:
            used = share.max(axis=1) > 0.0
            return Shares(members[used], share[used])
        error = np.square(np.einsum("mbz,mz->bz", left[members], share)).mean(axis=0)
        order = np.argsort(-(share @ error), kind="stable")
        members = np.sort(members[order[: max(n_most, int(_KEPT * len(members)))]])


def _of_code(left: Array, believed: Array) -> Array:
    """Return one code's shares: what the members leave of it (m, b), and the belief (m,) -> (m,).

    Shares that sum to 1 make the problem homogeneous; any weight of their sum then gives the same direction.
    """
    m = len(left)
    total = believed.sum()
    believed = believed / total if total > 0.0 else np.full(m, 1.0 / m)
    # The error of the believed mean is the unit, so a row and a row's worth of belief count alike.
    noise = max(float(np.square(believed @ left).mean()), _LEAST_NOISE * float(np.square(left).mean()))
    if noise <= 0.0:
        return believed
    away = np.eye(m) - np.outer(believed, np.ones(m))
    square = left @ left.T / noise + BELIEF * (away.T @ away)
    # The weight of the sum: as large as the mean of the diagonal, so the factor is no worse conditioned.
    square += np.trace(square) / m
    factor = np.linalg.cholesky(square)
    # The sum's weight is in the square; its right side is a vector of equal numbers, whichever.
    share, _ = nnls(factor.T, np.linalg.solve(factor, np.ones(m)), maxiter=100 * m)
    share = np.where(share < _LEAST * share.sum(), 0.0, share)
    normal: Array = share / share.sum()
    return normal
