"""Sums of terms, solved by the classical Runge-Kutta method in compiled steps, one point after the other."""

from typing import Final

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.fmi.call import compiled

# Functions of a term, by their number; state_terms.FUNCTIONS has them for arrays.
NUMBERS: Final = {
    "": 0,
    "root": 1,
    "square": 2,
    "natural convection": 3,
    "magnitude": 4,
    "sine": 5,
    "cosine": 6,
}


@compiled
def _bent(function: int, value: float) -> float:
    """Take a function of a value."""
    size = abs(value)
    if function == 1:
        return float(np.sqrt(size) if value >= 0.0 else -np.sqrt(size))
    if function == 2:
        return value * size
    if function == 3:
        return float(value * np.cbrt(size))
    if function == 4:
        return size
    return float(np.sin(value) if function == 5 else np.cos(value))


@compiled
def _slope(
    columns: FloatArray, coefficients: FloatArray, ends: IntArray, places: IntArray, slope: FloatArray
) -> None:
    """Sum the terms of every derivative; see `steps`."""
    term = 0
    for state in range(slope.size):
        total = 0.0
        while term < ends[state]:
            # A term without difference subtracts the 0 at the end, which needs no branch.
            value = columns[places[term, 0]] - columns[places[term, 1]]
            if places[term, 2] > 0:
                value = _bent(places[term, 2], value)
            value *= coefficients[term]
            for rank in range(3, places.shape[1]):
                value *= columns[places[term, rank]]
            total += value
            term += 1
        slope[state] = total


@compiled
def steps(
    start: FloatArray,
    coefficients: FloatArray,
    driven: FloatArray,
    ends: IntArray,
    places: IntArray,
    step_s: float,
    n_parts: int,
    every: int,
) -> FloatArray:
    """Solve the equations of all points.

    Args:
        start: First states. Shape (n, s).
        coefficients: Of the terms. Shape (n, f).
        driven: Inputs, constant over each communication step. Shape (m, q).
        ends: Position after every derivative's last term. Shape (s,).
        places: Of every term where the value is, where what is subtracted from it is, the number of the
            function, and where its factors are: among states, inputs, 1 and 0. Shape (f, 3 + factors).
        step_s: Communication step. [s]
        n_parts: Steps in it.
        every: Communication steps from one output to the next.

    Returns:
        The states at the outputs, not finite from where they run away. Shape (n, 1 + m / every, s).
    """
    n, n_states = start.shape
    n_inputs = driven.shape[1]
    answer = np.full((n, 1 + driven.shape[0] // every, n_states), np.nan)
    columns = np.zeros(n_states + n_inputs + 2)
    # The constant, and what takes the place of factors that a term does not have; behind it stays the 0.
    columns[-2] = 1.0
    h = step_s / n_parts
    x, slope, total = np.empty(n_states), np.empty(n_states), np.empty(n_states)
    for point in range(n):
        x[:] = start[point]
        answer[point, 0] = x
        for step in range(driven.shape[0]):
            for one in range(n_inputs):
                columns[n_states + one] = driven[step, one]
            for _ in range(n_parts):
                columns[:n_states] = x
                _slope(columns, coefficients[point], ends, places, slope)
                total[:] = slope
                # Classical Runge-Kutta: four slopes, at the start, twice
                # at half a step and at its end, count 1, 2, 2, 1 sixths.
                for weight, reach in ((2.0, 0.5), (2.0, 0.5), (1.0, 1.0)):
                    for state in range(n_states):
                        columns[state] = x[state] + reach * h * slope[state]
                    _slope(columns, coefficients[point], ends, places, slope)
                    for state in range(n_states):
                        total[state] += weight * slope[state]
                for state in range(n_states):
                    x[state] += h / 6.0 * total[state]
            if (step + 1) % every == 0:
                answer[point, (step + 1) // every] = x
                # States that run away do not come back: the rest of the answer stays NaN.
                if not np.isfinite(x).all():
                    break
    return answer
