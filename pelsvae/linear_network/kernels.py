"""Linear networks under constant inputs, solved step by step, and what their outputs owe to everything.

Rows lie last in every array, so that one instruction serves several of them. A forward function has an
adjoint: from the slopes of a number by the results it makes those by the arguments.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]
_Function = TypeVar("_Function", bound=Callable[..., Any])

# Terms of the exponential's series at a norm below 1/2: the next is 1e-12 of the first.
N_TERMS = 9
MOST_NORM = 0.5


def _compiled(function: _Function) -> _Function:
    """Compile a function without the interpreter's lock, from the cache on disk where there can be one."""
    compiler = njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
    try:
        return cast(_Function, compiler(function))
    except RuntimeError:  # no folder to cache in
        return cast(_Function, njit(nogil=True, fastmath=True, error_model="numpy")(function))


@_compiled
def _add_product(a: Floats, b: Floats, by_a: bool, by_b: bool, into: Floats) -> None:
    """Add the product of two matrices per row, either transposed on demand: shapes (s, s, n)."""
    s, _, n = into.shape
    for i in range(s):
        for j in range(s):
            out = into[i, j]
            for k in range(s):
                left = a[k, i] if by_a else a[i, k]
                right = b[j, k] if by_b else b[k, j]
                for row in range(n):
                    out[row] += left[row] * right[row]


@_compiled
def _add_one(matrix: Floats) -> None:
    for i in range(matrix.shape[0]):
        for row in range(matrix.shape[2]):
            matrix[i, i, row] += 1.0


@_compiled
def _add(one: Floats, into: Floats) -> None:
    for i in range(one.shape[0]):
        for j in range(one.shape[1]):
            for row in range(one.shape[2]):
                into[i, j, row] += one[i, j, row]


@_compiled
def _times(matrix: Floats, factor: float) -> None:
    s, c, n = matrix.shape
    for i in range(s):
        for j in range(c):
            for row in range(n):
                matrix[i, j, row] *= factor


@_compiled
def exponentials(a: Floats, step: float, series: Floats, doubled: Floats) -> None:
    """Put exp(a step) and its integral over a step into doubled[:, -1], by scaling and squaring.

    Args:
        a: Matrices of which the norm times step / 2^k is at most MOST_NORM. Shape (s, s, n).
        step: Length of a step.
        series: Filled with partial sums, which the adjoint needs. Shape (N_TERMS, s, s, n).
        doubled: Filled with exponentials and integrals over step / 2^k, ..., step. Shape (2, k + 1, s, s, n).
    """
    s, _, n = a.shape
    k = doubled.shape[1] - 1
    part = step / 2.0**k
    # Integral over a part / part = sum over j of (a part)^j / (j + 1)!, by Horner's rule.
    series[:] = 0.0
    _add_one(series[0])
    for term in range(1, N_TERMS):
        _add_product(a, series[term - 1], False, False, series[term])
        _times(series[term], part / (N_TERMS + 1 - term))
        _add_one(series[term])
    doubled[:] = 0.0
    for i in range(s):
        for j in range(s):
            for row in range(n):
                doubled[1, 0, i, j, row] = series[N_TERMS - 1, i, j, row] * part
    _add_product(a, doubled[1, 0], False, False, doubled[0, 0])
    _add_one(doubled[0, 0])
    for q in range(k):
        # Over twice the time: E E, and I + E I.
        _add_product(doubled[0, q], doubled[0, q], False, False, doubled[0, q + 1])
        for i in range(s):
            for j in range(s):
                for row in range(n):
                    doubled[1, q + 1, i, j, row] = doubled[1, q, i, j, row]
        _add_product(doubled[0, q], doubled[1, q], False, False, doubled[1, q + 1])


@_compiled
def exponentials_adjoint(
    a: Floats, step: float, series: Floats, doubled: Floats, by_exponential: Floats, by_integral: Floats
) -> Floats:
    """Return slopes by a. Shape (s, s, n).

    Args:
        a: As in `exponentials`.
        step: As in `exponentials`. [s]
        series: As it left them.
        doubled: As it left them.
        by_exponential: Slopes by the exponentials; overwritten. Shape (s, s, n).
        by_integral: Slopes by the integrals; overwritten. Shape (s, s, n).
    """
    k = doubled.shape[1] - 1
    part = step / 2.0**k
    held, more = np.empty_like(a), np.empty_like(a)
    for q in range(k - 1, -1, -1):
        held[:] = 0.0
        _add_product(by_exponential, doubled[0, q], False, True, held)
        _add_product(doubled[0, q], by_exponential, True, False, held)
        _add_product(by_integral, doubled[1, q], False, True, held)
        more[:] = 0.0
        _add_product(doubled[0, q], by_integral, True, False, more)
        _add(more, by_integral)
        by_exponential, held = held, by_exponential
    by_a = np.zeros_like(a)
    _add_product(by_exponential, doubled[1, 0], False, True, by_a)
    _add_product(a, by_exponential, True, False, by_integral)
    _times(by_integral, part)
    for term in range(N_TERMS - 1, 0, -1):
        _times(by_integral, part / (N_TERMS + 1 - term))
        _add_product(by_integral, series[term - 1], False, True, by_a)
        held[:] = 0.0
        _add_product(a, by_integral, True, False, held)
        by_integral, held = held, by_integral
    return by_a


@_compiled
def combine(rows: Ints, columns: Ints, factors: Floats, values: Floats, into: Floats) -> None:
    """Add a sparse matrix times values, shapes (y, n) -> (x, n): into[row] += factor values[column]."""
    for entry in range(len(rows)):
        out, value, factor = into[rows[entry]], values[columns[entry]], factors[entry]
        for row in range(into.shape[1]):
            out[row] += factor * value[row]


@_compiled
def discrete(doubled: Floats, b: Floats, exponential: Floats, gains: Floats) -> None:
    """Put what a step does to states and inputs, in single precision, behind each other as `walk` reads it.

    Single precision suffices for states: 1e-6 of their scale, and half the time.

    Args:
        doubled: Exponential and integral as `exponentials` left them. Shape (2, k + 1, s, s, r n).
        b: Inputs' gains. Shape (r, s, c, n).
        exponential: Filled: to the states i from state j. Shape (r, s of j, s of i, n).
        gains: Filled: to the states i from input c. Shape (r, c, s, n).
    """
    r, s, c, n = b.shape
    last = doubled.shape[1] - 1
    sums = np.empty(n)
    for p in range(r):
        for i in range(s):
            for j in range(s):
                for row in range(n):
                    exponential[p, j, i, row] = doubled[0, last, i, j, p * n + row]
            for k in range(c):
                sums[:] = 0.0
                for j in range(s):
                    for row in range(n):
                        sums[row] += doubled[1, last, i, j, p * n + row] * b[p, j, k, row]
                for row in range(n):
                    gains[p, k, i, row] = sums[row]


@_compiled
def discrete_adjoint(
    doubled: Floats,
    b: Floats,
    by_walk: Floats,
    by_gains: Floats,
    by_exponential: Floats,
    by_integral: Floats,
    by_b: Floats,
) -> None:
    """Turn slopes by what `discrete` fills, as `walk_adjoint` leaves them, into slopes by what it reads.

    Args:
        doubled: As in `discrete`.
        b: As in `discrete`.
        by_walk: Slopes by its exponential. Shape (r, s, s, n).
        by_gains: Slopes by its gains. Shape (r, c, s, n).
        by_exponential: Filled. Shape (s, s, r n).
        by_integral: Filled. Shape (s, s, r n).
        by_b: Filled. Shape (r, s, c, n).
    """
    r, s, c, n = b.shape
    last = doubled.shape[1] - 1
    by_integral[:] = 0.0
    by_b[:] = 0.0
    for p in range(r):
        for i in range(s):
            for j in range(s):
                for row in range(n):
                    by_exponential[i, j, p * n + row] = by_walk[p, j, i, row]
                for k in range(c):
                    for row in range(n):
                        slope = by_gains[p, k, i, row]
                        by_integral[i, j, p * n + row] += slope * b[p, j, k, row]
                        by_b[p, j, k, row] += doubled[1, last, i, j, p * n + row] * slope


@_compiled
def walk(exponential: Floats, gains: Floats, inputs: Floats, pattern: Ints, x: Floats) -> None:
    """Fill x with the states x[t + 1] = E[pattern[t]] x[t] + G[pattern[t]] u[t], from x[0] on.

    Args:
        exponential: E of each pattern of the switches, as `discrete` leaves it. Shape (r, s, s, n).
        gains: G of each. Shape (r, c, s, n).
        inputs: u in each step. Shape (m, c).
        pattern: Pattern in each step. Shape (m,).
        x: Shape (m + 1, s, n).
    """
    m, (_, s, n) = len(pattern), x.shape
    for t in range(m):
        matrix, of_inputs, out = exponential[pattern[t]], gains[pattern[t]], x[t + 1]
        out[:] = 0.0
        for k in range(inputs.shape[1]):
            value, gain = inputs[t, k], of_inputs[k]
            if value != 0.0:  # as the sun is at night
                for i in range(s):
                    for row in range(n):
                        out[i, row] += value * gain[i, row]
        for j in range(s):
            factor, state = matrix[j], x[t, j]
            for i in range(s):
                for row in range(n):
                    out[i, row] += factor[i, row] * state[row]


@_compiled
def walk_adjoint(
    exponential: Floats,
    inputs: Floats,
    pattern: Ints,
    x: Floats,
    by_x: Floats,
    by_exponential: Floats,
    by_gains: Floats,
) -> None:
    """Turn slopes by all states, held apart, into those through all later states, and those by E and G.

    Afterwards by_x[0] are the slopes by the first states.

    Args:
        exponential: As in `walk`.
        inputs: As in `walk`.
        pattern: As in `walk`.
        x: The states. Shape (m + 1, s, n).
        by_x: Slopes by each state as if it moved no later one; overwritten. Shape (m + 1, s, n).
        by_exponential: Slopes by E are added. Shape (r, s, s, n).
        by_gains: Slopes by G are added. Shape (r, c, s, n).
    """
    m, (_, s, n) = len(pattern), x.shape
    for t in range(m - 1, -1, -1):
        p, later = pattern[t], by_x[t + 1]
        for k in range(inputs.shape[1]):
            value, slope = inputs[t, k], by_gains[p, k]
            if value != 0.0:
                for i in range(s):
                    for row in range(n):
                        slope[i, row] += value * later[i, row]
        for j in range(s):
            out, factor, slope, state = by_x[t, j], exponential[p, j], by_exponential[p, j], x[t, j]
            for i in range(s):
                for row in range(n):
                    out[row] += factor[i, row] * later[i, row]
                    slope[i, row] += later[i, row] * state[row]


@_compiled
def add_rows(places: Ints, values: Floats, into: Floats) -> None:
    """Add rows of numbers where they belong: into[places[r]] += values[r]. Shapes (x, n), (y, n)."""
    for place in range(len(places)):
        for row in range(into.shape[1]):
            into[places[place], row] += values[place, row]
