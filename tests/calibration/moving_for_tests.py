"""Models by their slopes and cases whose states are watched, for tests of state equations."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case, load_case
from simulation.measurement import Measurement
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.problem import CalibrationProblem
from studies.calibration.search.adaptive import Adaptive, AdaptiveResult
from studies.calibration.search.first_design import latin_hypercube
from studies.calibration.state_equations.coefficient import Points
from studies.calibration.state_equations.equations import LEARNT, StateEquations, Structure
from studies.calibration.state_equations.learned_ode import LearnedODE
from studies.calibration.state_equations.product_forms import Products
from studies.calibration.state_equations.states import StateSignals, WatchedModel, watching_states

FMUS = Path(__file__).parents[2] / "fmus"
N_FINE = 4


def _first(theta: FloatArray, x: FloatArray, u: FloatArray) -> list[FloatArray]:
    return [x[0]]


@dataclass(frozen=True)
class Moving:
    """A model by its slopes; answers its outputs, then all states and their slopes.

    Solved by Runge and Kutta's method in some parts of a step, all rows at once.

    Attributes:
        parameter_space: The box.
        units: Of states and inputs.
        step_s: Inputs are held so long. [s]
        inputs: Shape (steps, inputs).
        slope: Of the states, from all parameters, states and inputs.
        start: The first states, from all parameters.
        shown: The outputs, from parameters, states and inputs.
        offsets: What is added to an output's unit of the FMU.
        every: Steps per output.
        depends_on: What each state's slope may follow; empty: anything.
        kick: What the first state jumps by half-way, which no slope shows.
    """

    parameter_space: ParameterSpace
    units: tuple[str, ...]
    step_s: float
    inputs: FloatArray
    slope: Callable[..., list[FloatArray]]
    start: Callable[..., list[FloatArray]]
    shown: Callable[[FloatArray, FloatArray, FloatArray], list[FloatArray]] = _first
    offsets: tuple[float, ...] = field(default=(0.0,))
    every: int = 1
    depends_on: tuple[frozenset[str] | None, ...] = ()
    kick: float = 0.0

    @property
    def signals(self) -> StateSignals:
        n_states = len(self.units) - self.inputs.shape[1]
        names = tuple(f"x{j}" for j in range(n_states))
        return StateSignals(
            states=names,
            derivatives=tuple(f"der({name})" for name in names),
            inputs=tuple(f"u{j}" for j in range(self.inputs.shape[1])),
            units=self.units,
            depends_on=self.depends_on or (None,) * n_states,
            driven=self.inputs,
            step_s=self.step_s,
            every=self.every,
            n_before=0,
            outputs=tuple(f"y{j}" for j in range(len(self.offsets))),
            conversions=np.array([[1.0, offset] for offset in self.offsets]),
        )

    @property
    def output_names(self) -> tuple[str, ...]:
        return (*self.signals.outputs, *self.signals.states, *self.signals.derivatives)

    @property
    def time(self) -> FloatArray:
        return self.every * self.step_s * np.arange(len(self.inputs) // self.every + 1)

    def simulate(self, theta: FloatArray) -> Trajectories:
        x = np.array(self.start(*theta.T))

        def slope(x: FloatArray, u: FloatArray) -> FloatArray:
            return np.array(self.slope(*theta.T, *x, *u))

        h, rows = self.step_s / N_FINE, list[FloatArray]()
        for u in np.concatenate([self.inputs[:1], self.inputs]):
            for _ in range(N_FINE if rows else 0):
                one = slope(x, u)
                two = slope(x + 0.5 * h * one, u)
                three = slope(x + 0.5 * h * two, u)
                x = x + h / 6.0 * (one + 2.0 * two + 2.0 * three + slope(x + h * three, u))
            x[0] += self.kick * (len(rows) == len(self.inputs) // 2)
            shown = np.array(self.shown(theta, x, u)) + np.array(self.offsets)[:, None]
            rows.append(np.concatenate([shown, x, slope(x, u)]).T)
        return Trajectories.checked(
            theta,
            np.array(rows[:: self.every]).transpose(1, 0, 2),
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=self.output_names,
        )


def box(**bounds: tuple[float, float]) -> ParameterSpace:
    return ParameterSpace(tuple(Parameter(name, *ends, scale="log") for name, ends in bounds.items()))


def measured(
    model: Moving, theta: FloatArray, noise: float, *, sensor: float | None = None, seed: int = 0
) -> CalibrationProblem:
    """Pose the problem of finding these parameters from the first output with noise, the sensor's if none."""
    watched = WatchedModel(model, model.signals)
    y = watched.simulate(theta[None]).y[0]
    y = y + noise * np.random.default_rng(seed).standard_normal(y.shape)
    uncertainty = np.array([noise if sensor is None else sensor])
    return CalibrationProblem(watched, Measurement.on_grid(model.time, y, ("y0",), uncertainty))


def learnt(model: Moving, n: int) -> StateEquations:
    """Learn equations from so many rows."""
    space, watched = model.parameter_space, WatchedModel(model, model.signals)
    u = 0.1 + 0.8 * latin_hypercube(n, space.n_parameters, np.random.default_rng(0))
    rows = watched.seen(watched.simulate(space.from_unit(u)).theta)
    structure = Structure.of(model.signals, rows)
    assert structure.misfit < LEARNT
    found, _ = structure.coefficients(structure.fits(model.signals, rows))
    equations = StateEquations.learn(
        model.signals, structure, Points.of(space, u), rows.x, found, Products.of(space)
    )
    assert isinstance(equations, StateEquations)
    return equations


@contextmanager
def watched_case(folder: Path) -> Iterator[tuple[Case, CalibrationProblem]]:
    """Load a case, whose problem watches its states."""
    case = load_case(folder)
    with watching_states(case).open_model() as model:
        yield case, CalibrationProblem(WatchedModel(model, StateSignals.of(case)), case.measurement)


def with_equations(
    problem: CalibrationProblem, seed: int = 0, **settings: Any
) -> tuple[AdaptiveResult, LearnedODE]:
    """Calibrate with state equations."""
    ode = LearnedODE.of(problem)
    return Adaptive(**settings).minimize(problem, seed=seed, learned_ode=ode), ode
