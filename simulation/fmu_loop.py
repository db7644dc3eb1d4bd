"""The co-simulation loop of FMI 2.0, compiled once for every FMU: it calls the FMU's functions by address."""

from typing import Any, Final

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmu_call import call_status, compiled

# Order of the addresses in the array handed to the loop, and of the stages it reports.
FUNCTIONS: Final = ("SetReal", "DoStep", "GetReal")
_SET, _STEP, _GET = range(len(FUNCTIONS))
WARNING: Final = 1


@compiled
def step_through(
    functions: Any,
    component: int,
    input_references: Any,
    inputs: FloatArray,
    output_references: Any,
    time: FloatArray,
    output_every: int,
    y: FloatArray,
) -> tuple[int, int, int]:
    """Take an initialized instance of FMI 2.0 through the communication steps.

    Args:
        functions: Addresses of FUNCTIONS. Shape (3,), intp.
        component: Address of the instance.
        input_references: Value references. Shape (n_inputs,), uint32.
        inputs: Constant input of every step, contiguous. Shape (m, n_inputs). [model's units]
        output_references: Value references. Shape (k,), uint32.
        time: Edges of the communication steps. Shape (m + 1,). [s]
        output_every: Steps between two outputs.
        y: Filled with the outputs, contiguous. Shape (t, k). [model's units]

    Returns:
        Status of the last call (0 or 1 when all went well), its index in FUNCTIONS, and its step.
    """
    n_inputs, n_outputs = input_references.size, output_references.size
    n_steps = time.size - 1
    true = np.int32(1)
    # Addresses are reckoned once: the view of a row costs as much as a step of a small model. They are made
    # signed, as numba adds an unsigned and a signed integer to a float.
    inputs_address, inputs_stride = np.intp(inputs.ctypes.data), n_inputs * inputs.itemsize
    y_address, y_stride = np.intp(y.ctypes.data), n_outputs * y.itemsize
    input_list, output_list = input_references.ctypes.data, output_references.ctypes.data
    status = call_status(functions[_GET], (component, output_list, n_outputs, y_address))
    if status > WARNING:
        return status, _GET, 0
    until_output = output_every
    for step in range(n_steps):
        if n_inputs > 0:
            values = inputs_address + step * inputs_stride
            status = call_status(functions[_SET], (component, input_list, n_inputs, values))
            if status > WARNING:
                return status, _SET, step
        status = call_status(functions[_STEP], (component, time[step], time[step + 1] - time[step], true))
        if status > WARNING:
            return status, _STEP, step
        until_output -= 1
        if until_output == 0:
            until_output = output_every
            y_address += y_stride
            status = call_status(functions[_GET], (component, output_list, n_outputs, y_address))
            if status > WARNING:
                return status, _GET, step
    return status, _GET, n_steps - 1
