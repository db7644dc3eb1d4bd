"""A made-up recording: sines and squares that look like an office in winter, and nothing measured."""

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

N_DAYS = 22
CSV_COLUMNS = {
    "TRoom": "TRoom_degC",
    "TEnv": "TEnv_degC",
    "TSupply": "TSupply_degC",
    "FlowSupply": "FlowSupply",
    "TRLTSupply": "TRLTSupply_degC",
    "RLTFlow": "RLTFlow",
    "IrrGH": "IrrGH_W_m2",
    "Occupancy": "Occupancy",
}
SWITCHES = ("FlowSupply", "RLTFlow")


def made_up_recording(n_days: int = N_DAYS) -> dict[str, tuple[Array, Array]]:
    """Return (time, values) per published variable."""
    coarse, fine = np.arange(0.0, n_days * 86400.0, 1800.0), np.arange(0.0, n_days * 86400.0, 600.0)
    day = 2.0 * np.pi * coarse / 86400.0
    hour, fine_hour = coarse % 86400.0 / 3600.0, fine % 86400.0 / 3600.0
    work = (hour >= 6.0) & (hour < 18.0)
    values = {
        "TRoom": 22.5 - 0.8 * np.cos(day - 0.9) + 0.2 * np.sin(day / 7.0),
        "TEnv": -2.0 - 4.0 * np.cos(day - 0.7) + 2.0 * np.sin(day / 5.0),
        "TSupply": 28.0 + 2.0 * np.cos(day),
        "FlowSupply": work.astype(np.float64),
        "TRLTSupply": 20.5 + 0.5 * np.sin(day),
        "RLTFlow": ((hour >= 7.0) & (hour < 17.0)).astype(np.float64),
        "IrrGH": np.maximum(0.0, -220.0 * np.cos(day)),
    }
    recording = {name: (coarse.copy(), series) for name, series in values.items()}
    recording["Occupancy"] = (fine, np.clip(np.sin(np.pi * (fine_hour - 8.0) / 9.0), 0.0, 1.0))
    return recording


def write_csv_files(folder: Path, n_days: int = N_DAYS) -> None:
    """Write the two CSV files of a case."""
    folder.mkdir(parents=True)
    for name, text in _csv_files(n_days).items():
        (folder / name).write_text(text, encoding="utf-8")


@cache
def _csv_files(n_days: int) -> dict[str, str]:
    recording = made_up_recording(n_days)
    occupancy = {"Occupancy": recording.pop("Occupancy")}
    return {"recording_1800s.csv": _as_csv(recording), "occupancy_600s.csv": _as_csv(occupancy)}


def _as_csv(series: dict[str, tuple[Array, Array]]) -> str:
    time = next(iter(series.values()))[0]
    lines = [",".join(["time_s", *(CSV_COLUMNS[name] for name in series)])]
    for row, second in enumerate(time):
        cells = [
            f"{values[row]:.0f}" if name in SWITCHES else f"{values[row] + 0.0:.6f}"
            for name, (_, values) in series.items()
        ]
        lines.append(",".join([f"{second:.0f}", *cells]))
    return "\n".join(lines) + "\n"
