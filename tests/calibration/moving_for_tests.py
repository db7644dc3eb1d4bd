"""Models by their slopes, for tests of state equations; they show all states and what these do."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from simulation.arrays import FloatArray
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.states import StateSignals

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

    @property
    def signals(self) -> StateSignals:
        n_states = len(self.units) - self.inputs.shape[1]
        names = tuple(f"x{j}" for j in range(n_states))
        return StateSignals(
            states=names,
            derivatives=tuple(f"der({name})" for name in names),
            inputs=tuple(f"u{j}" for j in range(self.inputs.shape[1])),
            units=self.units,
            depends_on=(None,) * n_states,
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
