"""Which of the terms make up a derivative or an output: sparse regression over several simulations at once.

The derivatives that an FMU answers belong exactly to the states that it answers, so terms are complete where
next to nothing is left. The search is orthogonal least squares (Chen, Billings and Luo 1989,
doi:10.1080/00207178908953472), as in the sparse identification of dynamics (Brunton, Proctor and Kutz 2016,
doi:10.1073/pnas.1517384113).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.state_equations.terms import TINY, Term

# Sums of squares, as a share of the derivative's, that a complete sum of terms leaves.
# Where equations exist, fits explained 13 digits or more of the squares, else
# two at most: no tuning is needed (docs/notes/state-equations.md, First form).
COMPLETE = 1e-16
# Above, they are looked for once more.
NEARLY_COMPLETE = 1e-14
# Squared sine between two columns below which they are one.
SAME_TERM = 1e-10
# A term without which less than this is left is none.
NEEDLESS = 1e-10
# A sum of more terms is none that a person wrote; the largest of the models tried has ten.
MOST_TERMS = 16
# So many candidates, at twice as many times, are looked at all at once.
MOST_AT_ONCE = 200
# What is left of a column's square, of size 1, below which subtracted squares are rounding.
# Half of a number's 16 digits, less those that sixteen differences cost.
CANCELLED = 1e-6
# What is left of a column of size 1 beside others, at least.
LEAST_PIVOT = 1e-13


@np.errstate(all="ignore")
def chosen_terms(terms: Sequence[Term], values: FloatArray, target: FloatArray) -> tuple[list[int], float]:
    """Choose the fewest terms that make up a target in every row, each row with coefficients of its own.

    They are chosen one after the other; where those are not all, once more from the two that explain most
    together, of which neither may explain much alone. Where these are not all either and candidates are few,
    as in a large network, needless ones are taken away from all of them.

    Args:
        terms: The f candidates, the last of them the constant.
        values: Their values. Shape (n, t, f).
        target: Shape (n, t).

    Returns:
        Their positions, and what they leave of the target's squares, mean over rows. [1]
    """
    # A derivative that is always zero has nothing to explain: a constant, whose coefficient is zero.
    if not target.any():
        return [len(terms) - 1], 0.0
    # Columns of length 1: terms of any unit compare, and products of columns are cosines.
    norm = np.sqrt(np.square(values).sum(axis=1, keepdims=True))
    values = values / np.where(norm > 0.0, norm, 1.0)
    # A term that is not finite everywhere is none.
    values[..., ~np.isfinite(values).all(axis=(0, 1))] = 0.0
    chosen, left = _added(values, target, [])
    # One by one, x y and y were missed among 64 terms and six others taken; as a pair
    # they are found (docs/notes/state-equations.md, Functions and compiled steps).
    if left > NEARLY_COMPLETE and len(terms) > 2 and (pair := _best_pair(values, target)):
        chosen, left = min((chosen, left), _added(values, target, pair), key=lambda one: one[1])
    # Of a room with ten terms, sixteen that were added one by one left 8e-5 of the
    # squares; this leaves 1e-28 (docs/notes/state-equations.md, Weather inside the FMU).
    if left > NEARLY_COMPLETE and MOST_TERMS < len(terms) <= min(MOST_AT_ONCE, target.shape[1] // 2):
        again, left_again = _taken_away(values, target)
        if left_again < left and len(again) <= MOST_TERMS:
            chosen, left = again, left_again
    return chosen, left


def _taken_away(values: FloatArray, target: FloatArray) -> tuple[list[int], float]:
    """Take needless terms away from all; return the others and what they leave."""
    n = values.shape[2]
    # Of every row a square matrix and as many numbers are enough.
    pairs = [np.linalg.qr(one) for one in values]
    columns = np.array([triangle for _, triangle in pairs])
    goals = np.array([axes.T @ goal for (axes, _), goal in zip(pairs, target, strict=True)])
    size = np.square(target).sum(axis=1) + TINY
    # What lies outside of all terms is lost in the projection, and is added to all that is left later.
    out_of_reach = np.maximum(1.0 - np.square(goals).sum(axis=1) / size, 0.0).mean()

    def left_by(chosen: list[int]) -> tuple[float, FloatArray]:
        """Return what terms leave of the squares, and how much more each of them would, taken away."""
        left, more = _more_without(columns[..., chosen], goals, size)
        return float(out_of_reach + left), more

    chosen = list(range(n))
    left, more = left_by(chosen)
    # What all terms together leave is the error of the data, below which fewer terms cannot come.
    limit = max(NEEDLESS, 10.0 * left)
    # Halves first: one by one it would take as many factorizations as there are terms.
    n_away = n // 2
    while len(chosen) > 1 and n_away:
        order = np.argsort(more, kind="stable")
        fewer = [chosen[rank] for rank in sorted(order[n_away:].tolist())]
        left, more_then = left_by(fewer)
        if left <= limit:
            chosen, more = fewer, more_then
            n_away = min(n_away, len(chosen) // 2)
        else:
            n_away //= 2
    chosen = _without_needless(values, target, chosen)
    return chosen, unexplained(values, target, chosen)


def _added(values: FloatArray, target: FloatArray, begun: list[int]) -> tuple[list[int], float]:
    """Add terms to those that are begun with, take needless ones away; return them and what they leave."""
    size = np.square(target).sum(axis=1) + TINY
    chosen, left, axes = list[int](), target.copy(), values[..., :0]
    squares = np.square(values).sum(axis=1)
    while len(chosen) < min(MOST_TERMS, values.shape[2], target.shape[1] - 1):
        if len(chosen) < len(begun):
            best = begun[len(chosen)]
        else:
            # What is left of a column after those before it is rounding.
            is_new = squares > 1e-20
            # What is left of the target is orthogonal to the axes: its products
            # with columns are those with what is left of these, which is never made.
            along = np.square(left[:, None] @ values)[:, 0]
            gain = np.where(is_new, along, 0.0) / np.where(is_new, squares, 1.0)
            share = (gain / size[:, None]).mean(axis=0)
            # Rounding leaves a direction to columns that were chosen; they must not be chosen again.
            share[chosen] = -1.0
            best = int(np.argmax(share))
            if share[best] <= 0.0:
                break
        chosen.append(best)
        axis = _beside(axes, values[..., [best]])
        axis /= np.sqrt(np.maximum(np.square(axis).sum(axis=1, keepdims=True), 1e-300))
        axes = np.concatenate([axes, axis], axis=2)
        left = _beside(axes, left[..., None])[..., 0]
        squares = squares - np.square(axis.transpose(0, 2, 1) @ values)[:, 0]
        # A difference of nearly equal squares is rounding: these few columns are projected.
        few = np.flatnonzero((squares < CANCELLED).any(axis=0))
        squares[:, few] = np.square(_beside(axes, values[..., few])).sum(axis=1)
        # Only a fit of its own resolves 16 digits.
        is_near = float((np.square(left).sum(axis=1) / size).mean()) <= NEARLY_COMPLETE
        if is_near and unexplained(values, target, chosen) <= COMPLETE:
            break
    chosen = _without_needless(values, target, chosen or [values.shape[2] - 1])
    return chosen, unexplained(values, target, chosen)


def _beside(axes: FloatArray, columns: FloatArray) -> FloatArray:
    """Return what is left of columns (n, t, f) beside orthonormal axes (n, t, k). Shape (n, t, f)."""
    # Twice is enough for all digits.
    # (Gram-Schmidt, repeated once: Giraud and others 2005, doi:10.1007/s00211-005-0615-4.)
    for _ in range(2):
        columns = columns - axes @ (axes.transpose(0, 2, 1) @ columns)
    return columns


def _best_pair(values: FloatArray, target: FloatArray) -> list[int]:
    """Return the two terms (n, t, f) that explain most of a target (n, t) together, mean over rows."""
    explained = np.zeros((values.shape[2],) * 2)
    for columns, goal in zip(values, target, strict=True):
        along = goal @ columns / np.sqrt(goal @ goal + TINY)
        explained += np.minimum(explained_by_pairs(columns, along, alike=0.0), 1.0)
    first, second = np.unravel_index(int(np.argmax(explained)), explained.shape)
    return [int(first), int(second)] if explained[first, second] > 0.0 else []


def explained_by_pairs(columns: FloatArray, along: FloatArray, *, alike: float) -> FloatArray:
    """Return the squares that all pairs of columns of length 1 explain together. Shape (f, f).

    Args:
        columns: Shape (t, f).
        along: Products of the columns and what is explained. Shape (f,).
        alike: What counts as explained by two that are one.
    """
    cosines = columns.T @ columns
    sines = 1.0 - cosines**2
    # (a² + b² - 2 a b c) / (1 - c²), c being their cosine; in place, as there may be millions of pairs.
    both = along[:, None] ** 2 + along**2
    cosines *= 2.0 * np.outer(along, along)
    both -= cosines
    explained: FloatArray = np.full_like(both, alike)
    return np.divide(both, sines, out=explained, where=sines > SAME_TERM)


class Fit(NamedTuple):
    """Terms fitted to one row.

    Attributes:
        found: Coefficients. Shape (f,).
        deviation: Their standard deviations, as shares of themselves. Shape (f,). [1]
        left: What they leave of the target's squares. [1]
    """

    found: FloatArray
    deviation: FloatArray
    left: float


def fitted(values: FloatArray, target: FloatArray) -> Fit:
    """Fit terms, values of shape (t, f), to one row's target (t,)."""
    with np.errstate(all="ignore"):
        norm = np.sqrt(np.square(values).sum(axis=0))
        if not (np.isfinite(norm).all() and np.isfinite(target).all()):
            return Fit(np.zeros(len(norm)), np.full(len(norm), np.inf), np.inf)
        norm[norm == 0.0] = 1.0
        scaled = values / norm
        # By singular values: normal equations would square the condition, and lose half of the digits.
        left_vectors, sizes, right = np.linalg.svd(scaled, full_matrices=False)
        # Terms that cannot be separated get a huge but finite
        # deviation, which marks their coefficients as open.
        inverse = right.T / np.maximum(sizes, np.finfo(float).eps * max(float(sizes[0]), 1.0))
        found = inverse @ (left_vectors.T @ target)
        rest = float(np.square(target - scaled @ found).sum())
        # Standard deviation of least squares: root of the diagonal of the
        # inverse normal matrix times the variance that is left.
        deviation = np.sqrt(np.square(inverse).sum(axis=1) * rest / max(len(target) - len(norm), 1))
        share = deviation / (np.abs(found) + TINY)
        return Fit(found / norm, share, rest / (float(np.square(target).sum()) + TINY))


def unexplained(values: FloatArray, target: FloatArray, chosen: Sequence[int]) -> float:
    """Return what chosen terms of (n, t, f) leave of a target's (n, t) squares, mean over rows. [1]."""
    picked = values[..., list(chosen)]
    return float(np.mean([fitted(one, goal).left for one, goal in zip(picked, target, strict=True)]))


def _more_without(columns: FloatArray, goals: FloatArray, size: FloatArray) -> tuple[float, FloatArray]:
    """Return what terms leave of a target's squares, and how much more without each of them, means over rows.

    Args:
        columns: The terms. Shape (n, t, f).
        goals: The target. Shape (n, t).
        size: Squares of which shares are taken. Shape (n,).

    Returns:
        The share that all of them leave, and how much more is left without each. Shape (f,). [1]
    """
    axes, triangle = np.linalg.qr(columns)
    diagonal = np.arange(columns.shape[2])
    pivots = triangle[:, diagonal, diagonal]
    # A column that others make up has a pivot of rounding, or of zero; the inverse has to exist.
    triangle[:, diagonal, diagonal] = np.where(np.abs(pivots) < LEAST_PIVOT, LEAST_PIVOT, pivots)
    inverse = np.linalg.inv(triangle)
    along = np.einsum("nij,ni->nj", axes, goals)
    found = np.einsum("nij,nj->ni", inverse, along)
    # Without a term, squares grow by its coefficient squared over its diagonal
    # of the inverse normal matrix: one factorization judges all terms.
    more = np.square(found) / np.square(inverse).sum(axis=2) / size[:, None]
    left = (np.square(goals).sum(axis=1) - np.square(along).sum(axis=1)) / size
    return float(np.maximum(left, 0.0).mean()), more.mean(axis=0)


def _without_needless(values: FloatArray, target: FloatArray, chosen: list[int]) -> list[int]:
    limit = max(NEEDLESS, 10.0 * unexplained(values, target, chosen))
    size = np.square(target).sum(axis=1) + TINY
    while len(chosen) > 1:
        _, more = _more_without(values[..., chosen], target, size)
        least = int(np.argmin(more))
        without = chosen[:least] + chosen[least + 1 :]
        if unexplained(values, target, without) > limit:
            break
        chosen = without
    return chosen
