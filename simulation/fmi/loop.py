"""The co-simulation loops, compiled once for every FMU: they call the FMU's own functions by address."""

from typing import Any, Final

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.call import call_status, compiled
from simulation.fmi.inputs import COUNT, FUNCTION, REFERENCES, STRIDE, VALUES

# Order of the addresses in the array handed to a loop, and of the stages it reports.
FUNCTIONS_2: Final = ("DoStep", "GetReal")
FUNCTIONS_3: Final = ("DoStep", "GetFloat64")
_STEP, _GET = range(2)
# The stages from here on are rows of the inputs' table.
FIRST_INPUT: Final = 2
WARNING: Final = 1
# What a loop returns in place of a status when a step was good and yet not the whole step.
ENDED: Final = 100
EARLY: Final = 101


@compiled
def step_through_2(
    functions: Any,
    component: int,
    inputs: Any,
    output_references: Any,
    time: FloatArray,
    first: int,
    output_every: int,
    no_going_back: bool,
    y: FloatArray,
) -> tuple[int, int, int]:
    """Take an initialized instance of FMI 2.0 through the communication steps.

    Args:
        functions: Addresses of FUNCTIONS_2. Shape (2,), intp.
        component: Address of the instance.
        inputs: Table of the inputs (see inputs). Shape (n_functions, 5), intp.
        output_references: Value references. Shape (k,), uint32.
        time: Edges of the communication steps. Shape (m + 1,). [s]
        first: Step to begin with; a multiple of output_every.
        output_every: Steps between two outputs.
        no_going_back: Whether no saved state of an earlier time will be set.
        y: Filled with the outputs from the first step on, contiguous. Shape (t, k). [model's units]

    Returns:
        Status of the last call (0 or 1 when all went well), its stage, and its step.
    """
    n_functions, n_outputs = inputs.shape[0], output_references.size
    n_steps = time.size - 1
    no_state = np.int32(no_going_back)
    # Addresses are reckoned once: the view of a row costs as much as a step of a small model. They are made
    # signed, as numba adds an unsigned and a signed integer to a float.
    y_stride = n_outputs * y.itemsize
    y_address = np.intp(y.ctypes.data) + first // output_every * y_stride
    output_list = output_references.ctypes.data
    status = call_status(functions[_GET], (component, output_list, n_outputs, y_address))
    if status > WARNING:
        return status, _GET, first
    until_output = output_every
    for step in range(first, n_steps):
        for row in range(n_functions):
            values = inputs[row, VALUES] + step * inputs[row, STRIDE]
            n = inputs[row, COUNT]
            status = call_status(inputs[row, FUNCTION], (component, inputs[row, REFERENCES], n, values))
            if status > WARNING:
                return status, FIRST_INPUT + row, step
        h = time[step + 1] - time[step]
        status = call_status(functions[_STEP], (component, time[step], h, no_state))
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


@compiled
def step_through_3(
    functions: Any,
    component: int,
    inputs: Any,
    output_references: Any,
    time: FloatArray,
    first: int,
    output_every: int,
    no_going_back: bool,
    said: FloatArray,
    y: FloatArray,
) -> tuple[int, int, int]:
    """Take an initialized instance of FMI 3.0 through the communication steps; as step_through_2.

    Args:
        functions: Addresses of FUNCTIONS_3. Shape (2,), intp.
        component: Address of the instance.
        inputs: Table of the inputs (see inputs). Shape (n_functions, 5), intp.
        output_references: Value references. Shape (k,), uint32.
        time: Edges of the communication steps. Shape (m + 1,). [s]
        first: Step to begin with; a multiple of output_every.
        output_every: Steps between two outputs.
        no_going_back: Whether no saved state of an earlier time will be set.
        said: What the last step said; its second item is the time that it got to. Shape (2,). [s]
        y: Filled with the outputs from the first step on, contiguous. Shape (t, k). [model's units]

    Returns:
        Status of the last call (0 or 1 when all went well; ENDED where the FMU wants no further step, EARLY
        where it stopped within one), its stage, and its step.
    """
    n_functions, n_outputs = inputs.shape[0], output_references.size
    n_steps = time.size - 1
    no_state = np.int32(no_going_back)
    y_stride = n_outputs * y.itemsize
    y_address = np.intp(y.ctypes.data) + first // output_every * y_stride
    output_list = output_references.ctypes.data
    # Three C bools: event handling needed, simulation to be terminated, returned early.
    flags = np.zeros(3, dtype=np.uint8)
    flag = np.intp(flags.ctypes.data)
    reached = np.intp(said.ctypes.data) + said.itemsize
    status = call_status(functions[_GET], (component, output_list, n_outputs, y_address, n_outputs))
    if status > WARNING:
        return status, _GET, first
    until_output = output_every
    for step in range(first, n_steps):
        for row in range(n_functions):
            values = inputs[row, VALUES] + step * inputs[row, STRIDE]
            n = inputs[row, COUNT]
            status = call_status(inputs[row, FUNCTION], (component, inputs[row, REFERENCES], n, values, n))
            if status > WARNING:
                return status, FIRST_INPUT + row, step
        h = time[step + 1] - time[step]
        status = call_status(
            functions[_STEP], (component, time[step], h, no_state, flag, flag + 1, flag + 2, reached)
        )
        if status > WARNING:
            return status, _STEP, step
        if flags[2] != 0:
            return EARLY, _STEP, step
        if flags[1] != 0 and step < n_steps - 1:
            return ENDED, _STEP, step
        until_output -= 1
        if until_output == 0:
            until_output = output_every
            y_address += y_stride
            status = call_status(functions[_GET], (component, output_list, n_outputs, y_address, n_outputs))
            if status > WARNING:
                return status, _GET, step
    return status, _GET, n_steps - 1
