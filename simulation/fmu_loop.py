"""The co-simulation loop, compiled once by numba for every FMU: it calls the FMU's own function addresses.

Addresses arrive as integers, so the machine code depends on no FMU and lies in numba's cache on disk: beside
this file, or in the user's cache folder where the package is read-only.
"""

from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from simulation.arrays import FloatArray

# Order of the addresses in the array handed to the loop, and of the stages it reports.
FUNCTIONS: Final = (
    "fmi2Reset",
    "fmi2SetupExperiment",
    "fmi2SetReal",
    "fmi2EnterInitializationMode",
    "fmi2ExitInitializationMode",
    "fmi2DoStep",
    "fmi2GetReal",
)
_RESET, _SETUP, _SET_REAL, _ENTER, _EXIT, _DO_STEP, _GET_REAL = range(len(FUNCTIONS))
WARNING: Final = 1

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """Compile a function without the interpreter's lock, from the cache on disk where there can be one.

    Args:
        function: The function.

    Returns:
        The compiled function.
    """
    try:
        loop: Any = njit(cache=True, nogil=True)(function)
    except RuntimeError:
        # numba found no folder to cache in (read-only package, no writable home): compile in every process.
        loop = njit(nogil=True)(function)
    return cast(_Function, loop)


def _call_status(typing_context: Any, address: Any, arguments: Any) -> Any:
    """Call a C function that returns an fmi2Status; each item of the tuple has exactly its C type's width."""
    signature = types.int32(types.intp, arguments)

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        target, packed = values
        argument_types = [context.get_value_type(kind) for kind in arguments]
        function_type = ir.FunctionType(ir.IntType(32), argument_types)
        function = builder.inttoptr(target, function_type.as_pointer())
        unpack: Any = cgutils.unpack_tuple
        return builder.call(function, unpack(builder, packed, len(argument_types)))

    return signature, generate


_call: Any = intrinsic(_call_status)


@compiled
def simulate_row(
    functions: Any,
    component: int,
    parameter_references: Any,
    parameter_values: FloatArray,
    input_references: Any,
    inputs: FloatArray,
    output_references: Any,
    time: FloatArray,
    output_every: int,
    y: FloatArray,
) -> tuple[int, int, int]:
    """Reset the instance and run it through the communication steps.

    Args:
        functions: Addresses of FUNCTIONS. Shape (7,), intp.
        component: Address of the instance.
        parameter_references: Value references. Shape (n_set,), uint32.
        parameter_values: Values set before initialization. Shape (n_set,). [model's units]
        input_references: Value references. Shape (n_inputs,), uint32.
        inputs: Constant input of every step, contiguous. Shape (m, n_inputs). [model's units]
        output_references: Value references. Shape (k,), uint32.
        time: Edges of the communication steps. Shape (m + 1,). [s]
        output_every: Steps between two outputs.
        y: Filled with the outputs, contiguous. Shape (t, k). [model's units]

    Returns:
        Status of the last call (0 or 1 when all went well), its index in FUNCTIONS, and its step.
    """
    n_set, n_inputs, n_outputs = parameter_values.size, input_references.size, output_references.size
    n_steps = time.size - 1
    true, false = np.int32(1), np.int32(0)
    # Addresses are reckoned once: the view of a row costs as much as a step of a small model. They are made
    # signed, as numba adds an unsigned and a signed integer to a float.
    inputs_address, inputs_stride = np.intp(inputs.ctypes.data), n_inputs * inputs.itemsize
    y_address, y_stride = np.intp(y.ctypes.data), n_outputs * y.itemsize
    input_list, output_list = input_references.ctypes.data, output_references.ctypes.data
    status = _call(functions[_RESET], (component,))
    if status > WARNING:
        return status, _RESET, 0
    status = _call(functions[_SETUP], (component, false, 0.0, time[0], true, time[n_steps]))
    if status > WARNING:
        return status, _SETUP, 0
    if n_set > 0:
        status = _call(
            functions[_SET_REAL],
            (component, parameter_references.ctypes.data, n_set, parameter_values.ctypes.data),
        )
        if status > WARNING:
            return status, _SET_REAL, 0
    status = _call(functions[_ENTER], (component,))
    if status > WARNING:
        return status, _ENTER, 0
    # Inputs of the first step are set here too: initial values may depend on them.
    if n_inputs > 0:
        status = _call(functions[_SET_REAL], (component, input_list, n_inputs, inputs_address))
        if status > WARNING:
            return status, _SET_REAL, 0
    status = _call(functions[_EXIT], (component,))
    if status > WARNING:
        return status, _EXIT, 0
    status = _call(functions[_GET_REAL], (component, output_list, n_outputs, y_address))
    if status > WARNING:
        return status, _GET_REAL, 0
    until_output = output_every
    for step in range(n_steps):
        if n_inputs > 0:
            values = inputs_address + step * inputs_stride
            status = _call(functions[_SET_REAL], (component, input_list, n_inputs, values))
            if status > WARNING:
                return status, _SET_REAL, step
        status = _call(functions[_DO_STEP], (component, time[step], time[step + 1] - time[step], true))
        if status > WARNING:
            return status, _DO_STEP, step
        until_output -= 1
        if until_output == 0:
            until_output = output_every
            y_address += y_stride
            status = _call(functions[_GET_REAL], (component, output_list, n_outputs, y_address))
            if status > WARNING:
                return status, _GET_REAL, step
    return status, _GET_REAL, n_steps - 1
