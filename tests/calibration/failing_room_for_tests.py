"""Rooms of two masses, drawn by seed; a part of their box cannot be simulated, the optimum lies beside."""

from dataclasses import dataclass, field

import numpy as np

from simulation.arrays import FloatArray
from simulation.measurement import Measurement
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.problem import CalibrationProblem

NAMES = ("R1", "C1", "R2", "C2", "q", "k")
SENSOR = 0.2


@dataclass(frozen=True, eq=False)
class FailingRoom:
    """Air and wall: heated by a pulse q and a sine k, coupled by R1, losing heat by R2.

    Attributes:
        direction: Of the boundary, in the unit cube. Shape (p,). [1]
        edge: Rows farther along than this fail. [1]
        ripple: Amplitude of what the model of a truth has and others lack.
    """

    direction: FloatArray
    edge: float
    ripple: float = 0.0
    parameter_space: ParameterSpace = field(
        default_factory=lambda: ParameterSpace(
            tuple(Parameter(name, 0.2, 5.0, scale="log") for name in NAMES)
        )
    )
    output_names: tuple[str, ...] = ("T",)
    time: FloatArray = field(default_factory=lambda: np.linspace(0.0, 10.0, 60))

    def simulate(self, theta: FloatArray) -> Trajectories:
        bad = self.parameter_space.to_unit(theta) @ self.direction > self.edge
        y = np.array(
            [
                np.full(len(self.time), np.nan) if b else self._row(row)
                for row, b in zip(theta, bad, strict=True)
            ]
        )
        return Trajectories.checked(
            theta,
            y.reshape(len(theta), -1, 1),
            time=self.time,
            parameter_names=NAMES,
            output_names=self.output_names,
            failures=["the initialization fails" if b else "" for b in bad],
        )

    def _row(self, row: FloatArray) -> FloatArray:
        r1, c1, r2, c2, q, k = row
        rates = np.array([[-1 / (r1 * c1) - 1 / (r2 * c1), 1 / (r1 * c1)], [1 / (r1 * c2), -1 / (r1 * c2)]])
        values, vectors = np.linalg.eig(rates)
        step = np.real((vectors * np.exp(values * (self.time[1] - self.time[0]))) @ np.linalg.inv(vectors))
        gain = np.linalg.solve(rates, step - np.eye(2))
        x, y = np.zeros(2), [0.0]
        for t in self.time[:-1]:
            heat = np.array([(q * (np.sin(1.3 * t) > 0.0) + k * np.sin(t)) / c1, 0.0])
            x = step @ x + gain @ heat
            y.append(x[0] + self.ripple * np.sin(2.2 * t))
        return np.array(y)


@dataclass(frozen=True, eq=False)
class Instance:
    """A problem, the share of its box that fails, and the best error beside it.

    Attributes:
        problem: The problem.
        share: Of the box. [1]
        best: The optimum's error; it can be simulated.
    """

    problem: CalibrationProblem
    share: float
    best: float


def failing_room(seed: int) -> Instance:
    """Draw a problem: half to nine tenths of the box fail, beyond a value of a parameter or a sum."""
    rng = np.random.default_rng([5, seed])
    p = len(NAMES)
    u = rng.uniform(0.2, 0.8, p)
    everywhere = FailingRoom(np.zeros(p), 1.0)
    truth = FailingRoom(np.zeros(p), 1.0, ripple=0.05).simulate(everywhere.parameter_space.from_unit(u[None]))
    measurement = Measurement.on_grid(
        time=everywhere.time,
        y=truth.y[0] + 0.02 * rng.standard_normal(truth.y[0].shape),
        output_names=("T",),
        uncertainty=np.array([SENSOR]),
    )
    best = LeastSquaresTRF(max_calls=400).minimize(CalibrationProblem(everywhere, measurement), u)
    points = rng.random((4000, p))
    while True:
        n = 1 if rng.random() < 0.6 else 2
        direction = np.zeros(p)
        direction[rng.choice(p, n, replace=False)] = rng.choice([-1, 1], n)
        edge = float(best.u @ direction + n**0.5 * rng.uniform(0.01, 0.1))
        share = float((points @ direction > edge).mean())
        if 0.5 < share < 0.9:
            return Instance(CalibrationProblem(FailingRoom(direction, edge), measurement), share, best.mse)
