"""Seeded instances of a family: a truth inside the box that the model cannot fit exactly, read by sensors.

A fresh seed gives a fresh instance, so that no method can be tuned to the ones in a table. What the truth
has and the model lacks: nodes where the model lumps (wall, slab, thermostat), other terms (oscillator),
other weather and use than the model is given (white box, thermostat, wall), sensors that lag and drift (alone
where the weather is inside the FMU).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from fewest_calls.noise import red_noise
from fewest_calls.slab import generate as slab_truth
from simulation import Case, FmuModel
from simulation.arrays import FloatArray
from simulation.samples import Samples

KELVIN = 273.15


@dataclass(frozen=True)
class Instance:
    """A calibration problem and what it was made of.

    Attributes:
        case: The family's case with this instance's measurement.
        u: The point of the unit cube that the truth was built around. Shape (p,). [1]
    """

    case: Case
    u: FloatArray


Truth = Callable[[Case, dict[str, float], np.random.Generator], FloatArray]
"""Case, parameters and draws to true outputs with all but white noise. Shape (t, k)."""


def make_instance(case: Case, truth: Truth, white: tuple[float, ...], seed: int) -> Instance:
    """Draw true parameters and disturbances; read the truth where the case's own sensors were read.

    Args:
        case: The family's case.
        truth: What the family's world does.
        white: Standard deviation of each output's white noise. Length k. [per output]
        seed: Seed of everything.
    """
    rng = np.random.default_rng([2023, sum(map(ord, case.name)), seed])
    u = rng.uniform(0.15, 0.85, case.parameter_space.n_parameters)
    theta = dict(zip(case.parameter_space.names, case.parameter_space.from_unit(u), strict=True))
    y = truth(case, theta, rng)
    measured = case.measurement
    outputs = []
    for k, one in enumerate(measured.outputs):
        at = one.samples.time
        values = np.interp(at, measured.time, y[:, k])
        noisy = Samples(at, values + white[k] * rng.standard_normal(values.size))
        outputs.append(replace(one, samples=noisy))
    return Instance(replace(case, measurement=replace(measured, outputs=tuple(outputs)), references=()), u)


def white_box(case: Case, p: dict[str, float], rng: np.random.Generator) -> FloatArray:
    """The white box itself in another weather and use than it is given, its sensor with a time constant."""
    scenario = case.scenario
    column = {name: i for i, name in enumerate(scenario.input_names)}
    inputs, n = scenario.inputs.copy(), len(scenario.inputs)
    hour = (scenario.time_communication[:-1] / 3600.0) % 24.0
    inputs[:, column["TAmb"]] += rng.uniform(0.2, 0.6) * red_noise(rng, n, 60.0)
    inputs[:, column["HGlo"]] *= 1.0 + rng.uniform(-0.35, 0.35) * np.cos(np.pi * (hour - 12.0) / 6.0)
    use = 1.0 + rng.uniform(0.1, 0.3) * red_noise(rng, n, 36.0)
    devices = rng.uniform(0.0, 0.1) * np.exp(-0.5 * ((hour - 13.0) / 3.0) ** 2)
    inputs[:, column["occ"]] = inputs[:, column["occ"]] * np.clip(use, 0.0, None) + devices
    disturbed = replace(case.settings, scenario=replace(scenario, inputs=inputs))
    with FmuModel(disturbed) as model:
        answer = model.simulate(np.array([list(p.values())]))
    if answer.failures[0]:
        raise RuntimeError(f"the truth of {case.name} cannot be simulated: {answer.failures[0]}")
    room = _lagged(answer.y[0, :, 0], case.output_step_s, rng.uniform(300.0, 1200.0))
    drift = rng.uniform(0.02, 0.06) * red_noise(rng, room.size, rng.uniform(3.0, 24.0))
    return (room + drift)[:, None]


def wall(case: Case, p: dict[str, float], rng: np.random.Generator) -> FloatArray:
    """Each layer of three temperatures, another outer conductance, weather of another place."""
    scenario = case.scenario
    inputs = scenario.inputs.copy()
    # By the hour or so.
    other_place = rng.uniform(0.2, 0.5) * red_noise(rng, len(inputs) // 60 + 2, 6.0)
    inputs[:, 1] += np.interp(np.arange(len(inputs)) / 60.0, np.arange(other_place.size), other_place)
    links = np.repeat([3.0 * p["G12"], 3.0 * p["G23"]], [4, 4])
    capacity = np.repeat([p["C1"] / 3.0, p["C2"] / 3.0, p["C3"] / 3.0], 3)
    drive = np.zeros((9, 2))
    drive[0, 0], drive[8, 1] = p["GIn"], 200.0 * rng.uniform(0.5, 1.5)
    start = np.interp(np.arange(9), [1, 4, 7], [293.15, p["T2Start"], 278.15])
    states = _affine(links, capacity, drive, inputs, start, case.communication_step_s)
    room = np.append(inputs[:, 0], inputs[-1, 0])
    y = np.column_stack([states[:, 4] - KELVIN, p["GIn"] * (room - states[:, 0])])
    y = y[:: scenario.output_every][scenario.n_warmup :]
    drift = [
        red_noise(rng, len(y), 12.0) * scale for scale in (rng.uniform(0.02, 0.05), rng.uniform(0.5, 2.0))
    ]
    return np.asarray(y + np.column_stack(drift))


def slab(case: Case, p: dict[str, float], rng: np.random.Generator) -> FloatArray:
    """Nine temperatures where the model has three; the sensor on one side of the middle or the other."""
    p = p | {"depth": float(rng.choice([0.0, 0.7]) + rng.uniform(0.0, 0.3))}
    y = slab_truth.answer(case.scenario.inputs, case.communication_step_s, p) - KELVIN
    drift = rng.uniform(0.01, 0.03) * red_noise(rng, len(y), 12.0)
    return np.asarray((y + drift)[:: case.scenario.output_every][case.scenario.n_warmup :, None])


def oscillator(case: Case, p: dict[str, float], rng: np.random.Generator) -> FloatArray:
    """The oscillator with a spring that stiffens or softens and a damping of another power."""
    omega, mu = 2.0 * np.pi / p["period"], p["mu"]
    power, stiffening = rng.uniform(1.8, 2.2), rng.uniform(-0.02, 0.02)

    def slopes(_: float, state: FloatArray) -> list[float]:
        x, v = state
        return [omega * v, omega * (mu * (1.0 - abs(x) ** power) * v - x - stiffening * x**3)]

    time = case.measurement.time
    solved = solve_ivp(
        slopes, (0.0, time[-1]), [p["xStart"], 0.0], "DOP853", t_eval=time, rtol=1e-9, atol=1e-9
    )
    return np.asarray(
        p["amplitude"] * (solved.y[0] + rng.uniform(0.01, 0.03) * red_noise(rng, time.size, 6.0))
    )[:, None]


def thermostat(case: Case, p: dict[str, float], rng: np.random.Generator) -> FloatArray:
    """Walls of two temperatures, a controller whose sensor lags and is read every ten seconds."""
    step_s, fixed = 10.0, case.settings.fixed
    per_input = round(case.communication_step_s / step_s)
    weather = case.scenario.inputs[:, 0]
    outside = np.repeat(weather + rng.uniform(0.1, 0.3) * red_noise(rng, weather.size, 24.0), per_input)
    deep = 4.0 * p["GWall"]
    # Air, inner and outer half of the walls, sensor of the controller.
    capacity = np.array([p["C"], 0.5 * p["CWall"], 0.5 * p["CWall"], 1.0])
    lag_s = rng.uniform(10.0, 40.0)
    balance = np.zeros((4, 6))
    for i, j, g in ((0, 1, p["GWall"]), (1, 2, deep)):
        balance[[i, j], [j, i]] += g
        balance[[i, j], [i, j]] -= g
    for i, g in ((0, p["G"]), (2, float(fixed["GOut"]))):
        balance[i, i] -= g
        balance[i, 4] += g
    balance[0, 5] = p["PHeat"]
    balance[3, [0, 3]] = 1.0 / lag_s, -1.0 / lag_s
    generator = np.zeros((6, 6))
    generator[:4] = balance / capacity[:, None]
    step = expm(generator * step_s)[:4]
    half, on, energy = 0.5 * p["band"], 1.0, 0.0
    x = np.array([294.15, float(fixed["TWallStart"]), float(fixed["TWallStart"]), 294.15])
    read = [(x[0], energy)]
    for k, temperature in enumerate(outside):
        x = step @ np.array([*x, temperature, on])
        energy += on * p["PHeat"] * step_s
        on = 1.0 if x[3] < 294.15 - half else 0.0 if x[3] > 294.15 + half else on
        if (k + 1) % per_input == 0:
            read.append((x[0], energy))
    y = np.array(read)[:: case.scenario.output_every][case.scenario.n_warmup :]
    air = y[:, 0] - KELVIN + rng.uniform(0.01, 0.04) * red_noise(rng, len(y), 6.0)
    # The meter shows whole hundredths of a kWh.
    return np.column_stack([air, np.floor(y[:, 1] / 3.6e4) / 100.0])


def weather_inside(case: Case, p: dict[str, float], rng: np.random.Generator) -> FloatArray:
    """The FMU itself, as its weather cannot be disturbed from outside; its sensors lag and drift."""
    with FmuModel(case.settings) as model:
        answer = model.simulate(np.array([list(p.values())]))
    if answer.failures[0]:
        raise RuntimeError(f"the truth of {case.name} cannot be simulated: {answer.failures[0]}")
    y = answer.y[0]
    shown = [
        _lagged(column, case.output_step_s, rng.uniform(0.1, 0.5) * case.output_step_s)
        + sensor * rng.uniform(0.2, 0.6) * red_noise(rng, len(column), rng.uniform(3.0, 24.0))
        for column, sensor in zip(y.T, case.measurement.uncertainty, strict=True)
    ]
    return np.column_stack(shown)


def switching(case: Case, p: dict[str, float], rng: np.random.Generator) -> FloatArray:
    """The FMU itself in other weather than it is given; its sensors lag and drift."""
    inputs = (
        case.scenario.inputs
        + rng.uniform(0.1, 0.3) * red_noise(rng, len(case.scenario.inputs), 24.0)[:, None]
    )
    scenario = replace(case.scenario, inputs=inputs)
    return weather_inside(replace(case, settings=replace(case.settings, scenario=scenario)), p, rng)


def _lagged(values: FloatArray, step_s: float, lag_s: float) -> FloatArray:
    """Return what a sensor with a time constant shows. Shape (t,)."""
    share, shown = 1.0 - np.exp(-step_s / lag_s), [values[0]]
    for value in values[1:]:
        shown.append(shown[-1] + share * (value - shown[-1]))
    return np.array(shown)


def _affine(
    links: FloatArray,
    capacity: FloatArray,
    drive: FloatArray,
    inputs: FloatArray,
    start: FloatArray,
    step_s: float,
) -> FloatArray:
    """Solve a chain of capacities exactly, the inputs held over each step. Shape (m + 1, n). [K]."""
    n, k = drive.shape
    flows = np.diag(links, 1) + np.diag(links, -1)
    flows -= np.diag(flows.sum(axis=1) + drive.sum(axis=1))
    generator = np.zeros((n + k, n + k))
    generator[:n] = np.hstack([flows, drive]) / capacity[:, None]
    step = expm(generator * step_s)[:n]
    states = np.empty((len(inputs) + 1, n))
    states[0] = start
    for i, row in enumerate(inputs):
        states[i + 1] = step @ np.concatenate([states[i], row])
    return states


SENSORS: dict[str, tuple[Truth, tuple[float, ...]]] = {
    "office-whitebox-metered": (white_box, (0.03,)),
    "wall": (wall, (0.04, 1.5)),
    "slab": (slab, (0.04,)),
    "vanderpol": (oscillator, (0.15,)),
    "thermostat": (thermostat, (0.04, 0.0)),
    "heating-circuit": (switching, (0.04, 0.2)),
    "heat-pump": (switching, (0.04, 0.01)),
    "office-inside": (weather_inside, (0.04,)),
    "wall-inside": (weather_inside, (0.02, 1.0)),
    "house-inside": (weather_inside, (0.04, 0.04)),
}


def of_case(case: Case, seed: int) -> Instance:
    """Return an instance of one of the families above."""
    truth, white = SENSORS[case.name]
    return make_instance(case, truth, white, seed)
