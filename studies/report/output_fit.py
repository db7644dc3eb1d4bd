"""How one output of a trajectory differs from its measurement: RMSE, bias, NRMSE, CV(RMSE) and NMBE.

CV(RMSE) is the root mean square difference over the size of the mean measured value, NMBE the mean difference
over it. Both sums are divided by n - 1, as in ASHRAE guideline 14 (2014). NRMSE is the root mean square
difference over the range of the measured values.
"""

import math

import numpy as np

from simulation.arrays import FloatArray
from simulation.measurement import Measurement
from studies.report.wording import difference_unit
from studies.stages.stage_results import OutputFit


def output_fit(measurement: Measurement, output: int, unit: str, y: FloatArray) -> OutputFit:
    """Return how one output of a trajectory differs from its measurement.

    Args:
        measurement: What was measured.
        output: Position of the output.
        unit: Unit of the output.
        y: The trajectory, finite. Shape (t, k). [units]
    """
    difference = measurement.differences(y[None], output)[0]
    rmse, bias = float(np.sqrt(np.mean(difference**2))), float(np.mean(difference))
    values = measurement.samples[output].values
    if output not in measurement.measured:
        return OutputFit(len(values), rmse, bias, None, None)
    span = float(np.ptp(values))
    nrmse = rmse / span if span > 0.0 else None
    # Of what is negative where it is taken out, as cooling is, the size counts.
    n, mean = len(values), abs(float(np.mean(values)))
    is_temperature = difference_unit(unit) == "K" or unit == "degF"
    if is_temperature or mean == 0.0 or n == 1:
        return OutputFit(n, rmse, bias, None, None, nrmse)
    return OutputFit(n, rmse, bias, rmse / mean * math.sqrt(n / (n - 1)), bias / mean * n / (n - 1), nrmse)
