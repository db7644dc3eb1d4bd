"""Make the recordings of the heated room: `python data/thermostat/generate.py` rewrites them bit for bit.

The truth is the closed form between two switchings, whose times are found by root finding; it is no answer of
the FMU. A thermometer with noise and an energy meter that shows whole hundredths of a kWh read it.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

Array = NDArray[np.float64]

HERE = Path(__file__).parent
SEED = 1883
TRUTH = {
    "C": 1.5e6, "CWall": 6.0e6, "G": 16.0, "GWall": 110.0, "GOut": 25.0, "PHeat": 2800.0,
    "TSet": 294.15, "band": 1.6, "TStart": 294.15, "TWallStart": 290.15,
}  # fmt: skip
NOISE_K = 0.05
METER_KWH = 0.01
KELVIN = 273.15
JOULE_PER_KWH = 3.6e6
DAYS = 2
STEP_S = 300.0
# A crossing is looked for between points this far apart.
_LOOK_S = 30.0


def answer(outside: Array, step_s: float, theta: dict[str, float]) -> tuple[Array, int]:
    """Solve the equations in closed form from switching to switching, the weather held over each step.

    Args:
        outside: Temperature outside over each step. Shape (m,). [K]
        step_s: Length of a step. [s]
        theta: All parameters of the FMU.

    Returns:
        Temperature of the air [K] and energy [J] at the edges of the steps, shape (m + 1, 2); and how often
        the heater switched.
    """
    p = theta
    matrix = np.array(
        [
            [-(p["G"] + p["GWall"]) / p["C"], p["GWall"] / p["C"]],
            [p["GWall"] / p["CWall"], -(p["GWall"] + p["GOut"]) / p["CWall"]],
        ]
    )
    rates, modes = np.linalg.eig(matrix)
    state, on, energy, n_switchings = np.array([p["TStart"], p["TWallStart"]]), 1, 0.0, 0
    answers = [(state[0], energy)]
    for temperature in outside:
        left = step_s
        while True:
            source = [(on * p["PHeat"] + p["G"] * temperature) / p["C"], p["GOut"] * temperature / p["CWall"]]
            rest = -np.linalg.solve(matrix, source)
            shares = np.linalg.solve(modes, state - rest)
            limit, sign = p["TSet"] + (0.5 - (1 - on)) * p["band"], 2 * on - 1

            def beyond(h: float, rest=rest, shares=shares, limit=limit, sign=sign) -> float:
                return float(sign * (rest[0] + modes[0] @ (shares * np.exp(rates * h)) - limit))

            points = np.append(np.arange(0.0, left, _LOOK_S), left)
            above = np.array([beyond(h) > 0.0 for h in points])
            # Right at a switching the temperature lies on the other limit's far side, never beyond this one.
            span = left if not above.any() else _crossing(beyond, points, int(np.argmax(above)))
            state = rest + modes @ (shares * np.exp(rates * span))
            energy += on * p["PHeat"] * span
            left -= span
            if not above.any():
                break
            on, n_switchings = 1 - on, n_switchings + 1
        answers.append((state[0], energy))
    return np.array(answers), n_switchings


def _crossing(beyond, points: Array, first: int) -> float:
    return float(brentq(beyond, points[first - 1], points[first], xtol=1e-10, rtol=1e-15))


def main() -> None:
    """Write weather and measurements into one file."""
    rng = np.random.default_rng(SEED)
    time = STEP_S * np.arange(DAYS * 86400 / STEP_S + 1)
    day = time / 86400.0
    slow = np.cumsum(rng.standard_normal(len(time))) * 0.04
    outside = np.round(2.0 + 4.0 * np.sin(2.0 * np.pi * (day - 0.4)) + slow - np.mean(slow), 2)
    truth, _ = answer(outside[:-1] + KELVIN, STEP_S, TRUTH)
    air = truth[:, 0] - KELVIN + NOISE_K * rng.standard_normal(len(time))
    meter = np.floor(truth[:, 1] / JOULE_PER_KWH / METER_KWH) * METER_KWH
    table, forms = np.column_stack([time, outside, air, meter]), ("%.0f", "%.2f", "%.2f", "%.2f")
    header = "time_s,TOutdoor_degC,TAir_degC,meter_kWh"
    np.savetxt(HERE / "recording.csv", table, forms, ",", header=header, comments="")


if __name__ == "__main__":
    main()
