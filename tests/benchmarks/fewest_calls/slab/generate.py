"""Make the recordings of the slab: `python tests/benchmarks/fewest_calls/slab/generate.py` writes them anew.

The truth has nine temperatures over the thickness where the model has three, and is no answer of the FMU.
"""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]

HERE: Final = Path(__file__).parent
SEED: Final = 1867
TRUTH: Final = {"GBelow": 120.0, "GAbove": 80.0, "GSlab": 90.0, "C": 6.0e6, "depth": 0.2, "TStart": 292.15}
NOISE_K: Final = 0.05
KELVIN: Final = 273.15
DAYS: Final = 4
STEP_S: Final = 600.0
N_NODES: Final = 9


def answer(rooms: Array, step_s: float, theta: dict[str, float]) -> Array:
    """Solve the nine equations exactly for inputs that are constant over each step.

    Args:
        rooms: Temperature of the room below and above over each step. Shape (m, 2). [K]
        step_s: Length of a step. [s]
        theta: All parameters of the FMU.

    Returns:
        Temperature at the sensor, at the edges of the steps. Shape (m + 1,). [K]
    """
    p, n = theta, N_NODES
    inner = np.full(n - 1, p["GSlab"] * (n - 1))
    capacity = np.full(n, p["C"] / (n - 1))
    capacity[[0, -1]] /= 2.0
    flows = np.diag(inner, 1) + np.diag(inner, -1)
    drive = np.zeros((n, 2))
    drive[0, 0], drive[-1, 1] = p["GBelow"], p["GAbove"]
    flows -= np.diag(flows.sum(axis=1) + drive.sum(axis=1))
    # Van Loan: the exponential of states and held inputs together.
    generator = np.zeros((n + 2, n + 2))
    generator[:n] = np.hstack([flows, drive]) / capacity[:, None]
    step = expm(generator * step_s)[:n]
    states = np.full((len(rooms) + 1, n), p["TStart"])
    for k, row in enumerate(rooms):
        states[k + 1] = step @ np.concatenate([states[k], row])
    place = p["depth"] * (n - 1)
    below = min(int(place), n - 2)
    share = place - below
    return np.asarray((1.0 - share) * states[:, below] + share * states[:, below + 1])


def used_alike(rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw two rooms on one schedule. Time, shape (m,) [s], and temperatures, shape (m, 2) [degC]."""
    time = STEP_S * np.arange(DAYS * 86400 / STEP_S + 1)
    day = (time / 86400.0) % 1.0
    heated = np.where((day > 0.25) & (day < 0.85), 21.5, 17.0)
    rooms = np.full((len(time), 2), 18.0)
    for k in range(1, len(time)):
        rooms[k] = rooms[k - 1] + 0.08 * (heated[k] - rooms[k - 1]) + 0.06 * rng.standard_normal(2)
    return time, np.round(rooms, 2)


def main() -> None:
    """Write inputs and measurements."""
    rng = np.random.default_rng(SEED)
    time, rooms = used_alike(rng)
    truth = answer(rooms[:-1] + KELVIN, STEP_S, TRUTH)
    sensor = truth - KELVIN + NOISE_K * rng.standard_normal(len(time))
    _write("inputs.csv", "time_s,TBelow_degC,TAbove_degC", np.column_stack([time, rooms]))
    _write("measured.csv", "time_s,TSensor_degC", np.column_stack([time, sensor]))


def _write(name: str, header: str, rows: Array) -> None:
    lines = [",".join([f"{row[0]:.0f}", *(f"{value:.2f}" for value in row[1:])]) for row in rows]
    (HERE / name).write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
