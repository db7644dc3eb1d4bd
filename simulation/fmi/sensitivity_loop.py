"""One simulation by model exchange together with its derivatives with respect to the parameters, compiled.

The states run exactly as in exchange_loop. Their derivatives S = dx/dp follow dS/dt = df/dx S + df/dp,
which is linear: behind each communication step of the states it is solved over the same step by Radau's
method, with df/dx and df/dp from the FMU's directional derivatives at its few nodes, and states in between
from CVODE's own polynomials.
"""

from typing import Any, Final

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.call import call_status, compiled
from simulation.fmi.exchange_calls import (
    SLOT,
    at_point,
    completed_step,
)
from simulation.fmi.exchange_loop import (
    BAD_CALL,
    BAD_STEP,
    ENDED,
    EPSILON,
    GOOD,
    MOST_STEPS,
    ONE_STEP,
    TOO_MANY_STEPS,
    begin,
    go_through_event,
    restart,
)
from simulation.fmi.instance import WARNING
from simulation.fmi.sensitivity_calls import (
    MOST_COEFFICIENTS,
    NOT_FINITE,
    keep_piece,
    linearize,
    read_outputs,
    states_at,
)
from simulation.fmi.sensitivity_radau import NODES, radau_step

# A way to end beside those of exchange_loop.
HAS_EVENTS: Final = 20
_MOST_RADAU_STEPS: Final = 10_000


@compiled
def simulate_sensitivities(
    table: Any,
    input_table: Any,
    inputs: FloatArray,
    output_references: Any,
    edges: FloatArray,
    output_every: int,
    rtol: float,
    x: FloatArray,
    x_between: FloatArray,
    absolute: FloatArray,
    state_references: Any,
    slope_references: Any,
    parameter_references: Any,
    knowns: Any,
    acts: Any,
    s: FloatArray,
    weights: FloatArray,
    sensitivity_rtol: float,
    y: FloatArray,
    slopes: FloatArray,
) -> tuple[int, int, int, float]:
    """Run an instance that was just initialized through the communication steps.

    Args:
        table: Addresses and counts (see exchange_calls). Shape (SLOT.SIZE,).
        input_table: What sets the inputs (see inputs). Shape (n_functions, 5), intp.
        inputs: Constant input of every step. Shape (m, n_inputs). [model's units]
        output_references: Value references. Shape (k,), uint32.
        edges: Edges of the communication steps. Shape (m + 1,). [s]
        output_every: Steps between two outputs.
        rtol: Relative tolerance of the states.
        x: States, shared with CVODE. Shape (n,).
        x_between: States inside a step, shared with CVODE. Shape (n,).
        absolute: Absolute tolerances, shared with CVODE. Shape (n,).
        state_references: Value references. Shape (n,), uint32.
        slope_references: Of the states' derivatives. Shape (n,), uint32.
        parameter_references: Value references. Shape (p,), uint32.
        knowns: For each parameter the states' references and its own, contiguous. Shape (p, n + 1), uint32.
        acts: Whether a parameter acts after the start; one that is a start value does not. Shape (p,).
        s: dx/dp at the start. Shape (n, p).
        weights: Error of each entry of S that counts as nothing. Shape (n, p).
        sensitivity_rtol: Relative tolerance of S.
        y: Filled with the outputs, contiguous. Shape (t, k). [model's units]
        slopes: Filled with their derivatives, contiguous. Shape (t, k, p). [model's units]

    Returns:
        How it ended, a detail of it, the stage (a slot) and the time. [s]
    """
    n, p = s.shape
    n_steps = edges.size - 1
    info, reached, states = np.zeros(4), np.zeros(1), np.empty(n)
    jacobians, forcings = np.zeros((4, n, n)), np.zeros((4, n, p))
    ends, coefficients, n_pieces = np.zeros(64), np.zeros((64, MOST_COEFFICIENTS, n)), 0
    time, ahead = edges[0], edges[0]
    kind, detail, stage, later = begin(table, info)
    if kind == GOOD and later <= edges[n_steps]:
        kind, time = HAS_EVENTS, later
    if kind == GOOD:
        kind, detail, stage = restart(table, time, x, absolute, rtol, True)
    if kind == GOOD:
        kind, detail, stage = read_outputs(table, output_references, knowns, acts, s, y[0], slopes[0])
    if kind != GOOD:
        return kind, detail, stage, time
    ends[0], coefficients[0, 0], n_pieces = time, x, 1
    stop_edge, knows_start, length = 0, False, edges[1] - edges[0]
    for step in range(n_steps):
        if stop_edge == step:
            stop_edge = step + 1
            while stop_edge < n_steps and np.all(inputs[stop_edge] == inputs[step]):
                stop_edge += 1
        end = edges[step + 1]
        # Of the pieces behind, only one that reaches into this step is of use.
        ends[0], coefficients[0] = ends[n_pieces - 1], coefficients[n_pieces - 1]
        n_pieces, n_internal = 1, 0
        table[SLOT.FAILED_STATUS] = 0
        table[SLOT.NOT_FINITE] = 0
        while ahead < end:
            target = edges[stop_edge]
            if target - ahead <= 100.0 * EPSILON * max(abs(ahead), abs(target)):
                ahead = target
                break
            call_status(table[SLOT.STOP_AT], (table[SLOT.SOLVER], target))
            flag = call_status(
                table[SLOT.SOLVE],
                (table[SLOT.SOLVER], target, table[SLOT.X], np.intp(reached.ctypes.data), np.int32(ONE_STEP)),
            )
            if flag < 0:
                return BAD_STEP, flag, SLOT.SOLVE, ahead
            ahead = min(reached[0], target)
            n_internal += 1
            if n_internal > MOST_STEPS:
                return TOO_MANY_STEPS, n_internal, SLOT.SOLVE, ahead
            if n_pieces == ends.size:
                ends = np.append(ends, np.zeros(n_pieces))
                coefficients = np.concatenate((coefficients, np.zeros_like(coefficients)))
            ends[n_pieces] = ahead
            keep_piece(table, ahead, x_between, coefficients[n_pieces])
            n_pieces += 1
        n_radau = 0
        while time < end:
            rest = end - time
            taken = rest if length > 0.99 * rest else length
            if not knows_start:
                states_at(time, ends, coefficients, n_pieces, states)
                kind, detail, stage = linearize(
                    table,
                    time,
                    states,
                    state_references,
                    slope_references,
                    parameter_references,
                    acts,
                    jacobians[3],
                    forcings[3],
                )
                knows_start = True
            for node in range(3):
                if kind == GOOD:
                    at = end if node == 2 and taken == rest else time + NODES[node] * taken
                    states_at(at, ends, coefficients, n_pieces, states)
                    kind, detail, stage = linearize(
                        table,
                        at,
                        states,
                        state_references,
                        slope_references,
                        parameter_references,
                        acts,
                        jacobians[node],
                        forcings[node],
                    )
            if kind != GOOD:
                return kind, detail, stage, time
            after, error = radau_step(taken, jacobians, forcings, s, weights, sensitivity_rtol)
            n_radau += 1
            if n_radau > _MOST_RADAU_STEPS:
                return NOT_FINITE, 0, SLOT.DIRECTIONAL, time
            if error <= 1.0:
                s[:] = after
                time = end if taken == rest else time + taken
                jacobians[3], forcings[3] = jacobians[2], forcings[2]
                factor = min(5.0, 0.9 * max(error, 1e-8) ** -0.25)
                # A step cut short by the edge says nothing against a longer one.
                length = max(length, taken * factor) if taken < length else taken * factor
            else:
                length = taken * max(0.1, 0.9 * error**-0.25)
        if ahead > end:
            call_status(
                table[SLOT.INTERPOLATE], (table[SLOT.SOLVER], end, np.int32(0), table[SLOT.X_BETWEEN])
            )
            states[:] = x_between
        else:
            states[:] = x
        status, stage = at_point(table, end, np.intp(states.ctypes.data))
        if status > WARNING:
            return BAD_CALL, status, stage, end
        status, asks, ends_here = completed_step(table, info)
        if status > WARNING:
            return BAD_CALL, status, SLOT.COMPLETED, end
        if ends_here:
            return ENDED, 0, SLOT.COMPLETED, end
        if asks:
            return HAS_EVENTS, 0, SLOT.COMPLETED, end
        if (step + 1) % output_every == 0:
            row = (step + 1) // output_every
            kind, detail, stage = read_outputs(table, output_references, knowns, acts, s, y[row], slopes[row])
            if kind != GOOD:
                return kind, detail, stage, end
        if step + 1 == stop_edge and stop_edge < n_steps:
            kind, detail, stage, nominals, later = go_through_event(table, info, input_table, step + 1)
            if kind == GOOD and later <= edges[n_steps]:
                return HAS_EVENTS, 0, SLOT.UPDATE_DISCRETE, later
            if kind == GOOD:
                kind, detail, stage = restart(table, end, x, absolute, rtol, nominals)
            if kind != GOOD:
                return kind, detail, stage, end
            ends[0], coefficients[0], n_pieces = end, 0.0, 1
            coefficients[0, 0] = x
            knows_start, ahead = False, end
    if not np.isfinite(slopes).all():
        return NOT_FINITE, 0, SLOT.DIRECTIONAL, edges[n_steps]
    return GOOD, 0, SLOT.DIRECTIONAL, edges[n_steps]
