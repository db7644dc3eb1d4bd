"""A heated tank from a tool that is not ours: CasADi's exporter, FMI 3.0, model exchange only."""

import os
import shutil
from pathlib import Path

import fmpy
import numpy as np
import pytest

HEAT_J_K, LOSS_W_K, EFFICIENCY, START_K = 3.1e5, 17.0, 0.83, 296.0
STEP_S, N_STEPS = 600.0, 144


def build_heated_tank(folder: Path) -> Path:
    """Export the FMU; skips the test where there is no C compiler."""
    if shutil.which("gcc") is None or fmpy.platform != "linux64":
        pytest.skip("needs gcc on Linux to build CasADi's FMU")
    casadi = pytest.importorskip("casadi")
    tank = casadi.DaeBuilder("HeatedTank")
    heat = tank.add(
        "C", "parameter", "tunable", {"start": 2e5, "unit": "J/K", "min": 1.0, "description": "heat capacity"}
    )
    loss = tank.add("UA", "parameter", "tunable", {"start": 12.0, "unit": "W/K", "min": 0.0})
    efficiency = tank.add("eta", "parameter", "tunable", {"start": 0.9, "unit": "1", "min": 0.1, "max": 1.0})
    power = tank.add("P", "input", "continuous", {"start": 0.0, "unit": "W"})
    ambient = tank.add("TAmb", "input", "continuous", {"start": 293.15, "unit": "K"})
    level = tank.add("T", "output", "continuous", {"start": 293.15, "unit": "K", "initial": "exact"})
    tank.eq(tank.der(level), (efficiency * power - loss * (level - ambient)) / heat)
    tank.set_start_time(0.0)
    tank.set_stop_time(STEP_S * N_STEPS)
    tank.set_step_size(STEP_S)
    headers = str(Path(fmpy.__file__).parent / "c-code")
    # CasADi writes into the working directory.
    before = Path.cwd()
    os.chdir(folder)
    try:
        files = tank.compile_fmu(tank.export_fmu({"no_warning": True}), {"include_dirs": [headers]})
        return folder / str(tank.pack_fmu(files))
    finally:
        os.chdir(before)


def write_recordings(folder: Path) -> None:
    """Write inputs in W and degC and a noisy measurement in degC, from the exact solution."""
    time = np.arange(N_STEPS + 1) * STEP_S
    power = np.where((time // 3600.0) % 6 < 2, 2000.0, 0.0)
    ambient = 288.15 + 6.0 * np.sin(2.0 * np.pi * (time / 86400.0 - 0.3))
    y = np.empty(N_STEPS + 1)
    y[0] = START_K
    for i in range(N_STEPS):
        # Over a step both inputs are constant: the mean of a line is its middle.
        target = 0.5 * (ambient[i] + ambient[i + 1]) + EFFICIENCY * power[i] / LOSS_W_K
        y[i + 1] = target + (y[i] - target) * np.exp(-LOSS_W_K / HEAT_J_K * STEP_S)
    y += np.random.default_rng(3).normal(0.0, 0.05, N_STEPS + 1)
    inputs = [
        f"{t:g};{p:g};{a - 273.15:.4f}".replace(".", ",")
        for t, p, a in zip(time, power, ambient, strict=True)
    ]
    measured = [f"{t:g},{value - 273.15:.4f}" for t, value in zip(time, y, strict=True)]
    # As a spreadsheet in a country with a decimal comma writes it.
    (folder / "inputs.csv").write_text("\n".join(["time_s;P;TAmb", *inputs]) + "\n", encoding="utf-8")
    (folder / "measured.csv").write_text("\n".join(["time_s,T", *measured]) + "\n", encoding="utf-8")
