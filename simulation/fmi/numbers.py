"""Numbers that an FMU must not be given, and answers that are none."""

import numpy as np

from simulation.arrays import FloatArray


def wrong_number(names: tuple[str, ...], row: FloatArray) -> str:
    """Say which parameter is no number.

    Args:
        names: Names of the parameters.
        row: Their values. Shape (p,).

    Returns:
        One line, "" when all are numbers.
    """
    finite = np.isfinite(row)
    if finite.all():
        return ""
    column = int(np.argmin(finite))
    return f"parameter {names[column]} is {row[column]}"


def wrong_output(
    names: tuple[str, ...], times: FloatArray, y: FloatArray, *, accepted: FloatArray | None
) -> str:
    """Say which output is no number or outside its band first.

    Args:
        names: Names of the outputs.
        times: Output times. Shape (t,). [s]
        y: The outputs. Shape (t, k). [declared units]
        accepted: Their bands, None for none. Shape (k, 2). [declared units]

    Returns:
        One line, "" when all are good.
    """
    wrong = ~np.isfinite(y)
    outside = np.zeros_like(wrong)
    if accepted is not None:
        outside = (y < accepted[:, 0]) | (y > accepted[:, 1])
    if not (wrong.any() or outside.any()):
        return ""
    step, column = np.argwhere(wrong | outside)[0]
    name, value, time = names[column], y[step, column], times[step]
    if wrong[step, column] or accepted is None:
        return f"output {name} is {value} at {time:g} s"
    low, high = accepted[column]
    return f"output {name} is {value:.6g} at {time:g} s, outside the accepted {low:g} to {high:g}"
