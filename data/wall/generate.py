"""Make the recordings of the wall: `python data/wall/generate.py` rewrites them bit for bit.

The truth is the matrix exponential of the equations, not an answer of the FMU. Two sensors read it, each with
noise, at times of their own and with gaps.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]

HERE = Path(__file__).parent
SEED = 1822
TRUTH = {
    "GIn": 60.0, "G12": 14.0, "G23": 7.5, "GOut": 200.0, "C1": 3.0e5, "C2": 2.6e6, "C3": 6.0e5,
    "T1Start": 293.15, "T2Start": 285.65, "T3Start": 278.15,
}  # fmt: skip
NOISE_K = 0.05
NOISE_W = 2.0
KELVIN = 273.15
DAYS = 7
INPUT_STEP_S = 1800.0
FINE_STEP_S = 60.0


def answer(inputs: Array, step_s: float, theta: dict[str, float]) -> Array:
    """Solve the equations exactly for inputs that are constant over each step.

    Args:
        inputs: Temperature of the room and of the weather over each step. Shape (m, 2). [K]
        step_s: Length of a step. [s]
        theta: All parameters of the FMU.

    Returns:
        Temperature of the masonry [K] and heat flow from the room into the wall [W] at the edges of the
        steps, the flow under the input of the step that begins (at the end: that ended). Shape (m + 1, 2).
    """
    p = theta
    flows = np.array(
        [
            [-p["GIn"] - p["G12"], p["G12"], 0.0],
            [p["G12"], -p["G12"] - p["G23"], p["G23"]],
            [0.0, p["G23"], -p["G23"] - p["GOut"]],
        ]
    )
    drive = np.array([[p["GIn"], 0.0], [0.0, 0.0], [0.0, p["GOut"]]])
    capacities = np.array([[p["C1"]], [p["C2"]], [p["C3"]]])
    # Van Loan: the exponential of states and held inputs together.
    generator = np.zeros((5, 5))
    generator[:3] = np.hstack([flows / capacities, drive / capacities])
    step = expm(generator * step_s)[:3]
    states = np.empty((len(inputs) + 1, 3))
    states[0] = p["T1Start"], p["T2Start"], p["T3Start"]
    for k, row in enumerate(inputs):
        states[k + 1] = step @ np.concatenate([states[k], row])
    room = np.append(inputs[:, 0], inputs[-1, 0])
    return np.column_stack([states[:, 1], p["GIn"] * (room - states[:, 0])])


def weather_and_room(rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw both temperatures every half an hour. Time [s], shape (m,), and values, shape (m, 2). [degC]."""
    time = INPUT_STEP_S * np.arange(DAYS * 86400 / INPUT_STEP_S + 1)
    day = time / 86400.0
    slow = np.cumsum(rng.standard_normal(len(time))) * 0.25
    outdoor = 4.0 + 5.0 * np.sin(2.0 * np.pi * (day - 0.4)) + slow - np.mean(slow)
    occupied = ((day % 1.0) > 0.27) & ((day % 1.0) < 0.9)
    heated = np.where(occupied, 21.5, 17.5)
    room = np.empty_like(heated)
    room[0] = 20.0
    for k in range(1, len(room)):
        room[k] = room[k - 1] + 0.12 * (heated[k] - room[k - 1]) + 0.1 * rng.standard_normal()
    return time, np.round(np.column_stack([room, outdoor]), 2)


def main() -> None:
    """Write inputs and measurements."""
    rng = np.random.default_rng(SEED)
    time, temperatures = weather_and_room(rng)
    fine = FINE_STEP_S * np.arange(DAYS * 86400 / FINE_STEP_S + 1)
    middles = 0.5 * (fine[1:] + fine[:-1])
    held = np.column_stack([np.interp(middles, time, column) for column in temperatures.T]) + KELVIN
    truth = answer(held, FINE_STEP_S, TRUTH)
    # A logger that wakes up every 25 to 45 minutes, and loses a reading now and then.
    wakes = np.cumsum(rng.integers(25, 46, size=400) * 60)
    wakes = np.concatenate([[0], wakes[wakes < DAYS * 86400], [DAYS * 86400]])
    at = (wakes / FINE_STEP_S).astype(int)
    masonry = truth[at, 0] - KELVIN + NOISE_K * rng.standard_normal(len(at))
    flow = truth[at, 1] + NOISE_W * rng.standard_normal(len(at))
    lost = rng.random((len(at), 2)) < [0.04, 0.08]
    # The heat flow plate was off for half a day.
    lost[(wakes > 2.5 * 86400) & (wakes < 3.0 * 86400), 1] = True
    rows = [
        f"{t:.0f},{'' if gone_t else f'{temperature:.2f}'},{'' if gone_q else f'{q:.1f}'}"
        for t, temperature, q, (gone_t, gone_q) in zip(wakes, masonry, flow, lost, strict=True)
    ]
    text = "\n".join(["time_s,TMasonry_degC,QRoom_W", *rows, ""])
    (HERE / "measured.csv").write_text(text, encoding="utf-8")
    table, header = np.column_stack([time, temperatures]), "time_s,TRoom_degC,TOutdoor_degC"
    np.savetxt(HERE / "inputs.csv", table, ("%.0f", "%.2f", "%.2f"), ",", header=header, comments="")


if __name__ == "__main__":
    main()
