"""Make the recording of the two rooms: `python data/two-rooms/generate.py` rewrites it bit for bit.

The truth is the matrix exponential of the equations, not an answer of the FMU. Eight tests of two days follow
each other, each with another use of the heaters; in the last one the door between the rooms is open.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]

HERE = Path(__file__).parent
SEED = 1768
TRUTH = {
    "C1": 1.3e6, "C2": 8.0e5, "CWall": 5.2e6, "G1": 26.0, "G2": 17.0, "GWall": 62.0, "A1": 1.4, "A2": 0.55,
    "GDoor": 0.0, "T1Start": 294.15, "T2Start": 291.15, "TWallStart": 292.15,
}  # fmt: skip
NOISE_K = 0.05
KELVIN = 273.15
STEP_S = 900.0
N_TESTS, STEPS_OF_A_TEST = 8, 192
DOOR, OPEN_W_PER_K = 7, 40.0


def answer(inputs: Array, step_s: float, theta: dict[str, float]) -> Array:
    """Solve the equations exactly for inputs that are constant over each step.

    Args:
        inputs: Temperature outside [K], radiation [W/m2] and both heaters [W] over each step. Shape (m, 4).
        step_s: Length of a step. [s]
        theta: All parameters of the FMU.

    Returns:
        Temperatures of both rooms and the wall at the edges of the steps. Shape (m + 1, 3). [K]
    """
    p = theta
    flows = np.array(
        [
            [-p["G1"] - p["GWall"] - p["GDoor"], p["GDoor"], p["GWall"]],
            [p["GDoor"], -p["G2"] - p["GWall"] - p["GDoor"], p["GWall"]],
            [p["GWall"], p["GWall"], -2.0 * p["GWall"]],
        ]
    )
    drive = np.array([[p["G1"], p["A1"], 1.0, 0.0], [p["G2"], p["A2"], 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]])
    capacities = np.array([[p["C1"]], [p["C2"]], [p["CWall"]]])
    # Van Loan: the exponential of states and held inputs together.
    generator = np.zeros((7, 7))
    generator[:3] = np.hstack([flows / capacities, drive / capacities])
    step = expm(generator * step_s)[:3]
    states = np.empty((len(inputs) + 1, 3))
    states[0] = p["T1Start"], p["T2Start"], p["TWallStart"]
    for k, row in enumerate(inputs):
        states[k + 1] = step @ np.concatenate([states[k], row])
    return states


def weather_and_heaters(rng: np.random.Generator) -> Array:
    """Draw what drives the rooms over each step of all tests. Shape (m, 4). [degC, W/m2, W, W]."""
    m = N_TESTS * STEPS_OF_A_TEST
    day = STEP_S * np.arange(m) / 86400.0
    slow = np.cumsum(rng.standard_normal(m)) * 0.12
    outdoor = 5.0 + 4.0 * np.sin(2.0 * np.pi * (day - 0.4)) + slow - np.mean(slow)
    clear = rng.uniform(0.2, 1.0, int(np.ceil(day[-1])) + 1)[day.astype(int)]
    sun = clear * 450.0 * np.maximum(np.sin(2.0 * np.pi * (day - 0.27)), 0.0)
    hour = 24.0 * (np.arange(STEPS_OF_A_TEST) / 96.0)
    off = np.zeros(STEPS_OF_A_TEST)

    def pulses(length_h: float, phase_h: float, power_w: float) -> Array:
        return np.where((hour + phase_h) % (2.0 * length_h) < length_h, power_w, 0.0)

    def random(power_w: float) -> Array:
        return power_w * np.repeat(rng.integers(0, 2, STEPS_OF_A_TEST // 6), 6).astype(np.float64)

    tests = [
        (off, off),
        (pulses(6.0, 0.0, 1400.0), off),
        (off, pulses(6.0, 0.0, 1200.0)),
        (pulses(4.0, 0.0, 800.0), pulses(4.0, 4.0, 500.0)),
        (random(900.0), random(600.0)),
        (pulses(12.0, 6.0, 700.0), pulses(12.0, 6.0, 500.0)),
        (random(800.0), pulses(5.0, 2.0, 600.0)),
        (pulses(8.0, 0.0, 1300.0), off),
    ]
    heaters = np.concatenate([np.column_stack(pair) for pair in tests])
    return np.column_stack([np.round(outdoor, 2), np.round(sun, 1), heaters])


def in_kelvin(inputs: Array) -> Array:
    """Return the inputs with the temperature outside in K. Shape (m, 4)."""
    return np.asarray(inputs + np.array([KELVIN, 0.0, 0.0, 0.0]))


def states_of(inputs: Array) -> Array:
    """Return the true states over all tests, the door open in one. Shape (m + 1, 3). [K]."""
    states = [np.array([[TRUTH["T1Start"], TRUTH["T2Start"], TRUTH["TWallStart"]]])]
    for test in range(N_TESTS):
        names = ("T1Start", "T2Start", "TWallStart")
        theta = TRUTH | dict(zip(names, states[-1][-1].tolist(), strict=True))
        theta["GDoor"] = OPEN_W_PER_K if test == DOOR else 0.0
        part = inputs[test * STEPS_OF_A_TEST : (test + 1) * STEPS_OF_A_TEST]
        states.append(answer(in_kelvin(part), STEP_S, theta)[1:])
    return np.concatenate(states)


def main() -> None:
    """Write the recording."""
    rng = np.random.default_rng(SEED)
    inputs = weather_and_heaters(rng)
    rooms = states_of(inputs)[:, :2] - KELVIN
    rooms = rooms + NOISE_K * rng.standard_normal(rooms.shape)
    driven = np.vstack([inputs, inputs[-1:]])
    table = np.column_stack([STEP_S * np.arange(len(driven)), driven, rooms])
    head = "time_s,TOutdoor_degC,sun_W_m2,heater1_W,heater2_W,TRoom1_degC,TRoom2_degC"
    digits = ["%.0f", "%.2f", "%.1f", "%.0f", "%.0f", "%.2f", "%.2f"]
    np.savetxt(HERE / "recording.csv", table, digits, ",", header=head, comments="")


if __name__ == "__main__":
    main()
