"""The model-exchange functions of FMI 2.0 and 3.0 as compiled calls by address; CVODE's callbacks among them.

Everything a simulation needs lies in one table of 64-bit integers: addresses, counts, and what went wrong
last. It travels as CVODE's user data, so that right-hand side and roots run without the interpreter.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from llvmlite import ir
from numba import carray, cfunc, types
from numba.extending import intrinsic

from simulation.arrays import FloatArray
from simulation.fmi.call import cached, call_status, compiled
from simulation.fmi.inputs import COUNT, FUNCTION, REFERENCES, STRIDE, VALUES
from simulation.fmi.instance import FATAL, WARNING

# The FMU's functions that the loop calls, without the version: FMI 2.0's name and FMI 3.0's.
FUNCTIONS: Final = {
    "fmi2": (
        "GetReal",
        "EnterEventMode",
        "NewDiscreteStates",
        "EnterContinuousTimeMode",
        "CompletedIntegratorStep",
        "SetTime",
        "SetContinuousStates",
        "GetContinuousStates",
        "GetDerivatives",
        "GetNominalsOfContinuousStates",
        "GetEventIndicators",
    ),
    "fmi3": (
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
    ),
}


class _Slots(NamedTuple):
    """Where a thing lies in the table; the FMU's functions come first, in the order of FUNCTIONS."""

    GET_REAL: int = 0
    ENTER_EVENT: int = 1
    UPDATE_DISCRETE: int = 2
    ENTER_CONTINUOUS: int = 3
    COMPLETED: int = 4
    SET_TIME: int = 5
    SET_STATES: int = 6
    GET_STATES: int = 7
    GET_DERIVATIVES: int = 8
    GET_NOMINALS: int = 9
    GET_INDICATORS: int = 10
    IS_FMI3: int = 11
    COMPONENT: int = 12
    N_STATES: int = 13
    N_INDICATORS: int = 14
    FAILED_STATUS: int = 15  # of a call that CVODE made
    FAILED_STAGE: int = 16
    NOT_FINITE: int = 17  # 1 + index of a derivative that was none
    VECTOR_DATA: int = 18  # N_VGetArrayPointer
    SOLVE: int = 19
    RESTART: int = 20
    STOP_AT: int = 21
    INTERPOLATE: int = 22
    TOLERANCES: int = 23
    SOLVER: int = 24  # CVODE's memory
    X: int = 25  # N_Vector of the states
    X_BETWEEN: int = 26  # N_Vector of the states at a time inside the last step
    ABSOLUTE: int = 27  # N_Vector of the absolute tolerances
    SIZE: int = 28


SLOT: Final = _Slots()
# The stages from here on are rows of the table of inputs (see inputs).
FIRST_INPUT: Final = SLOT.SIZE

_pointer: Any = types.CPointer


def _callback(function: Callable[..., Any]) -> Any:
    """Compile a function that CVODE calls with (t, vector, result, user data)."""
    signature = types.int32(types.float64, types.intp, types.intp, _pointer(types.int64))
    return cached(function, partial(cfunc, signature, error_model="numpy"))


def _call_address_of(_typing_context: Any, address: Any, argument: Any) -> Any:
    """Call a C function that takes an address and returns one."""

    def generate(_context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        word = ir.IntType(64)
        return builder.call(
            builder.inttoptr(values[0], ir.FunctionType(word, [word]).as_pointer()), values[1:]
        )

    return types.intp(types.intp, types.intp), generate


_call_address: Any = intrinsic(_call_address_of)


def _as_doubles_of(_typing_context: Any, address: Any) -> Any:
    """Read an address as the place of float64 values."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.inttoptr(values[0], context.get_value_type(signature.return_type))

    return _pointer(types.float64)(types.intp), generate


_as_doubles: Any = intrinsic(_as_doubles_of)


@compiled
def set_inputs(table: Any, inputs: Any, step: int) -> tuple[int, int]:
    """Set the inputs of a step; status and stage of the last call."""
    component = table[SLOT.COMPONENT]
    for row in range(inputs.shape[0]):
        function, references, n = inputs[row, FUNCTION], inputs[row, REFERENCES], inputs[row, COUNT]
        values = inputs[row, VALUES] + step * inputs[row, STRIDE]
        if table[SLOT.IS_FMI3] != 0:
            status = call_status(function, (component, references, n, values, n))
        else:
            status = call_status(function, (component, references, n, values))
        if status > WARNING:
            return status, FIRST_INPUT + row
    return 0, FIRST_INPUT


@compiled
def get_real(table: Any, references: Any, n: int, values: Any) -> Any:
    """Get n float variables, by the addresses of references and values."""
    if table[SLOT.IS_FMI3] != 0:
        return call_status(table[SLOT.GET_REAL], (table[SLOT.COMPONENT], references, n, values, n))
    return call_status(table[SLOT.GET_REAL], (table[SLOT.COMPONENT], references, n, values))


@compiled
def update_discrete_states(table: Any, info: FloatArray) -> tuple[int, bool, bool, bool, bool, float]:
    """Iterate once over the discrete states.

    Args:
        table: The table.
        info: Four numbers of scratch.

    Returns:
        Status; whether another iteration is needed; whether the FMU wants to end; whether nominal values and
        whether values of states changed; the time of the next time event, infinite for none. [s]
    """
    address = np.intp(info.ctypes.data)
    component = table[SLOT.COMPONENT]
    info[:] = 0.0
    if table[SLOT.IS_FMI3] != 0:
        status = call_status(
            table[SLOT.UPDATE_DISCRETE],
            (component, address, address + 1, address + 2, address + 3, address + 4, address + 24),
        )
        said = info.view(np.uint8)
        again, end, nominals, values, defined = said[0], said[1], said[2], said[3], said[4]
        return status, again != 0, end != 0, nominals != 0, values != 0, info[3] if defined != 0 else np.inf
    # fmi2EventInfo: five 32-bit booleans, padding, one double.
    status = call_status(table[SLOT.UPDATE_DISCRETE], (component, address))
    flags = info.view(np.int32)
    later = info[3] if flags[4] != 0 else np.inf
    return status, flags[0] != 0, flags[1] != 0, flags[2] != 0, flags[3] != 0, later


@compiled
def completed_step(table: Any, info: FloatArray) -> tuple[int, bool, bool]:
    """Report a step of the integrator; status, whether an event follows, whether the FMU wants to end."""
    address = np.intp(info.ctypes.data)
    info[:2] = 0.0
    status = call_status(table[SLOT.COMPLETED], (table[SLOT.COMPONENT], np.int32(1), address, address + 8))
    # A C bool is one byte, an fmi2Boolean four; the bytes around it are zero.
    said = info.view(np.int64)
    return status, said[0] != 0, said[1] != 0


@compiled
def at_point(table: Any, time: float, states: Any) -> tuple[int, int]:
    """Set time and, where there are any, states by address; status and stage of the last call."""
    status = call_status(table[SLOT.SET_TIME], (table[SLOT.COMPONENT], time))
    if status > WARNING or table[SLOT.N_STATES] == 0:
        return status, SLOT.SET_TIME
    status = call_status(table[SLOT.SET_STATES], (table[SLOT.COMPONENT], states, table[SLOT.N_STATES]))
    return status, SLOT.SET_STATES


@compiled
def get_states(table: Any, slot: int, values: Any) -> Any:
    """Get states, derivatives or nominal values into an address."""
    return call_status(table[slot], (table[SLOT.COMPONENT], values, table[SLOT.N_STATES]))


@_callback
def derivatives(time: Any, vector: Any, result: Any, user_data: Any) -> int:
    """CVODE's right-hand side: 0 good, 1 try a smaller step, -1 give up."""
    table = carray(user_data, SLOT.SIZE)
    values = _call_address(table[SLOT.VECTOR_DATA], result)
    slopes = carray(_as_doubles(values), max(1, table[SLOT.N_STATES]))
    if table[SLOT.N_STATES] == 0:
        slopes[0] = 0.0
        return 0
    status, stage = at_point(table, time, _call_address(table[SLOT.VECTOR_DATA], vector))
    if status <= WARNING:
        stage = SLOT.GET_DERIVATIVES
        status = get_states(table, SLOT.GET_DERIVATIVES, values)
    if status > WARNING:
        table[SLOT.FAILED_STATUS] = status
        table[SLOT.FAILED_STAGE] = stage
        return -1 if status >= FATAL else 1
    for index in range(slopes.size):
        if not np.isfinite(slopes[index]):
            table[SLOT.NOT_FINITE] = index + 1
            return 1
    return 0


@_callback
def indicators(time: Any, vector: Any, result: Any, user_data: Any) -> int:
    """CVODE's root function: 0 good, -1 give up."""
    table = carray(user_data, SLOT.SIZE)
    status, stage = at_point(table, time, _call_address(table[SLOT.VECTOR_DATA], vector))
    if status <= WARNING:
        stage = SLOT.GET_INDICATORS
        status = call_status(
            table[SLOT.GET_INDICATORS], (table[SLOT.COMPONENT], result, table[SLOT.N_INDICATORS])
        )
    if status > WARNING:
        table[SLOT.FAILED_STATUS] = status
        table[SLOT.FAILED_STAGE] = stage
        return -1
    return 0
