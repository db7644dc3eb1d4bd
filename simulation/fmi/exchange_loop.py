"""One simulation by model exchange, compiled: CVODE between the points where an input or an event breaks in.

The inputs are constant between two points, so the model is smooth there; at each point where one changes the
model goes through an event and CVODE starts anew, for what it knows of the past no longer holds. Between such
points it runs on, stopped at the next one, and outputs in between come from its own interpolation.
"""

from typing import Any, Final

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.call import call_status, compiled
from simulation.fmi.exchange_calls import (
    SLOT,
    at_point,
    completed_step,
    get_real,
    get_states,
    set_inputs,
    update_discrete_states,
)
from simulation.fmi.instance import WARNING

# How a simulation ends.
GOOD: Final = 0
BAD_CALL: Final = 1  # a function of the FMU returned a bad status
BAD_STEP: Final = 2  # CVODE gave up; the detail is its flag
TOO_MANY_STEPS: Final = 3
TOO_MANY_EVENTS: Final = 4
ENDED: Final = 5  # the FMU asked to end the simulation
ENDLESS_ITERATION: Final = 6
BAD_START: Final = 7  # a state is no finite number; the detail is its index
STUCK: Final = 8  # steps became too small to move the time

# Internal steps and events in one communication step, and iterations in one event, before a simulation is
# given up: no model hangs silently.
MOST_STEPS: Final = 100_000
MOST_EVENTS: Final = 10_000
MOST_ITERATIONS: Final = 1_000
# Successive steps too small to move the time.
MOST_STUCK: Final = 100

ONE_STEP: Final = 2
_ROOT_RETURN: Final = 2
EPSILON: Final = 2.0**-52


@compiled
def _iterate(table: Any, info: FloatArray) -> tuple[int, int, bool, bool, float]:
    """Settle the discrete states of an event; kind, detail, nominals and values changed, next time event."""
    nominals, values = False, False
    for _ in range(MOST_ITERATIONS):
        status, again, end, nominals_now, values_now, later = update_discrete_states(table, info)
        nominals, values = nominals or nominals_now, values or values_now
        if status > WARNING:
            return BAD_CALL, status, nominals, values, later
        if end:
            return ENDED, 0, nominals, values, later
        if not again:
            return GOOD, 0, nominals, values, later
    return ENDLESS_ITERATION, 0, nominals, values, np.inf


@compiled
def begin(table: Any, info: FloatArray) -> tuple[int, int, int, float]:
    """Go from the end of the initialization to continuous time; kind, detail, stage, next time event."""
    kind, detail, _, _, later = _iterate(table, info)
    if kind != GOOD:
        return kind, detail, SLOT.UPDATE_DISCRETE, later
    status = call_status(table[SLOT.ENTER_CONTINUOUS], (table[SLOT.COMPONENT],))
    return (BAD_CALL if status > WARNING else GOOD), status, SLOT.ENTER_CONTINUOUS, later


@compiled
def restart(
    table: Any, time: float, x: FloatArray, absolute: FloatArray, rtol: float, nominals: bool
) -> tuple[int, int, int]:
    """Take the states, and the nominal values where they changed, from the FMU and start CVODE anew."""
    if table[SLOT.N_STATES] > 0:
        status = get_states(table, SLOT.GET_STATES, np.intp(x.ctypes.data))
        if status > WARNING:
            return BAD_CALL, status, SLOT.GET_STATES
        for index in range(x.size):
            if not np.isfinite(x[index]):
                return BAD_START, index, SLOT.GET_STATES
        if nominals:
            status = get_states(table, SLOT.GET_NOMINALS, np.intp(absolute.ctypes.data))
            if status > WARNING:
                return BAD_CALL, status, SLOT.GET_NOMINALS
            for index in range(absolute.size):
                size = abs(absolute[index])
                absolute[index] = rtol * (size if size > 0.0 and np.isfinite(size) else 1.0)
            call_status(table[SLOT.TOLERANCES], (table[SLOT.SOLVER], rtol, table[SLOT.ABSOLUTE]))
    flag = call_status(table[SLOT.RESTART], (table[SLOT.SOLVER], time, table[SLOT.X]))
    return (BAD_STEP if flag < 0 else GOOD), flag, SLOT.RESTART


@compiled
def go_through_event(
    table: Any, info: FloatArray, inputs: Any, step: int
) -> tuple[int, int, int, bool, float]:
    """Go through an event; kind, detail, stage, nominals changed, next time event.

    The inputs of a step are set in it, none for step -1.
    """
    status = call_status(table[SLOT.ENTER_EVENT], (table[SLOT.COMPONENT],))
    if status > WARNING:
        return BAD_CALL, status, SLOT.ENTER_EVENT, False, np.inf
    if step >= 0:
        status, stage = set_inputs(table, inputs, step)
        if status > WARNING:
            return BAD_CALL, status, stage, False, np.inf
    kind, detail, nominals, _, later = _iterate(table, info)
    if kind != GOOD:
        return kind, detail, SLOT.UPDATE_DISCRETE, nominals, later
    status = call_status(table[SLOT.ENTER_CONTINUOUS], (table[SLOT.COMPONENT],))
    return (BAD_CALL if status > WARNING else GOOD), status, SLOT.ENTER_CONTINUOUS, nominals, later


@compiled
def simulate_row(
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
    y: FloatArray,
) -> tuple[int, int, int, float]:
    """Run an instance that was just initialized through the communication steps.

    An output at the end of a step still sees the step's inputs, as in co-simulation, and what an event at
    that very time leaves behind.

    Args:
        table: Addresses and counts (see exchange_calls). Shape (SLOT.SIZE,).
        input_table: What sets the inputs (see inputs). Shape (n_functions, 5), intp.
        inputs: Constant input of every step. Shape (m, n_inputs). [model's units]
        output_references: Value references. Shape (k,), uint32.
        edges: Edges of the communication steps. Shape (m + 1,). [s]
        output_every: Steps between two outputs.
        rtol: Relative tolerance.
        x: States, shared with CVODE. Shape (max(1, n),).
        x_between: States inside a step, shared with CVODE. Shape (max(1, n),).
        absolute: Absolute tolerances, shared with CVODE. Shape (max(1, n),).
        y: Filled with the outputs, contiguous. Shape (t, k). [model's units]

    Returns:
        How it ended, a detail of it, the stage (a Slot) and the time. [s]
    """
    n_steps, n_outputs = edges.size - 1, output_references.size
    output_list = np.intp(output_references.ctypes.data)
    y_address, y_stride = np.intp(y.ctypes.data), n_outputs * y.itemsize
    x_address, between_address = np.intp(x.ctypes.data), np.intp(x_between.ctypes.data)
    info, reached = np.zeros(4), np.zeros(1)
    # Without states and indicators there is nothing to integrate and nothing to look for between events.
    integrates = table[SLOT.N_STATES] + table[SLOT.N_INDICATORS] > 0
    time = edges[0]
    kind, detail, stage, later = begin(table, info)
    if kind == GOOD and integrates:
        kind, detail, stage = restart(table, time, x, absolute, rtol, True)
    if kind != GOOD:
        return kind, detail, stage, time
    status = get_real(table, output_list, n_outputs, y_address)
    if status > WARNING:
        return BAD_CALL, status, SLOT.GET_REAL, time
    passed, stop_edge, until_output, n_internal, n_events, n_stuck = 0, 0, output_every, 0, 0, 0
    while passed < n_steps:
        if stop_edge == passed:
            # The inputs of this step hold until here.
            stop_edge = passed + 1
            while stop_edge < n_steps and np.all(inputs[stop_edge] == inputs[passed]):
                stop_edge += 1
        target = min(edges[stop_edge], max(later, time))
        is_root = False
        if target - time > 100.0 * EPSILON * max(abs(time), abs(target)) and integrates:
            if n_internal == 0:
                table[SLOT.FAILED_STATUS] = 0
                table[SLOT.NOT_FINITE] = 0
            call_status(table[SLOT.STOP_AT], (table[SLOT.SOLVER], target))
            flag = call_status(
                table[SLOT.SOLVE],
                (
                    table[SLOT.SOLVER],
                    target,
                    table[SLOT.X],
                    np.intp(reached.ctypes.data),
                    np.int32(ONE_STEP),
                ),
            )
            if flag < 0:
                return BAD_STEP, flag, SLOT.SOLVE, time
            n_stuck = n_stuck + 1 if reached[0] <= time and flag != _ROOT_RETURN else 0
            if n_stuck > MOST_STUCK:
                return STUCK, n_stuck, SLOT.SOLVE, time
            time, is_root = min(reached[0], target), flag == _ROOT_RETURN
            n_internal += 1
            if n_internal > MOST_STEPS:
                return TOO_MANY_STEPS, n_internal, SLOT.SOLVE, time
        else:
            time = target
        # Outputs at edges that the step has run past.
        while edges[passed + 1] < time:
            passed += 1
            n_internal, n_events, until_output = 0, 0, until_output - 1
            if until_output == 0:
                until_output = output_every
                y_address += y_stride
                if integrates:
                    call_status(
                        table[SLOT.INTERPOLATE],
                        (table[SLOT.SOLVER], edges[passed], np.int32(0), table[SLOT.X_BETWEEN]),
                    )
                status, stage = at_point(table, edges[passed], between_address)
                if status <= WARNING:
                    stage, status = SLOT.GET_REAL, get_real(table, output_list, n_outputs, y_address)
                if status > WARNING:
                    return BAD_CALL, status, stage, edges[passed]
        status, stage = at_point(table, time, x_address)
        if status > WARNING:
            return BAD_CALL, status, stage, time
        is_event = is_root or time >= later
        # Also where the FMU says that it can do without: the call costs next to nothing.
        status, asks, ends = completed_step(table, info)
        if status > WARNING:
            return BAD_CALL, status, SLOT.COMPLETED, time
        if ends:
            return ENDED, 0, SLOT.COMPLETED, time
        is_event = is_event or asks
        if is_event:
            n_events += 1
            if n_events > MOST_EVENTS:
                return TOO_MANY_EVENTS, n_events, SLOT.UPDATE_DISCRETE, time
            kind, detail, stage, nominals, later = go_through_event(table, info, input_table, -1)
            if kind == GOOD and integrates:
                kind, detail, stage = restart(table, time, x, absolute, rtol, nominals)
            if kind != GOOD:
                return kind, detail, stage, time
        # Another event may be due at the same time: only then is the edge passed.
        if time < edges[passed + 1] or later <= time:
            continue
        passed += 1
        n_internal, n_events, until_output = 0, 0, until_output - 1
        if until_output == 0:
            until_output = output_every
            y_address += y_stride
            status = get_real(table, output_list, n_outputs, y_address)
            if status > WARNING:
                return BAD_CALL, status, SLOT.GET_REAL, time
        if passed == stop_edge and passed < n_steps:
            kind, detail, stage, nominals, later = go_through_event(table, info, input_table, passed)
            if kind == GOOD and integrates:
                kind, detail, stage = restart(table, time, x, absolute, rtol, nominals)
            if kind != GOOD:
                return kind, detail, stage, time
    return GOOD, 0, SLOT.GET_REAL, time
