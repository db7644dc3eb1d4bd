"""Where state equations expect the lowest error: the whole box is searched, as solving them costs no call."""

import math
from typing import Protocol

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.box_newton import SAME_POINT
from studies.calibration.descent import Descents, descend_together, objectives
from studies.calibration.problem import CalibrationProblem

# Random points that are looked at, and how many of the best of them are walked downhill.
N_LOOKS, N_WALKS = 400, 20
# Parts of the time that walks of equations with switches fit first, one after the other.
# Of 16 such searches all ended at the least error (docs/notes/state-equations.md, Switches).
PARTS_OF_TIME = (1 / 16, 1 / 8, 1 / 4, 1 / 2)
# How far beside a point that is known another is drawn. By hand. [1]
BESIDE_KNOWN = 0.02


class Solved(Protocol):
    """Residuals by the equations, those after the first outputs as if the rest were zero."""

    def __call__(self, u: FloatArray, n_outputs: int | None = None) -> FloatArray:
        """Return the residuals at points (n, p). Shape (n, m). [first output's unit]."""


class Optimum:
    """The lowest point by the equations of a problem."""

    def __init__(self, problem: CalibrationProblem, solved: Solved) -> None:
        """Begin with nothing known.

        Args:
            problem: The problem.
            solved: Its residuals by the equations.
        """
        self._problem, self._solved = problem, solved
        self._descents = Descents(problem.prior, problem.space.n_parameters, N_WALKS)

    def expected(self, u: FloatArray) -> float:
        """Return the objective by the equations at a point (p,). [unit squared]."""
        return float(objectives(self._problem.prior, u[None], self._solved(u[None]))[0])

    def point(
        self,
        objective: FloatArray,
        known: FloatArray,
        rng: np.random.Generator,
        *,
        has_switches: bool,
        is_sure: bool,
    ) -> tuple[FloatArray, float]:
        """Return the point to ask next, shape (p,), and the objective that is expected. [unit squared].

        Args:
            objective: Of the rows so far, infinite where they failed. Shape (n,). [unit squared]
            known: Their points. Shape (n, p). [1]
            rng: Source of the looks.
            has_switches: Whether states are switches, which change at other times elsewhere.
            is_sure: Whether simulations agree with the equations.
        """
        looks = rng.random((N_LOOKS, known.shape[1]))
        if has_switches:
            looks = np.concatenate([self._ends_of_parts(rng), looks])
        order = np.argsort(objective, kind="stable")
        ends, values = self._descents.lowest(self._solved, looks, known[order])
        u, value = ends[0], float(values[0])
        distance = np.abs(known - u).max(axis=1)
        if distance.min(initial=np.inf) < SAME_POINT:
            nearest = int(np.argmin(distance))
            # That point is known; one a little beside adds more.
            if is_sure and np.isfinite(objective[nearest]):
                value = float(objective[nearest])
            u = np.clip(u + rng.uniform(-BESIDE_KNOWN, BESIDE_KNOWN, len(u)), 0.0, 1.0)
        return u, value

    def _ends_of_parts(self, rng: np.random.Generator) -> FloatArray:
        """Return where walks end that fit a part of the time, then twice as much. Shape (w, p). [1]."""
        # The error over the whole time jumps with the number of changes; over a short time there are few.
        measurement, p = self._problem.measurement, self._problem.space.n_parameters
        ends = np.empty((0, p))
        for part in PARTS_OF_TIME:
            n = math.ceil(part * len(measurement.time))
            late = np.zeros((1, len(measurement.time), len(measurement.output_names)))
            late[:, n:] = 1.0
            is_seen = (measurement.compared(late) == measurement.compared(0.0 * late))[0]

            def residuals(u: FloatArray, n: int = n, is_seen: BoolArray = is_seen) -> FloatArray:
                return self._solved(u, n)[:, is_seen]

            starts = np.concatenate([ends, rng.random((N_LOOKS, p))])
            best = np.argsort(objectives(None, starts, residuals(starts)), kind="stable")[:N_WALKS]
            ends, _ = descend_together(residuals, self._problem.prior, starts[best])
        return ends
