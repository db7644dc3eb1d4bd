"""Make the recording of the oscillator: `python data/vanderpol/generate.py` rewrites it bit for bit.

The truth is a tight numerical solution of the equations by SciPy, not an answer of the FMU; a voltmeter with
noise reads it.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

HERE = Path(__file__).parent
SEED = 1926
TRUTH = {"mu": 2.3, "period": 8640.0, "amplitude": 3.2, "xStart": -0.6}
NOISE_V = 0.15
STEP_S = 300.0
DAYS = 1


def voltage(time: Array, *, mu: float, period: float, amplitude: float, xStart: float) -> Array:
    """Solve the equations far more tightly than any FMU is asked to.

    Args:
        time: Times from 0 on. Shape (t,). [s]
        mu: Strength of the nonlinearity. [1]
        period: Period of the linear circuit. [s]
        amplitude: Voltage of x = 1. [V]
        xStart: x at the start, where v is 0. [1]

    Returns:
        Voltage, to about 1e-9 of the amplitude. Shape (t,). [V]
    """
    omega = 2.0 * np.pi / period

    def slopes(_: float, state: Array) -> list[float]:
        x, v = state
        return [omega * v, omega * (mu * (1.0 - x * x) * v - x)]

    span = (0.0, float(time[-1]))
    solution = solve_ivp(slopes, span, [xStart, 0.0], "DOP853", t_eval=time, rtol=1e-12, atol=1e-12)
    return amplitude * np.asarray(solution.y[0], dtype=np.float64)


def main() -> None:
    """Write the recording."""
    time = STEP_S * np.arange(DAYS * 86400 / STEP_S + 1)
    measured = voltage(time, **TRUTH) + NOISE_V * np.random.default_rng(SEED).standard_normal(len(time))
    table = np.column_stack([time, measured])
    np.savetxt(HERE / "recording.csv", table, ("%.0f", "%.3f"), ",", header="time_s,U_V", comments="")


if __name__ == "__main__":
    main()
