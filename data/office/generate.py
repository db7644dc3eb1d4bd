"""Make the virtual measurement: `python data/office/generate.py` rewrites its two CSV files bit for bit.

Weather, schedules and people are drawn from a fixed seed, the sun comes from pvlib, the room answers through
the white-box FMU in fmus/office-whitebox, and a sensor with noise and bias reads its temperature.
"""

import argparse
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
from boundary import DAY_S, KELVIN, RECORDED_DAYS, STEP_S, Array, hour_of_day, make_boundary, red_noise
from fmpy import extract, instantiate_fmu, read_model_description

FMU = Path(__file__).resolve().parents[2] / "fmus" / "office-whitebox" / "WhiteBoxOffice.fmu"
RECORDING = "recording_1800s.csv"
OCCUPANCY = "occupancy_600s.csv"

SEED = 20180225
RECORDING_STEP_S = 1800
OCCUPANCY_STEP_S = 600
SENSOR_BIAS_K = 0.2
SENSOR_NOISE_K = 0.05
SENSOR_DRIFT_K = 0.03


def simulate_room(boundary: pd.DataFrame) -> Array:
    """Let the white-box FMU answer by co-simulation, with inputs that are held over each step.

    Args:
        boundary: Its inputs.

    Returns:
        The temperature of an errorless sensor at the start of each step. Shape (t,). [degC]
    """
    inputs = boundary.drop(columns="IHorizontal")
    inputs[[name for name in inputs if name.startswith("T")]] += KELVIN
    description = read_model_description(str(FMU))
    reference = {variable.name: variable.valueReference for variable in description.modelVariables}
    references, rows = [reference[name] for name in inputs], inputs.to_numpy().tolist()
    answer, t = np.empty(len(rows)), inputs.index.tolist()
    folder = extract(str(FMU))
    try:
        fmu = instantiate_fmu(folder, description, "CoSimulation")
        fmu.setupExperiment(startTime=t[0])
        fmu.enterInitializationMode()
        fmu.setReal(references, rows[0])
        fmu.exitInitializationMode()
        for i, row in enumerate(rows):
            fmu.setReal(references, row)
            answer[i] = fmu.getReal([reference["TSensor"]])[0]
            fmu.doStep(currentCommunicationPoint=t[i], communicationStepSize=float(STEP_S))
        fmu.terminate()
        fmu.freeInstance()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return answer - KELVIN


def half_hour_mean(series: Array) -> Array:
    """Average a series over the half hour around the start of each step. Shape (t,)."""
    half = RECORDING_STEP_S // STEP_S // 2
    total = np.concatenate([[0.0], np.cumsum(np.pad(series, half, mode="edge"))])
    mean: Array = (total[2 * half :] - total[: -2 * half])[:-1] / (2 * half)
    return mean


def read_sensors(rng: np.random.Generator, boundary: pd.DataFrame, room: Array) -> pd.DataFrame:
    """Read the sensors of the building automation each half hour.

    Weather and supply temperatures are half-hour means around the time stamp, on/off signals what they are at
    that moment. The room sensor adds noise, slow drift and a constant bias.

    Args:
        rng: Source of the sensor's errors.
        boundary: What acted on the room.
        room: Temperature of an errorless room sensor. Shape (t,). [degC]

    Returns:
        The recording, one row each half hour from time zero.
    """
    t = boundary.index.to_numpy()
    drift = SENSOR_DRIFT_K * red_noise(rng, t.size, 2 * DAY_S)
    noise = SENSOR_NOISE_K * rng.standard_normal(t.size)

    def mean(name: str) -> Array:
        return half_hour_mean(boundary[name].to_numpy())

    read = {
        "time_s": t.astype(np.int64),
        "TRoom_degC": room + SENSOR_BIAS_K + drift + noise,
        "TEnv_degC": mean("TAmb"),
        "TSupply_degC": mean("TSupTAC"),
        "FlowSupply": boundary["ySupTAC"].to_numpy().astype(np.int64),
        "TRLTSupply_degC": mean("TSupMV"),
        "RLTFlow": boundary["ySupMV"].to_numpy().astype(np.int64),
        "IrrGH_W_m2": mean("IHorizontal"),
    }
    return pd.DataFrame(read)[(t >= 0) & (np.mod(t, RECORDING_STEP_S) == 0)]


def guess_occupancy(rng: np.random.Generator, boundary: pd.DataFrame) -> pd.DataFrame:
    """Estimate occupancy as a building would: presence in the room times the load of the whole building.

    Args:
        rng: Source of the load's variation.
        boundary: What acted on the room, with who is really there.

    Returns:
        Occupancy between 0 and 1, one row every ten minutes from time zero.
    """
    t, people = boundary.index.to_numpy(), boundary["nPeople"].to_numpy()
    load = 0.82 + 0.18 * np.cos(2 * np.pi * (hour_of_day(t) - 13.0) / 12.0)
    load += 0.08 * red_noise(rng, t.size, 3600.0)
    last = RECORDED_DAYS * DAY_S - RECORDING_STEP_S
    rows = np.flatnonzero((t >= 0) & (t <= last) & (np.mod(t, OCCUPANCY_STEP_S) == 0))
    presence = people[rows[:, None] + np.arange(OCCUPANCY_STEP_S // STEP_S)].mean(axis=1)
    occupancy = np.clip(presence * load[rows], 0.0, 1.0)
    return pd.DataFrame({"time_s": t[rows].astype(np.int64), "Occupancy": occupancy})


def main() -> None:
    """Write the recording and the occupancy into a folder, which is made if need be."""
    parser = argparse.ArgumentParser(description="Rewrite the two CSV files of the virtual measurement.")
    here = Path(__file__).parent
    parser.add_argument("--to", type=Path, default=here, metavar="FOLDER", help="where they go")
    folder = parser.parse_args().to
    folder.mkdir(parents=True, exist_ok=True)
    weather, operation, sensors, load = (np.random.default_rng([SEED, k]) for k in range(4))
    boundary = make_boundary(weather, operation)
    tables = {
        RECORDING: read_sensors(sensors, boundary, simulate_room(boundary)),
        OCCUPANCY: guess_occupancy(load, boundary),
    }
    for name, table in tables.items():
        # Four decimals: far below any sensor, far above what another machine's rounding may change.
        text = table.to_csv(index=False, float_format="%.4f", lineterminator="\n")
        (folder / name).write_bytes(text.encode())


if __name__ == "__main__":
    main()
