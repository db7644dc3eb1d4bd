"""One simulation by model exchange, compiled: CVODE between the points where an input or an event breaks in.

The inputs are constant between two points, so the model is smooth there; at each point where one changes the
model goes through an event and CVODE starts anew, for what it knows of the past no longer holds. Between such
points it runs on, stopped at the next one, and outputs in between come from its own interpolation.
"""

from typing import Any

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.fmi import exchange_calls as calls
from simulation.fmi.call import call_status, compiled
from simulation.fmi.loop import WARNING, set_inputs

# How a simulation ends; what CVODE returned where it gave up is negative.
GOOD = 0
BAD_CALL = 1  # a function of the FMU returned a bad status
TOO_MANY_STEPS = 2
TOO_MANY_EVENTS = 3
ENDED = 4  # the FMU asked to end the simulation
ENDLESS_ITERATION = 5
BAD_STATE = 6  # a state is no finite number
STUCK = 7  # steps became too small to move the time

# Internal steps and events in one communication step, and iterations in one event, before a simulation is
# given up: no model hangs silently.
MOST_STEPS = 100_000
MOST_EVENTS = 10_000
MOST_ITERATIONS = 1_000
# Successive steps too small to move the time.
MOST_STUCK = 100

# Events in which no step's inputs are set.
_NO_INPUTS = -1
_FIRST = -2

_ONE_STEP = 2  # CV_ONE_STEP of CVODE
_ROOT_RETURN = 2  # CV_ROOT_RETURN
_EPSILON = 2.0**-52  # distance from 1.0 to the next double


@compiled
def _go_through_event(
    table: Any, time: float, info: FloatArray, vectors: Any, rtol: float, inputs: Any, step: int
) -> tuple[int, float]:
    """Go through an event to continuous time, and start CVODE anew.

    Args:
        table: Addresses and counts (see exchange_calls). Shape (SIZE,).
        time: Time of the event. [s]
        info: Four numbers of scratch.
        vectors: States, states inside a step, absolute tolerances. Each of shape (max(1, n),).
        rtol: Relative tolerance.
        inputs: What sets the inputs (see loop). Shape (n_functions, 6), intp.
        step: Step whose inputs are set in it, _NO_INPUTS, or _FIRST for the end of the initialization.

    Returns:
        How it ended, and the time of the next time event, infinite for none. [s]
    """
    x, _, absolute = vectors
    # After the initialization an FMU is in event mode already.
    if step != _FIRST and not calls.called(table, calls.ENTER_EVENT, ()):
        return BAD_CALL, np.inf
    if step >= 0:
        status, row = set_inputs(table[calls.COMPONENT], inputs, step)
        if status > WARNING:
            table[calls.STATUS], table[calls.STAGE] = status, calls.FIRST_INPUT + row
            return BAD_CALL, np.inf
    # Nominal values are unknown before the first event.
    again, nominals, later = True, step == _FIRST, np.inf
    for _ in range(MOST_ITERATIONS):
        good, again, ends, changed, later = calls.update_discrete_states(table, info)
        if not good or ends:
            return (ENDED if good else BAD_CALL), later
        nominals = nominals or changed
        if not again:
            break
    if again:
        return ENDLESS_ITERATION, later
    n = table[calls.N_STATES]
    good = calls.called(table, calls.ENTER_CONTINUOUS, ())
    if good and n > 0:
        good = calls.called(table, calls.GET_STATES, (x.ctypes.data, n))
        table[calls.NOT_FINITE] = calls.first_not_finite(x)
        if good and table[calls.NOT_FINITE] != 0:
            return BAD_STATE, later
        if good and nominals:
            good = calls.called(table, calls.GET_NOMINALS, (absolute.ctypes.data, n))
            for index in range(n):
                size = abs(absolute[index])
                # A state of nominal size is then held as exactly in absolute terms as in relative ones.
                absolute[index] = rtol * (size if size > 0.0 and np.isfinite(size) else 1.0)
            # CVODE copies the vector, so it has to be given anew.
            call_status(table[calls.TOLERANCES], (table[calls.SOLVER], rtol, table[calls.ABSOLUTE]))
    if not good:
        return BAD_CALL, later
    if n + table[calls.N_INDICATORS] > 0:
        flag = call_status(table[calls.RESTART], (table[calls.SOLVER], time, table[calls.X]))
        # Positive flags of CVODE are warnings.
        return min(GOOD, flag), later
    return GOOD, later


@compiled
def _read(
    table: Any, seen: Any, behind: int, passed: int, n_steps: int, every: int, references: Any, y: FloatArray
) -> bool:
    """Read the outputs at an edge, with the inputs that they see there; return whether all calls were good.

    Args:
        table: Addresses and counts (see exchange_calls). Shape (SIZE,).
        seen: What sets the inputs that outputs see (see loop). Shape (n_functions, 6), intp.
        behind: Rows of the table of inputs, whose stages come first.
        passed: The edge; the inputs of the step before it are set, and are again afterwards.
        n_steps: Steps, whose inputs come first in `seen`.
        every: Steps per output step.
        references: Value references of the outputs. Shape (n_references,), uint32.
        y: Outputs to fill. Shape (t, n_values).
    """
    status, row = set_inputs(table[calls.COMPONENT], seen, n_steps + passed)
    if status <= WARNING:
        n, n_values = references.size, y.shape[1]
        address = np.intp(y.ctypes.data) + passed // every * n_values * y.itemsize
        if not calls.called(table, calls.GET, (np.intp(references.ctypes.data), n, address, n_values)):
            return False
        status, row = set_inputs(table[calls.COMPONENT], seen, max(passed - 1, 0))
    if status > WARNING:
        table[calls.STATUS], table[calls.STAGE] = status, calls.FIRST_INPUT + behind + row
    return bool(status <= WARNING)


@compiled
def simulate_row(
    table: Any,
    inputs: Any,
    seen: Any,
    changes: IntArray,
    output_references: Any,
    edges: FloatArray,
    output_every: int,
    rtol: float,
    vectors: Any,
    y: FloatArray,
) -> tuple[int, float]:
    """Run an instance that was just initialized through the communication steps.

    An output at the end of a step sees the inputs at that time or, where none are given, still the step's, as
    in co-simulation, and what an event at that very time leaves behind.

    Args:
        table: Addresses and counts (see exchange_calls). Shape (SIZE,).
        inputs: What sets the inputs (see loop). Shape (n_functions, 6), intp.
        seen: The same for inputs that outputs see: over the m steps, then at the m + 1 edges; may be empty.
            Shape (n_functions, 6), intp.
        changes: Edges before which the inputs change, and the last edge. Shape (n_changes + 1,).
        output_references: Value references. Shape (n_references,), uint32.
        edges: Edges of the communication steps. Shape (m + 1,). [s]
        output_every: Steps between two outputs.
        rtol: Relative tolerance.
        vectors: States, states inside a step, absolute tolerances, shared with CVODE. Each (max(1, n),).
        y: Filled with the outputs, contiguous. Shape (t, n_values). [model's units]

    Returns:
        How it ended, details being in the table, and the time. [s]
    """
    n_steps = edges.size - 1
    x, x_between, _ = vectors
    info, reached = np.zeros(4), np.zeros(1)
    # Whether an event follows and whether the FMU wants to end: a bool of one byte, or four in FMI 2.0, each
    # among zeros.
    said = np.zeros(2, dtype=np.int64)
    # Without states and indicators there is nothing to integrate and nothing to look for between events.
    integrates = table[calls.N_STATES] + table[calls.N_INDICATORS] > 0
    time, passed, n_changes, n_internal, n_events, n_stuck = edges[0], 0, 0, 0, 0, 0
    end, later = _go_through_event(table, time, info, vectors, rtol, inputs, _FIRST)
    if end != GOOD:
        return end, time
    behind = inputs.shape[0]
    if not _read(table, seen, behind, 0, n_steps, output_every, output_references, y):
        return BAD_CALL, time
    while passed < n_steps:
        # A time event that is due already must not lead back.
        target = min(edges[changes[n_changes]], max(later, time))
        is_root = False
        # Nearer than this CVODE takes a stop time for reached (its factor of rounding is 100, too).
        if integrates and target - time > 100.0 * _EPSILON * max(abs(time), abs(target)):
            # A call that failed and was repeated well in an earlier step is no reason of a later failure.
            if n_internal == 0:
                table[calls.STATUS], table[calls.NOT_FINITE] = 0, 0
            call_status(table[calls.STOP_AT], (table[calls.SOLVER], target))
            # One step at a time: the standard wants CompletedIntegratorStep after each.
            to_target = (table[calls.SOLVER], target, table[calls.X], reached.ctypes.data, _ONE_STEP)
            flag = call_status(table[calls.SOLVE], to_target)
            if flag < 0:
                return flag, time
            is_root = flag == _ROOT_RETURN
            # Several roots at one time are no sign of being stuck.
            n_stuck = n_stuck + 1 if reached[0] <= time and not is_root else 0
            if n_stuck > MOST_STUCK:
                return STUCK, time
            # A guard: rounding must not carry the time behind the stop time.
            time = min(reached[0], target)
            n_internal += 1
            if n_internal > MOST_STEPS:
                return TOO_MANY_STEPS, time
        else:
            time = target
        # Outputs at edges that the step has run past.
        while edges[passed + 1] < time:
            passed, n_internal, n_events = passed + 1, 0, 0
            if passed % output_every == 0:
                if integrates:
                    call_status(
                        table[calls.INTERPOLATE],
                        (table[calls.SOLVER], edges[passed], 0, table[calls.X_BETWEEN]),
                    )
                if not calls.at_point(table, edges[passed], x_between.ctypes.data):
                    return BAD_CALL, edges[passed]
                if not _read(table, seen, behind, passed, n_steps, output_every, output_references, y):
                    return BAD_CALL, edges[passed]
        # The FMU was last asked at a trial point or an output, not where the step ended.
        if not calls.at_point(table, time, x.ctypes.data):
            return BAD_CALL, time
        # Also where the FMU says that it can do without: the call costs next to nothing.
        said[:] = 0
        if not calls.called(table, calls.COMPLETED, (1, said.ctypes.data, said.ctypes.data + 8)):
            return BAD_CALL, time
        if said[1] != 0:
            return ENDED, time
        if said[0] != 0 or is_root or time >= later:
            n_events += 1
            if n_events > MOST_EVENTS:
                return TOO_MANY_EVENTS, time
            end, later = _go_through_event(table, time, info, vectors, rtol, inputs, _NO_INPUTS)
            if end != GOOD:
                return end, time
        # Another event may be due at the same time: only then is the edge passed.
        if time < edges[passed + 1] or later <= time:
            continue
        passed, n_internal, n_events = passed + 1, 0, 0
        is_output = passed % output_every == 0
        if is_output and not _read(table, seen, behind, passed, n_steps, output_every, output_references, y):
            return BAD_CALL, time
        if passed == changes[n_changes] and passed < n_steps:
            n_changes += 1
            end, later = _go_through_event(table, time, info, vectors, rtol, inputs, passed)
            if end != GOOD:
                return end, time
    return GOOD, time
