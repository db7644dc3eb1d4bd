"""Compiled steps of equations: Runge-Kutta steps with changes of switches, and steps of linear equations."""

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.fmi.call import compiled

# Changes within a step beyond which a switch never comes to rest, and guesses at the time of one.
MOST_CHANGES_AT_ONCE, MOST_GUESSES = 100, 60
# A change is found to this part of a step. Rounding.
SAME_MOMENT = 1e-9
# Below a norm of 1/2 the next term of the series is less than rounding.
N_TERMS = 13
SOLVED = ("root", "square", "natural convection", "magnitude", "sine", "cosine")
"""Functions of `terms.FUNCTIONS` that steps take, by the number of each from 1 on."""
# Up to so many states a call of BLAS takes longer than the product itself (4.3 instead of 2.3 us with four).
SMALL = 8


# Element by element: an assignment of whole arrays takes a second or more to compile.


@compiled
def _put(into: FloatArray, values: FloatArray) -> None:
    """Write values into the first elements of an array."""
    for place in range(values.size):
        into[place] = values[place]


@compiled
def _sum(into: FloatArray, values: FloatArray, more: float) -> None:
    """Write values plus a number into an array."""
    for place in range(values.size):
        into[place] = values[place] + more


@compiled
def _are_finite(values: FloatArray) -> bool:
    n_finite = 0
    for value in values:
        n_finite += 1 if np.isfinite(value) else 0
    return n_finite == values.size


@compiled
def _fill(into: FloatArray, value: float) -> None:
    """Write a value into an array."""
    for place in range(into.size):
        into[place] = value


@compiled
def _bent(function: int, value: float) -> float:
    """Take a function of a value, by its place from 1 on in `SOLVED`; NaN beyond."""
    size = abs(value)
    if function == 1:
        return float(np.sqrt(size) if value >= 0.0 else -np.sqrt(size))
    if function == 2:
        return value * size
    if function == 3:
        return float(value * np.cbrt(size))
    if function == 4:
        return size
    if function == 5:
        return float(np.sin(value))
    return float(np.cos(value)) if function == 6 else np.nan


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
def _advance(
    x: FloatArray,
    h: float,
    columns: FloatArray,
    coefficients: FloatArray,
    ends: IntArray,
    places: IntArray,
    slope: FloatArray,
    total: FloatArray,
) -> None:
    """Move the states on by one classical Runge-Kutta step of length h; see `steps`."""
    n_states = x.size
    _put(columns, x)
    _slope(columns, coefficients, ends, places, slope)
    _put(total, slope)
    # Four slopes, at the start, twice at half a step and at its end, count 1, 2, 2, 1 sixths.
    for weight, reach in ((2.0, 0.5), (2.0, 0.5), (1.0, 1.0)):
        for state in range(n_states):
            columns[state] = x[state] + reach * h * slope[state]
        _slope(columns, coefficients, ends, places, slope)
        for state in range(n_states):
            total[state] += weight * slope[state]
    for state in range(n_states):
        x[state] += h / 6.0 * total[state]
    _put(columns, x)


@compiled
def _nearest_change(
    columns: FloatArray, since: FloatArray, rules: IntArray, limits: FloatArray
) -> tuple[int, float]:
    """Return the rule that is nearest to a change of its switch, and by how much it is beyond that.

    Args:
        columns: States, inputs, 1 and 0. Shape (s + q + 2,).
        since: Time since each state changed, if it is a switch. Shape (s,). [s]
        rules: See `steps`. Shape (r, 5).
        limits: Thresholds of the rules and then shortest times between changes. Shape (2 r,).
    """
    nearest, most = 0, -np.inf
    for rule in range(rules.shape[0]):
        switch = rules[rule, 0]
        if columns[switch] != rules[rule, 1]:
            continue
        shown = columns[rules[rule, 2]] - columns[rules[rule, 3]]
        beyond = rules[rule, 4] * (shown - limits[rule])
        shortest = limits[rules.shape[0] + rule]
        if shortest > 0.0:
            beyond = min(beyond, since[switch] - shortest)
        if beyond > most:
            nearest, most = rule, beyond
    return nearest, most


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
    rules: IntArray,
) -> FloatArray:
    """Solve the equations of all points.

    Args:
        start: First states. Shape (n, s).
        coefficients: Of the terms, then the rules' thresholds, and then the shortest times between changes
            of their switches, 0 for none. Shape (n, f + 2 r).
        driven: Inputs, constant over each communication step. Shape (m, q).
        ends: Position after every derivative's last term. Shape (s,).
        places: Of every term where the value is, where what is subtracted from it is, the number of the
            function or 0, and where its factors are: among states, inputs, 1 and 0. Shape (f, 3 + factors).
        step_s: Communication step. [s]
        n_parts: Steps in it.
        every: Communication steps from one output to the next.
        rules: When switches change, which are states of 0 or 1: where the switch is, its position before,
            where the value is and what is subtracted from it, and 1 or -1 where it changes above or below
            its threshold. Shape (r, 5).

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
    before, since, since_then = np.empty(n_states), np.empty(n_states), np.empty(n_states)
    for point in range(n):
        _put(x, start[point])
        _fill(since, 0.0)
        _put(answer[point, 0], x)
        terms, limits = coefficients[point, : ends[-1]], coefficients[point, ends[-1] :]
        for step in range(driven.shape[0]):
            for one in range(n_inputs):
                columns[n_states + one] = driven[step, one]
            for _ in range(n_parts):
                if rules.shape[0] == 0:
                    _advance(x, h, columns, terms, ends, places, slope, total)
                    continue
                left, n_changes = h, 0
                _put(columns, x)
                while left > 0.0:
                    rule, beyond = _nearest_change(columns, since, rules, limits)
                    if beyond > 0.0:
                        x[rules[rule, 0]] = columns[rules[rule, 0]] = 1.0 - x[rules[rule, 0]]
                        since[rules[rule, 0]] = 0.0
                        n_changes += 1
                        if n_changes > MOST_CHANGES_AT_ONCE:
                            _fill(x, np.nan)
                            break
                        continue
                    _put(before, x)
                    _put(since_then, since)
                    _advance(x, left, columns, terms, ends, places, slope, total)
                    _sum(since, since_then, left)
                    _, beyond_then = _nearest_change(columns, since, rules, limits)
                    if not beyond_then > 0.0:
                        break
                    # The change lies within the step: regula falsi, of which a side that
                    # stays counts half (Illinois; Dowell and Jarratt 1971, doi:10.1007/BF01934364).
                    low, high, at_low, at_high, side = 0.0, left, beyond, beyond_then, 0
                    for _ in range(MOST_GUESSES):
                        if high - low <= SAME_MOMENT * h:
                            break
                        guess = high - (high - low) * at_high / (at_high - at_low)
                        # A guess at an end of the bracket would leave the bracket as it is.
                        guess = min(max(guess, low + 0.5 * SAME_MOMENT * h), high - 0.5 * SAME_MOMENT * h)
                        _put(x, before)
                        _advance(x, guess, columns, terms, ends, places, slope, total)
                        _sum(since, since_then, guess)
                        _, at_guess = _nearest_change(columns, since, rules, limits)
                        if at_guess > 0.0:
                            high, at_high = guess, at_guess
                            at_low *= 0.5 if side == 1 else 1.0
                            side = 1
                        else:
                            low, at_low = guess, at_guess
                            at_high *= 0.5 if side == -1 else 1.0
                            side = -1
                    _put(x, before)
                    _advance(x, high, columns, terms, ends, places, slope, total)
                    _sum(since, since_then, high)
                    left -= high
            if (step + 1) % every == 0:
                _put(answer[point, (step + 1) // every], x)
                # States that run away do not come back: the rest of the answer stays NaN.
                if not _are_finite(x):
                    break
    return answer


@compiled
def _product(a: FloatArray, b: FloatArray, into: FloatArray) -> None:
    """Write a product of square matrices into a third one."""
    n = a.shape[0]
    if n > SMALL:
        np.dot(a, b, into)
        return
    for i in range(n):
        _fill(into[i], 0.0)
        for k in range(n):
            for j in range(n):
                into[i, j] += a[i, k] * b[k, j]


@compiled
def exponentials(equations: FloatArray) -> FloatArray:
    """Return how states and constant inputs move states over a step.

    These are exp(A) and phi(A) B of dx = A x + B u, times the step. phi(A) is A^-1 (exp(A) - 1):
    a series where A is small, then doubled (Higham 2008, Functions of Matrices, 10.7.4).

    Args:
        equations: A and B side by side, times the step, of n points. Finite. Shape (n, s, s + q). [1]

    Returns:
        Both side by side. Shape (n, s, s + q). [1]
    """
    n, s, width = equations.shape
    answer = np.empty((n, s, width))
    a, phi, whole, product = np.empty((s, s)), np.empty((s, s)), np.empty((s, s)), np.empty((s, s))
    for point in range(n):
        norm, n_doublings = 0.0, 0
        for i in range(s):
            size = 0.0
            for j in range(s):
                size += abs(equations[point, i, j])
            norm = max(norm, size)
        # What overflows ends as what is not finite.
        while 0.5 < norm < np.inf:
            norm *= 0.5
            n_doublings += 1
        for i in range(s):
            for j in range(s):
                a[i, j] = equations[point, i, j] * 0.5**n_doublings
                phi[i, j] = 1.0 if i == j else 0.0
        for term in range(N_TERMS, 0, -1):
            _product(a, phi, product)
            for i in range(s):
                for j in range(s):
                    phi[i, j] = product[i, j] / (term + 1.0)
                phi[i, i] += 1.0
        _product(a, phi, whole)
        for i in range(s):
            whole[i, i] += 1.0
        for _ in range(n_doublings):
            _product(whole, phi, product)
            for i in range(s):
                for j in range(s):
                    phi[i, j] = 0.5 * (phi[i, j] + product[i, j])
            _product(whole, whole, product)
            _put(whole.reshape(-1), product.reshape(-1))
        for i in range(s):
            _put(answer[point, i], whole[i])
            for j in range(s, width):
                moved = 0.0
                for k in range(s):
                    moved += phi[i, k] * equations[point, k, j]
                answer[point, i, j] = moved
    return answer


@compiled
def linear_steps(states: FloatArray, own: FloatArray, mode_of: IntArray) -> None:
    """Move states of n points by one matrix product and one shift per step, in place.

    A point's sums are in the order of the states, so that its digits do not depend on the points beside.

    Args:
        states: The first states, then what inputs add in every step, which become the states after it. Shape
            (m + 1, s, n).
        own: Matrices, by mode, state and changed state. Shape (w, s, s, n). [1]
        mode_of: Mode of every step. Shape (m,).
    """
    n_all, n_states, n = states.shape
    total = np.empty(n)
    for step in range(n_all - 1):
        mode = mode_of[step]
        for moved in range(n_states):
            for point in range(n):
                total[point] = own[mode, 0, moved, point] * states[step, 0, point]
            for state in range(1, n_states):
                for point in range(n):
                    total[point] += own[mode, state, moved, point] * states[step, state, point]
            for point in range(n):
                states[step + 1, moved, point] += total[point]
