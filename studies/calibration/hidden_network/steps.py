"""Networks solved exactly: a linear network under constant inputs moves by a matrix exponential.

The slopes of all outputs with respect to all couplings are solved with them.
"""

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.fmi.call import compiled

# Terms of the exponential's series below a norm of 1/2: the next is below rounding.
N_TERMS = 13


@compiled
def _exponential(
    a: FloatArray, step: float, with_slopes: bool, answer: FloatArray, slopes: FloatArray
) -> None:
    """Put exp([[a, 1], [0, 0]] step) into an array (2s, 2s), its slopes by the entries of a into another.

    The slopes, of shape (s s, 2s, 2s) and zero at first, stay zero where they are not wanted.

    By scaling and squaring (Higham 2005, doi:10.1137/04061101X), each operation with its derivative. Numbers
    are moved one by one: whole arrays in one expression took ten seconds longer to compile, in total.
    """
    s = a.shape[0]
    n, n_slopes = 2 * s, s * s if with_slopes else 0
    matrix = np.zeros((n, n))
    norm, n_squares = 0.0, 0
    for i in range(s):
        size = 0.0
        for j in range(s):
            matrix[i, j] = a[i, j] * step
            size += abs(matrix[i, j])
        matrix[i, s + i] = step
        norm = max(norm, size + abs(step))
    while norm > 0.5:
        norm *= 0.5
        n_squares += 1
    scale = 0.5**n_squares
    total, term = np.zeros((n, n)), np.zeros((n, n))
    for i in range(n):
        total[i, i] = term[i, i] = 1.0
        for j in range(n):
            matrix[i, j] *= scale
    slope = np.zeros((s * s, n, n))
    for order in range(1, N_TERMS + 1):
        for d in range(n_slopes):
            moved = slope[d] @ matrix
            for i in range(n):
                moved[i, d % s] += term[i, d // s] * (step * scale)
                for j in range(n):
                    slope[d, i, j] = moved[i, j] / order
                    slopes[d, i, j] += slope[d, i, j]
        term = term @ matrix
        for i in range(n):
            for j in range(n):
                term[i, j] /= order
                total[i, j] += term[i, j]
    for _ in range(n_squares):
        for d in range(n_slopes):
            left, right = slopes[d] @ total, total @ slopes[d]
            for i in range(n):
                for j in range(n):
                    slopes[d, i, j] = left[i, j] + right[i, j]
        total = total @ total
    for i in range(n):
        for j in range(n):
            answer[i, j] = total[i, j]


@compiled
def steps(
    start: FloatArray,
    couplings: FloatArray,
    places: IntArray,
    inputs: FloatArray,
    pattern: IntArray,
    patterns: FloatArray,
    step: float,
    every: int,
    n_outputs: int,
    with_slopes: bool,
) -> tuple[FloatArray, FloatArray]:
    """Solve the networks of all points.

    Args:
        start: First states. Shape (n, s).
        couplings: Rates, per unit of time, of which every one moves one state. Shape (n, e). [1]
        places: Of every coupling its kind (0 to another state, 1 to a potential, 2 to a source), the state
            that it moves, the other state or the input, and its switch or -1. Shape (e, 4).
        inputs: Potentials and sources, constant over each step. Shape (m, a).
        pattern: Pattern of the switches in each step. Shape (m,).
        patterns: Which switches are on. Shape (r, w).
        step: Length of a step in the unit of time. [1]
        every: Steps from one output to the next.
        n_outputs: The first states are the outputs.
        with_slopes: Whether slopes are wanted.

    Returns:
        Outputs, shape (n, 1 + m / every, k), and their slopes by couplings and first states, shape
        (n, 1 + m / every, k, e + s), with k = 0 where they are not wanted.
    """
    n, s = start.shape
    n_couplings, n_patterns, n_times = couplings.shape[1], patterns.shape[0], pattern.size // every + 1
    n_slopes = n_couplings + s
    y = np.empty((n, n_times, n_outputs))
    slopes = np.zeros((n, n_times, n_outputs if with_slopes else 0, n_slopes))
    x, flow, moved = np.empty(s), np.empty(s), np.empty(s)
    by_rate, by_coupling = np.empty((s * s, s)), np.empty((n_slopes, s))
    for point in range(n):
        rates = couplings[point]
        is_on = np.ones((n_patterns, n_couplings))
        exact, tangents = np.empty((n_patterns, 2 * s, 2 * s)), np.zeros((n_patterns, s * s, 2 * s, 2 * s))
        gains = np.zeros((n_patterns, s, inputs.shape[1]))
        for p in range(n_patterns):
            matrix = np.zeros((s, s))
            for e in range(n_couplings):
                kind, i, j, switch = places[e, 0], places[e, 1], places[e, 2], places[e, 3]
                if switch >= 0:
                    is_on[p, e] = patterns[p, switch]
                if kind == 0:
                    matrix[i, j] += rates[e] * is_on[p, e]
                if kind < 2:
                    matrix[i, i] -= rates[e] * is_on[p, e]
                if kind > 0:
                    gains[p, i, j] += rates[e] * is_on[p, e]
            _exponential(matrix, step, with_slopes, exact[p], tangents[p])
        for a in range(s):
            x[a] = start[point, a]
            for e in range(n_slopes):
                by_coupling[e, a] = 1.0 if e == n_couplings + a else 0.0
        for k in range(n_outputs):
            y[point, 0, k] = x[k]
            if with_slopes:
                for e in range(n_slopes):
                    slopes[point, 0, k, e] = by_coupling[e, k]
        for m in range(pattern.size):
            p = pattern[m]
            for a in range(s):
                total = 0.0
                for b in range(inputs.shape[1]):
                    total += gains[p, a, b] * inputs[m, b]
                flow[a] = total
            if with_slopes:
                for d in range(s * s):
                    for a in range(s):
                        total = 0.0
                        for b in range(s):
                            total += tangents[p, d, a, b] * x[b] + tangents[p, d, a, s + b] * flow[b]
                        by_rate[d, a] = total
                for e in range(n_slopes):
                    for a in range(s):
                        total = 0.0
                        for b in range(s):
                            total += exact[p, a, b] * by_coupling[e, b]
                        moved[a] = total
                    if e < n_couplings and is_on[p, e] > 0.0:
                        kind, i, j = places[e, 0], places[e, 1], places[e, 2]
                        for a in range(s):
                            gained = exact[p, a, s + i] * inputs[m, j] if kind > 0 else by_rate[i * s + j, a]
                            moved[a] += gained - by_rate[i * s + i, a] if kind < 2 else gained
                    for a in range(s):
                        by_coupling[e, a] = moved[a]
            for a in range(s):
                total = 0.0
                for b in range(s):
                    total += exact[p, a, b] * x[b] + exact[p, a, s + b] * flow[b]
                moved[a] = total
            for a in range(s):
                x[a] = moved[a]
            if (m + 1) % every == 0:
                for k in range(n_outputs):
                    y[point, (m + 1) // every, k] = x[k]
                    if with_slopes:
                        for e in range(n_slopes):
                            slopes[point, (m + 1) // every, k, e] = by_coupling[e, k]
    return y, slopes
