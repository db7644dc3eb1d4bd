"""The co-simulation loop, compiled once for every FMU: it calls the FMU's own functions by address.

FMI 2.0's functions are called like FMI 3.0's, with more arguments than they have: on every 64-bit platform
the caller provides and removes arguments, so a C function does not see those beyond its own.
"""

from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.call import call_status, compiled

# Order of the addresses in the array handed to the loop, and of the stages it reports.
FUNCTIONS = ("DoStep", "GetFloat64")
_STEP, _GET = range(2)
# The stages from here on are rows of the inputs' table.
FIRST_INPUT = 2
WARNING = 1
# What the loop returns in place of a status when a step was good and yet not the whole step.
ENDED = 100
EARLY = 101
# Columns of the inputs' table: what is called, with which references, how many, from which values on, and how
# many bytes further for the next step; how many values, more than references where these are of arrays.
FUNCTION, REFERENCES, COUNT, VALUES, STRIDE, N_VALUES = range(6)


@compiled
def set_inputs(component: int, inputs: Any, step: int) -> tuple[int, int]:
    """Set the inputs of a step.

    Args:
        component: Address of the instance.
        inputs: Table of the inputs. Shape (n_functions, 6), intp.
        step: The step.

    Returns:
        Status of the last call (0 or 1 when all went well), and its row of the table.
    """
    for row in range(inputs.shape[0]):
        references, n = inputs[row, REFERENCES], inputs[row, COUNT]
        values = inputs[row, VALUES] + step * inputs[row, STRIDE]
        arguments = (component, references, n, values, inputs[row, N_VALUES])
        status = call_status(inputs[row, FUNCTION], arguments)
        if status > WARNING:
            return status, row
    return 0, 0


@compiled
def step_through(
    functions: Any,
    component: int,
    inputs: Any,
    output_references: Any,
    time: FloatArray,
    output_every: int,
    reached: FloatArray,
    y: FloatArray,
) -> tuple[int, int, int]:
    """Take an initialized instance through the communication steps.

    Args:
        functions: Addresses of FUNCTIONS. Shape (2,), intp.
        component: Address of the instance.
        inputs: Table of the inputs. Shape (n_functions, 6), intp.
        output_references: Value references. Shape (n_references,), uint32.
        time: Edges of the communication steps. Shape (m + 1,). [s]
        output_every: Steps between two outputs.
        reached: Filled with the time that the last step got to (FMI 3.0). Shape (1,). [s]
        y: Filled with the outputs, contiguous. Shape (t, n_values). [model's units]

    Returns:
        Status of the last call (0 or 1 when all went well; ENDED where the FMU wants no further step, EARLY
        where it stopped within one), its stage, and its step.
    """
    n_outputs, n_values, n_steps = output_references.size, y.shape[1], time.size - 1
    # Addresses are reckoned once: the view of a row costs as much as a step of a small model. They are made
    # signed, as numba adds an unsigned and a signed integer to a float.
    y_stride = n_values * y.itemsize
    y_address = np.intp(y.ctypes.data)
    output_list = output_references.ctypes.data
    # Three C bools: event handling needed, simulation to be terminated, returned early.
    flags = np.zeros(3, dtype=np.uint8)
    flag, reach = np.intp(flags.ctypes.data), reached.ctypes.data
    # One turn more than steps: the first output lies at the first edge, before any step.
    for step in range(n_steps + 1):
        if step % output_every == 0:
            status = call_status(functions[_GET], (component, output_list, n_outputs, y_address, n_values))
            if status > WARNING:
                return status, _GET, max(0, step - 1)
            y_address += y_stride
        if step == n_steps:
            break
        status, row = set_inputs(component, inputs, step)
        if status > WARNING:
            return status, FIRST_INPUT + row, step
        h = time[step + 1] - time[step]
        status = call_status(
            functions[_STEP],
            # 1: no state of an earlier time will be set, so that the FMU may drop what lies behind.
            (component, time[step], h, 1, flag, flag + 1, flag + 2, reach),
        )
        if status > WARNING:
            return status, _STEP, step
        if flags[2] != 0:
            return EARLY, _STEP, step
        # An FMU that ends with the last step has answered the whole row.
        if flags[1] != 0 and step < n_steps - 1:
            return ENDED, _STEP, step
    return 0, _GET, n_steps
