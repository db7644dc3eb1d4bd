"""Make the virtual measurement: `python data/office/generate.py` rewrites its two CSV files bit for bit.

Weather, schedules and people are drawn from a fixed seed, the sun comes from pvlib, the room answers through
the white-box FMU in fmus/office-whitebox, and a sensor with noise and bias reads its temperature.
"""

import argparse
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from grid import DAY_S, RECORDED_DAYS, STEP_S, Array, hour_of_day, red_noise, time_grid
from operation import Operation, make_operation
from weather import KELVIN, Weather, make_weather

ROOT = Path(__file__).resolve().parents[2]
FMU = ROOT / "fmus" / "office-whitebox" / "WhiteBoxOffice.fmu"
RECORDING = "recording_1800s.csv"
OCCUPANCY = "occupancy_600s.csv"

SEED = 20180225
RECORDING_STEP_S = 1800
OCCUPANCY_STEP_S = 600
SENSOR_BIAS_K = 0.2
SENSOR_NOISE_K = 0.05
SENSOR_DRIFT_K = 0.03


def boundary_signals(weather: Weather, operation: Operation) -> dict[str, Array]:
    """Name weather and operation as the inputs of the white-box FMU, in its units. Shapes (t,)."""
    return {
        "TAmb": weather.outdoor + KELVIN,
        "TSky": weather.sky + KELVIN,
        "vWind": weather.wind,
        "IBeam": weather.facade_beam,
        "IDiffuse": weather.facade_diffuse,
        "cosIncidence": weather.cos_incidence,
        "TSupTAC": operation.ceiling_supply + KELVIN,
        "ySupTAC": operation.ceiling_on,
        "TSupMV": operation.ventilation_supply + KELVIN,
        "ySupMV": operation.ventilation_on,
        "nPeople": operation.people,
        "QEquipment": operation.equipment,
        "QLight": operation.light,
        "AOpen": operation.window_opening,
    }


def simulate_room(t: Array, signals: dict[str, Array], fmu: Path = FMU, output: str = "TSensor") -> Array:
    """Let the white-box FMU answer.

    Args:
        t: Start of each step. Shape (t,). [s]
        signals: Inputs of the FMU, held over each step.
        fmu: The white-box FMU, used in co-simulation.
        output: The temperature to return.

    Returns:
        The temperature at the start of each step. Shape (t,). [K]
    """
    description = read_model_description(str(fmu))
    reference = {variable.name: variable.valueReference for variable in description.modelVariables}
    inputs = [reference[name] for name in signals]
    rows = np.column_stack(list(signals.values())).tolist()
    answer = np.empty(t.size)
    folder = extract(str(fmu))
    try:
        slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="office",
        )
        slave.instantiate()
        slave.setupExperiment(startTime=float(t[0]))
        slave.enterInitializationMode()
        slave.setReal(inputs, rows[0])
        slave.exitInitializationMode()
        for i, row in enumerate(rows):
            slave.setReal(inputs, row)
            answer[i] = slave.getReal([reference[output]])[0]
            slave.doStep(currentCommunicationPoint=float(t[i]), communicationStepSize=float(STEP_S))
        slave.terminate()
        slave.freeInstance()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return answer


def half_hour_mean(series: Array) -> Array:
    """Average a series over the half hour around the start of each step. Shape (t,)."""
    half = RECORDING_STEP_S // STEP_S // 2
    total = np.concatenate([[0.0], np.cumsum(np.pad(series, half, mode="edge"))])
    mean: Array = (total[2 * half :] - total[: -2 * half])[:-1] / (2 * half)
    return mean


def read_sensors(
    rng: np.random.Generator, t: Array, weather: Weather, operation: Operation, room: Array
) -> pd.DataFrame:
    """Read the sensors of the building automation each half hour.

    Weather and supply temperatures are half-hour means around the time stamp, on/off signals what they are at
    that moment. The room sensor adds noise, slow drift and a constant bias.

    Args:
        rng: Source of the sensor's errors.
        t: Start of each step. Shape (t,). [s]
        weather: Weather on the same grid.
        operation: Services on the same grid.
        room: Temperature of an errorless room sensor. Shape (t,). [degC]

    Returns:
        The recording, one row each half hour from time zero.
    """
    drift = SENSOR_DRIFT_K * red_noise(rng, t.size, 2 * DAY_S)
    noise = SENSOR_NOISE_K * rng.standard_normal(t.size)
    rows = np.flatnonzero((t >= 0) & (np.mod(t, RECORDING_STEP_S) == 0))
    return pd.DataFrame(
        {
            "time_s": t[rows].astype(np.int64),
            "TRoom_degC": (room + SENSOR_BIAS_K + drift + noise)[rows],
            "TEnv_degC": half_hour_mean(weather.outdoor)[rows],
            "TSupply_degC": half_hour_mean(operation.ceiling_supply)[rows],
            "FlowSupply": operation.ceiling_on[rows].astype(np.int64),
            "TRLTSupply_degC": half_hour_mean(operation.ventilation_supply)[rows],
            "RLTFlow": operation.ventilation_on[rows].astype(np.int64),
            "IrrGH_W_m2": half_hour_mean(weather.horizontal)[rows],
        }
    )


def guess_occupancy(rng: np.random.Generator, t: Array, operation: Operation) -> pd.DataFrame:
    """Estimate occupancy as a building would: presence in the room times the load of the whole building.

    Args:
        rng: Source of the load's variation.
        t: Start of each step. Shape (t,). [s]
        operation: Who is really there.

    Returns:
        Occupancy between 0 and 1, one row every ten minutes from time zero.
    """
    load = 0.82 + 0.18 * np.cos(2 * np.pi * (hour_of_day(t) - 13.0) / 12.0)
    load += 0.08 * red_noise(rng, t.size, 3600.0)
    last = RECORDED_DAYS * DAY_S - RECORDING_STEP_S
    rows = np.flatnonzero((t >= 0) & (t <= last) & (np.mod(t, OCCUPANCY_STEP_S) == 0))
    presence = operation.people[rows[:, None] + np.arange(OCCUPANCY_STEP_S // STEP_S)].mean(axis=1)
    occupancy = np.clip(presence * load[rows], 0.0, 1.0)
    return pd.DataFrame({"time_s": t[rows].astype(np.int64), "Occupancy": occupancy})


def make_measurement() -> tuple[Array, Weather, Operation]:
    """Draw weather and operation of the measurement: grid (shape (t,), s), weather, operation."""
    t = time_grid()
    weather_rng, operation_rng = np.random.default_rng([SEED, 0]), np.random.default_rng([SEED, 1])
    weather = make_weather(weather_rng, t)
    return t, weather, make_operation(operation_rng, t, weather)


def generate(folder: Path) -> None:
    """Write the recording and the occupancy into a folder, which is made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    t, weather, operation = make_measurement()
    room = simulate_room(t, boundary_signals(weather, operation)) - KELVIN
    tables = {
        RECORDING: read_sensors(np.random.default_rng([SEED, 2]), t, weather, operation, room),
        OCCUPANCY: guess_occupancy(np.random.default_rng([SEED, 3]), t, operation),
    }
    for name, table in tables.items():
        # Four decimals: far below any sensor, far above what another machine's rounding may change.
        text = table.to_csv(index=False, float_format="%.4f", lineterminator="\n")
        (folder / name).write_bytes(text.encode())


def main() -> None:
    """Parse the command line and generate."""
    parser = argparse.ArgumentParser(description="Rewrite the two CSV files of the virtual measurement.")
    here = Path(__file__).parent
    parser.add_argument("--to", type=Path, default=here, metavar="FOLDER", help="where they go")
    generate(parser.parse_args().to)


if __name__ == "__main__":
    main()
