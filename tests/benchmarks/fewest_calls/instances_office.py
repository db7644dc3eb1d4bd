"""Seeded instances of the office: a truth of ten states that the grey box of four cannot fit exactly."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.linalg import expm

from fewest_calls.instances import Instance
from fewest_calls.noise import red_noise
from simulation import Case, Measurement, load_case
from simulation.arrays import FloatArray
from simulation.samples import Samples

ROOT = Path(__file__).parents[3]
WINDOWS_D = ((0.0, 10.0), (8.0, 16.0), (0.0, 21.0))
SWITCH_ON = 0.1
# Air, furniture, masses (2), wall (3), ceiling and its core, sensor.
N_STATES = 10
SENSOR = 9


def office_instance(seed: int) -> Instance:
    """Draw parameters, structure, disturbances and sensor from a seed.

    The truth has ten states where the grey box has four, other gains, occupants and weather than the grey
    box is given, a sensor with a time constant, and noise (AR(1) and white).
    """
    rng = np.random.default_rng([2023, seed])
    window_d = WINDOWS_D[int(rng.integers(len(WINDOWS_D)))]
    case = load_case(ROOT / "fmus" / "office", window_d=window_d)
    u = rng.uniform(0.15, 0.85, case.parameter_space.n_parameters)
    theta = case.parameter_space.from_unit(u)
    room = _truth(case, dict(zip(case.parameter_space.names, theta, strict=True)), rng)
    noise = red_noise(rng, room.size, rng.uniform(3.0, 24.0)) * rng.uniform(0.02, 0.06)
    y = room + noise + rng.uniform(0.01, 0.04) * rng.standard_normal(room.size)
    measured = replace(case.outputs[0], samples=Samples(case.measurement.time, y))
    measurement = Measurement(case.measurement.time, (measured,))
    return Instance(replace(case, measurement=measurement, references=()), u)


def _truth(case: Case, p: dict[str, float], rng: np.random.Generator) -> FloatArray:
    """Simulate the detailed room from the case's inputs, disturbed. Shape (t,). [degC]."""
    scenario = case.scenario
    step = float(scenario.time_communication[1] - scenario.time_communication[0])
    hour = (scenario.time_communication[:-1] / 3600.0) % 24.0
    signal = dict(zip(scenario.input_names, scenario.inputs.T, strict=True))
    n = hour.size
    start = float(case.settings.fixed["TAirInit"])
    outdoor = signal["TAmb"] + rng.uniform(0.2, 0.6) * red_noise(rng, n, 60.0)
    sun = signal["HGlo"] * (1.0 + rng.uniform(-0.35, 0.35) * np.cos(np.pi * (hour - 12.0) / 6.0))
    people = signal["occ"] * np.clip(1.0 + rng.uniform(0.1, 0.3) * red_noise(rng, n, 36.0), 0.0, None)
    devices = rng.uniform(0.0, 25.0) * np.exp(-0.5 * ((hour - 13.0) / 3.0) ** 2)
    leak = rng.uniform(0.5, 2.0) * (1.0 + 0.5 * red_noise(rng, n, 36.0))
    # Heat flows that the switches do not touch, and temperatures around. [W], [K]
    solar, gain = p["fSol"] * sun, p["qIntOcc"] * 12.72 * people + devices
    to_air, to_masses = rng.uniform(0.05, 0.3), rng.uniform(0.2, 0.5)
    heat = np.zeros((n, N_STATES))
    heat[:, 0] = to_air * solar + to_masses * gain + leak * (outdoor - start)
    heat[:, 2] = (1.0 - to_air) * solar + 0.8 * (1.0 - to_masses) * gain
    heat[:, 1] = 0.2 * (1.0 - to_masses) * gain
    around = np.stack(
        [outdoor, outdoor + rng.uniform(0.01, 0.04) * sun, signal["TSupMV"], signal["TSupTAC"]], 1
    )
    capacity, inside, outside = _network(p, rng)
    x = np.full(N_STATES, start)
    x[4:7] = 280.0 + rng.normal(0.0, 2.0, 3)
    x[7:9] = p["TTABSInit"] + rng.normal(0.0, 0.5, 2)
    steps = {}
    answer = np.empty(n + 1)
    answer[0] = x[SENSOR]
    on_mv, on_tac = signal["ySupMV"] > SWITCH_ON, signal["ySupTAC"] > SWITCH_ON
    for i in range(n):
        key = (bool(on_mv[i]), bool(on_tac[i]))
        if key not in steps:
            steps[key] = _exact_step(capacity, inside, outside * np.array([1.0, 1.0, *key])[None], step)
        a, b_around, b_heat = steps[key]
        x = a @ x + b_around @ around[i] + b_heat @ heat[i]
        answer[i + 1] = x[SENSOR]
    return answer[:: scenario.output_every][scenario.n_warmup :] - 273.15


def _network(p: dict[str, float], rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return capacities [J/K] (10,), conductances between states [W/K] (10, 10) and to around (10, 4)."""
    c_air, c_int = p["b"] * 1.23 * 1008 * 36.7608, p["cInt"] * 12.72
    c_wall, c_tac = p["cExt1"] * 4.888, p["cTABS"] * 11.935
    furniture, deep = rng.uniform(0.1, 0.4), rng.uniform(0.3, 0.7)
    capacity = np.array(
        [
            *((1.0 - furniture) * c_air, furniture * c_air, (1.0 - deep) * c_int, deep * c_int),
            *(0.25 * c_wall, 0.5 * c_wall, 0.25 * c_wall, 0.4 * c_tac, 0.6 * c_tac, 1.0),
        ]
    )
    inside = np.zeros((N_STATES, N_STATES))

    def couple(i: int, j: int, conductance: float) -> None:
        inside[i, j] += conductance
        inside[j, i] += conductance

    g_int, g_zone = 36.1589 / p["rInt"], 11.935 / p["rZone"]
    g_1, g_2 = 4.888 / p["rExt1"], 4.888 / p["rExt2"]
    couple(0, 1, rng.uniform(20.0, 80.0))
    couple(0, 2, 1.2 * g_int)
    couple(2, 3, rng.uniform(3.0, 8.0) * g_int)
    couple(0, 4, 3.0 * g_1)
    couple(4, 5, 3.0 * g_1)
    couple(5, 6, 3.0 * g_1)
    share = rng.uniform(0.6, 0.95)
    couple(7, 2, share * g_zone)
    couple(7, 0, (1.0 - share) * g_zone)
    couple(7, 8, rng.uniform(3.0, 8.0) * g_zone)
    outside = np.zeros((N_STATES, 4))
    outside[0, 0] = 2.626 * p["UWin"]
    outside[6, 1] = g_2
    outside[0, 2] = 1204.8 * p["VSUP"]
    outside[8, 3] = 11.935 / p["rPipe"]
    # The sensor follows the air within its time constant and weighs nothing.
    inside[SENSOR, 0] = 1.0 / rng.uniform(300.0, 1200.0)
    return capacity, inside, outside


def _exact_step(
    capacity: FloatArray, inside: FloatArray, outside: FloatArray, step: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the matrices of one exact step with constant inputs (matrix exponential)."""
    n, m = outside.shape
    whole = np.zeros((n + m + n, n + m + n))
    balance = inside - np.diag(inside.sum(axis=1) + outside.sum(axis=1))
    whole[:n, :n] = balance / capacity[:, None]
    whole[:n, n : n + m] = outside / capacity[:, None]
    whole[:n, n + m :] = np.diag(1.0 / capacity)
    stepped = np.asarray(expm(whole * step), dtype=np.float64)
    return stepped[:n, :n], stepped[:n, n : n + m], stepped[:n, n + m :]
