"""What the sensitivity loop asks of CVODE and of the FMU, compiled: states inside a step, and slopes."""

from typing import Any, Final

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.call import call_status, compiled
from simulation.fmi.exchange_calls import SLOT, at_point, directional_derivative, get_real
from simulation.fmi.exchange_loop import BAD_CALL, GOOD
from simulation.fmi.instance import WARNING

NOT_FINITE: Final = 21  # a directional derivative, beside the ways to end of exchange_loop
MOST_COEFFICIENTS: Final = 6


@compiled
def states_at(
    time: float, ends: FloatArray, coefficients: FloatArray, n_pieces: int, states: FloatArray
) -> None:
    """Evaluate CVODE's polynomials, each good up to its end."""
    piece = 0
    while piece < n_pieces - 1 and ends[piece] < time:
        piece += 1
    for i in range(states.size):
        value = 0.0
        for k in range(MOST_COEFFICIENTS - 1, -1, -1):
            value = value * (time - ends[piece]) + coefficients[piece, k, i]
        states[i] = value


@compiled
def keep_piece(table: Any, time: float, scratch: FloatArray, coefficients: FloatArray) -> None:
    """Take the Taylor coefficients of the step that CVODE has just done, at its end."""
    order = np.zeros(1, dtype=np.int32)
    call_status(table[SLOT.LAST_ORDER], (table[SLOT.SOLVER], np.intp(order.ctypes.data)))
    coefficients[:] = 0.0
    factorial = 1.0
    for k in range(min(order[0], MOST_COEFFICIENTS - 1) + 1):
        factorial *= max(k, 1)
        call_status(table[SLOT.INTERPOLATE], (table[SLOT.SOLVER], time, np.int32(k), table[SLOT.X_BETWEEN]))
        coefficients[k] = scratch / factorial


@compiled
def linearize(
    table: Any,
    time: float,
    states: FloatArray,
    state_references: Any,
    slope_references: Any,
    parameter_references: Any,
    acts: Any,
    jacobian: FloatArray,
    forcing: FloatArray,
) -> tuple[int, int, int]:
    """Fill df/dx, shape (n, n), and df/dp, shape (n, p), at a time and its states; kind, detail, stage."""
    n, p = forcing.shape
    seed, column = np.ones(1), np.empty(n)
    slopes, out = np.intp(slope_references.ctypes.data), np.intp(column.ctypes.data)
    known, width = np.intp(state_references.ctypes.data), state_references.itemsize
    status, stage = at_point(table, time, np.intp(states.ctypes.data))
    if status > WARNING:
        return BAD_CALL, status, stage
    for i in range(n):
        status = directional_derivative(
            table, slopes, n, known + i * width, 1, np.intp(seed.ctypes.data), out
        )
        if status > WARNING:
            return BAD_CALL, status, SLOT.DIRECTIONAL
        jacobian[:, i] = column
    known = np.intp(parameter_references.ctypes.data)
    for c in range(p):
        column[:] = 0.0
        if acts[c]:
            status = directional_derivative(
                table, slopes, n, known + c * width, 1, np.intp(seed.ctypes.data), out
            )
            if status > WARNING:
                return BAD_CALL, status, SLOT.DIRECTIONAL
        forcing[:, c] = column
    if not (np.isfinite(jacobian).all() and np.isfinite(forcing).all()):
        return NOT_FINITE, 0, SLOT.DIRECTIONAL
    return GOOD, 0, SLOT.DIRECTIONAL


@compiled
def read_outputs(
    table: Any,
    output_references: Any,
    knowns: Any,
    acts: Any,
    s: FloatArray,
    y: FloatArray,
    slopes: FloatArray,
) -> tuple[int, int, int]:
    """Fill one time's outputs, shape (k,), and their derivatives, shape (k, p); kind, detail, stage.

    knowns: one row per parameter, the states' references and then the parameter's. Shape (p, n + 1), uint32.
    """
    k, p = slopes.shape
    n = s.shape[0]
    seed, column = np.empty(n + 1), np.empty(k)
    outputs, out = np.intp(output_references.ctypes.data), np.intp(column.ctypes.data)
    status = get_real(table, outputs, k, np.intp(y.ctypes.data))
    if status > WARNING:
        return BAD_CALL, status, SLOT.GET_REAL
    for c in range(p):
        seed[:n] = s[:, c]
        seed[n] = 1.0
        known = np.intp(knowns.ctypes.data) + c * (n + 1) * knowns.itemsize
        status = directional_derivative(
            table, outputs, k, known, n + (1 if acts[c] else 0), np.intp(seed.ctypes.data), out
        )
        if status > WARNING:
            return BAD_CALL, status, SLOT.DIRECTIONAL
        slopes[:, c] = column
    return GOOD, 0, SLOT.DIRECTIONAL
