"""The FMU's model-exchange functions as compiled calls by address; CVODE's callbacks among them.

Everything a simulation needs lies in one table of 64-bit integers: addresses, counts, and what went wrong
last. It travels as CVODE's user data, so that right-hand side and roots run without the interpreter.
"""

from functools import partial
from typing import Any

import numpy as np
from numba import carray, cfunc, types

from simulation.arrays import FloatArray
from simulation.fmi.call import cached, call_status, compiled
from simulation.fmi.loop import WARNING

# The FMU's functions that the loop calls; their addresses come first in the table, in this order.
FUNCTIONS = (
    "GetFloat64",
    "EnterEventMode",
    "UpdateDiscreteStates",
    "EnterContinuousTimeMode",
    "CompletedIntegratorStep",
    "SetTime",
    "SetContinuousStates",
    "GetContinuousStates",
    "GetContinuousStateDerivatives",
    "GetNominalsOfContinuousStates",
    "GetEventIndicators",
)
GET, ENTER_EVENT, UPDATE, ENTER_CONTINUOUS, COMPLETED, SET_TIME, SET_STATES, GET_STATES = range(8)
GET_DERIVATIVES, GET_NOMINALS, GET_INDICATORS = range(8, 11)
COMPONENT, N_STATES, N_INDICATORS = range(11, 14)
# What the last call that failed returned and which it was, and 1 + the index of a number that is none.
STATUS, STAGE, NOT_FINITE = range(14, 17)
# CVODE's functions, and its memory, the vectors of the states, of those inside a step, and of the tolerances.
SOLVE, RESTART, STOP_AT, INTERPOLATE, TOLERANCES = range(17, 22)
SOLVER, X, X_BETWEEN, ABSOLUTE = range(22, 26)
SIZE = 26
# As a stage, this and what follows are rows of the inputs' table (see loop).
FIRST_INPUT = len(FUNCTIONS)

_FATAL = 4  # fmi2Fatal, fmi3Fatal
_Pointer: Any = types.CPointer
# N_Vector, as SUNDIALS' headers have it: its first word points to its content, whose third is the data.
_Vector: Any = _Pointer(_Pointer(_Pointer(types.float64)))
_Table: Any = _Pointer(types.int64)


@compiled
def called(table: Any, slot: int, arguments: Any) -> bool:
    """Call the function of a slot on the instance; record a failure, and return whether there was none."""
    status = call_status(table[slot], (table[COMPONENT], *arguments))
    if status > WARNING:
        table[STATUS], table[STAGE] = status, slot
    return bool(status <= WARNING)


@compiled
def update_discrete_states(table: Any, info: FloatArray) -> tuple[bool, bool, bool, bool, float]:
    """Iterate once over the discrete states.

    Args:
        table: The table.
        info: Four numbers of scratch.

    Returns:
        Whether the call was good; whether another iteration is needed; whether the FMU wants to end; whether
        nominal values of states changed; the time of the next time event, infinite for none. [s]
    """
    at = np.intp(info.ctypes.data)
    info[:4] = 0.0
    # FMI 2.0 takes the first address alone, of an fmi2EventInfo: five booleans of 32 bits, padding, a double.
    # The bools of FMI 3.0, of one byte, are put into the same places; the bytes around them are zero.
    good = called(table, UPDATE, (at, at + 4, at + 8, at + 12, at + 16, at + 24))
    flags = info.view(np.int32)
    return good, flags[0] != 0, flags[1] != 0, flags[2] != 0, info[3] if flags[4] != 0 else np.inf


@compiled
def at_point(table: Any, time: float, states: Any) -> bool:
    """Set time and, where there are any, states by address; whether that was good."""
    if not called(table, SET_TIME, (time,)):
        return False
    return bool(table[N_STATES] == 0 or called(table, SET_STATES, (states, table[N_STATES])))


@compiled
def first_not_finite(values: FloatArray) -> int:
    """Return 1 + the index of the first value that is no finite number, 0 where all are."""
    for index in range(values.size):
        if not np.isfinite(values[index]):
            return index + 1
    return 0


def _derivatives(time: Any, vector: Any, result: Any, user_data: Any) -> int:
    """CVODE's right-hand side: 0 good, 1 try a smaller step, -1 give up."""
    table = carray(user_data, SIZE)
    n = table[N_STATES]
    slopes = carray(result[0][2], max(1, n))
    if n == 0:
        slopes[0] = 0.0
        return 0
    states = carray(vector[0][2], n)
    if not (
        at_point(table, time, states.ctypes.data) and called(table, GET_DERIVATIVES, (slopes.ctypes.data, n))
    ):
        # CVODE repeats a recoverable failure with a smaller step; after a fatal one no call is allowed.
        return -1 if table[STATUS] >= _FATAL else 1
    bad = first_not_finite(slopes)
    if bad:
        table[NOT_FINITE] = bad
    # A state that left its range in a trial step: a smaller step may stay inside.
    return 1 if bad else 0


def _indicators(time: Any, vector: Any, result: Any, user_data: Any) -> int:
    """CVODE's root function: 0 good, -1 give up."""
    table = carray(user_data, SIZE)
    states = carray(vector[0][2], max(1, table[N_STATES]))
    good = at_point(table, time, states.ctypes.data)
    return 0 if good and called(table, GET_INDICATORS, (result, table[N_INDICATORS])) else -1


def _callback(function: Any, result: Any) -> Any:
    """Compile a function that CVODE calls with (t, vector, result, user data)."""
    signature = types.int32(types.float64, _Vector, result, _Table)
    return cached(function, partial(cfunc, signature, error_model="numpy"))


derivatives = _callback(_derivatives, _Vector)
indicators = _callback(_indicators, types.intp)
