"""Networks whose states no output shows: learnt from outputs alone, and what they save."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from scipy.linalg import expm
from threadpoolctl import threadpool_limits

from pelsvae.linear_network.drive import Drive
from simulation import Measurement, load_case
from simulation.arrays import FloatArray
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.hidden_network.inputs import network_of_stores
from studies.calibration.hidden_network.steps import steps
from studies.calibration.problem import CalibrationProblem
from studies.calibration.search.adaptive import Adaptive

ROOT = Path(__file__).parents[2]
N_STEPS, STEP_S = 240, 1800.0


def drawn_inputs() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return five days of outdoor temperatures [degC], of sun [W/m2] and of a fan that is on or off."""
    rng = np.random.default_rng(5)
    hour = np.arange(N_STEPS) * STEP_S / 3600.0
    outdoor = 5.0 + 4.0 * np.sin(2.0 * np.pi * (hour - 9.0) / 24.0) + np.cumsum(rng.normal(0.0, 0.3, N_STEPS))
    sun = 400.0 * np.maximum(np.sin(2.0 * np.pi * (hour - 6.0) / 24.0), 0.0) * rng.uniform(0.2, 1.0, N_STEPS)
    return outdoor, sun, ((hour % 24.0 > 7.0) & (hour % 24.0 < 18.0)).astype(np.float64)


@dataclass(frozen=True, eq=False)
class HiddenRoom:
    """A room with a heavy mass of which the air's temperature alone is seen, solved by matrix exponentials.

    Attributes:
        time: Output times. Shape (t,). [s]
    """

    parameter_space: ClassVar = ParameterSpace(
        (
            Parameter("envelope", lower=20.0, upper=200.0, unit="W/K", scale="log"),
            Parameter("fan", lower=10.0, upper=100.0, unit="W/K", scale="log"),
            Parameter("surface", lower=1e-3, upper=1e-2, unit="K/W", scale="log"),
            Parameter("air", lower=2e5, upper=2e6, unit="J/K", scale="log"),
            Parameter("mass", lower=3e6, upper=3e7, unit="J/K", scale="log"),
            Parameter("window", lower=0.5, upper=5.0, unit="m2", scale="log"),
            Parameter("start", lower=15.0, upper=25.0, unit="degC"),
        )
    )
    output_names: ClassVar = ("T",)
    time: FloatArray = field(default_factory=lambda: np.arange(N_STEPS + 1) * STEP_S)

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Solve it. y of shape (n, t, 1). [degC]."""
        outdoor, sun, is_on = drawn_inputs()
        y = np.empty((len(theta), N_STEPS + 1, 1))
        for row, (envelope, fan, surface, air, mass, window, start) in enumerate(theta):
            x = np.array([20.0, start])
            exact = {}
            for on in (0.0, 1.0):
                lost = envelope + on * fan
                matrix = np.zeros((4, 4))
                matrix[0] = np.array([-lost - 1.0 / surface, 1.0 / surface, lost, 0.1 * window]) / air
                matrix[1] = np.array([1.0 / surface, -1.0 / surface, 0.0, 0.9 * window]) / mass
                exact[on] = expm(matrix * STEP_S)[:2]
            y[row, 0, 0] = x[0]
            for k in range(N_STEPS):
                x = exact[is_on[k]] @ np.array([*x, outdoor[k], sun[k]])
                y[row, k + 1, 0] = x[0]
        return Trajectories.checked(
            theta,
            y,
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=self.output_names,
        )


def room_inputs() -> Drive:
    """Return what drives the room."""
    outdoor, sun, is_on = drawn_inputs()
    patterns, pattern = np.unique(is_on[:, None], axis=0, return_inverse=True)
    return Drive(
        potentials=outdoor[:, None],
        sources=(sun / sun.std())[:, None],
        pattern=pattern.reshape(-1).astype(np.int64),
        patterns=patterns,
        step=0.5,
        bounds=np.array([0, len(pattern)]),
        every=np.array([1]),
        n_before=np.array([0]),
        columns=np.array([[0]]),
        is_alike=np.array([True]),
        is_start=np.array([False] * 6 + [True]),
        start_ratio=np.array([0.0] * 6 + [1.0]),
        time_powers=np.array([-1.0, -1.0, 1.0, 0.0, 0.0, 0.0, -2.0]),
        source_powers=np.array([-3.0]),
    )


def room_problem() -> CalibrationProblem:
    """Return the room with a measurement that it cannot fit exactly: it has noise of 0.05 K."""
    room, rng = HiddenRoom(), np.random.default_rng(3)
    truth = room.parameter_space.from_unit(np.array([[0.3, 0.7, 0.4, 0.6, 0.35, 0.75, 0.2]]))
    y = room.simulate(truth).y[0] + 0.05 * rng.standard_normal((N_STEPS + 1, 1))
    return CalibrationProblem(room, Measurement.on_grid(room.time, y, ("T",), np.array([0.05])))


def test_steps_are_exact_and_slopes_are_those_of_differences() -> None:
    rng = np.random.default_rng(1)
    places = np.array(
        [[0, 0, 1, -1], [0, 1, 0, -1], [1, 0, 0, -1], [1, 1, 0, 0], [2, 1, 1, -1]], dtype=np.int64
    )
    rates, start = np.exp(rng.normal(-1.0, 0.5, (2, 5))), rng.normal(0.0, 1.0, (2, 2))
    inputs = np.hstack([rng.normal(0.0, 3.0, (9, 1)), rng.normal(0.0, 1.0, (9, 1))])
    pattern, patterns = np.arange(9) % 2, np.array([[0.0], [1.0]])

    def solved(rates: FloatArray, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        return steps(start, rates, places, inputs, pattern, patterns, 0.7, 3, 1, True)

    y, slopes = solved(rates, start)
    for row, (to, back, first, second, gain) in enumerate(rates):
        x = start[row]
        for k in range(9):
            on = float(k % 2)
            matrix = np.zeros((4, 4))
            matrix[0] = [-to - first, to, first, 0.0]
            matrix[1] = [back, -back - on * second, on * second, gain]
            x = expm(matrix * 0.7)[:2] @ np.array([*x, *inputs[k]])
            if k % 3 == 2:
                assert y[row, k // 3 + 1, 0] == pytest.approx(x[0], rel=1e-12)
    # Central differences err by their square and by rounding over their size.
    h = 1e-5
    for one in range(7):
        moved = np.zeros(7)
        moved[one] = h
        after, _ = solved(rates + moved[:5], start + moved[5:])
        before, _ = solved(rates - moved[:5], start - moved[5:])
        np.testing.assert_allclose(slopes[..., one], (after - before) / (2.0 * h), rtol=1e-6, atol=1e-8)


def test_hidden_room_is_calibrated_in_few_calls() -> None:
    problem = room_problem()
    with threadpool_limits(limits=1):
        found = Adaptive(max_calls=13).minimize(problem, seed=0, network_inputs=room_inputs())
        alone = Adaptive(max_calls=13).minimize(problem, seed=0)
    noise = 0.05**2
    # Seven rows are the first design. The least error is that of the noise, less what is fitted.
    assert found.mse < 1.02 * noise < alone.mse


def test_inputs_of_the_office_are_sorted_by_unit() -> None:
    case = load_case(ROOT / "fmus" / "office")
    inputs = network_of_stores(case)
    assert inputs is not None
    # Outdoor air, wall, water and supply air; sun and occupants; water circuit and ventilation.
    assert (inputs.potentials.shape[1], inputs.sources.shape[1], inputs.patterns.shape[1]) == (4, 2, 2)
    assert inputs.potentials[0, 0] == pytest.approx(case.scenario.inputs[0, 0] - 273.15)
    names = case.parameter_space.names
    assert [name for name, is_start in zip(names, inputs.is_start, strict=True) if is_start] == ["TTABSInit"]
    powers = dict(zip(names, inputs.time_powers, strict=True))
    assert (powers["UWin"], powers["rInt"], powers["cInt"], powers["VSUP"]) == (-1.0, 1.0, 0.0, -1.0)


def test_outputs_that_are_no_potentials_or_differ_have_no_network() -> None:
    # The oscillator has no inputs, the wall's second output is a heat flow.
    for name in ("vanderpol", "wall"):
        assert network_of_stores(load_case(ROOT / "fmus" / name)) is None
