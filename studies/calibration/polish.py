"""Polishing: SciPy's trust-region reflective least squares (LS-TRF) from one starting point."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import least_squares

from simulation.arrays import FloatArray
from simulation.counting import BudgetExceeded
from simulation.errors import InputError
from simulation.parameters import ParameterSpace
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.recorder import OnProgress, Recorder, SearchResult

# SciPy moves a start on a bound inside by some 1e-10; a residual known that close is the residual there.
SAME_START = 1e-9

# The solver takes the distance of the start from the origin for its first trust radius, which a start in the
# corner 0 would make vanish: it is shown the cube between 1 and 2.
ORIGIN = 1.0

GTOL = 1e-10
"""Scaled gradient below which a polish stops."""

# A model that is solved exactly repeats to about 1e-12: relative errors are 1e-5 from curvature and 1e-7 from
# rounding.
DIFFERENCE_STEP = 1e-5
"""Step of the differences in the coordinates of the search. [1]"""

# By the status of SciPy.
STOP_REASONS = {
    0: "the limit of iterations is reached",
    1: "the gradient is below gtol",
    2: "the improvement is below ftol",
    3: "the step is below xtol",
    4: "improvement and step are below ftol and xtol",
}


@dataclass(frozen=True)
class PolishResult(SearchResult):
    """The best point that a polish has seen.

    Attributes:
        slopes: Slopes of the residuals at the last point that was differentiated, 0 where a parameter failed
            on both sides; None where none was, or for squared residuals. Shape (m, p). [unit per range]
    """

    slopes: FloatArray | None


@dataclass(frozen=True)
class LeastSquaresTRF:
    """Trust-region reflective least squares in the unit cube (doi 10.1137/S1064827595289108).

    An iteration costs 1 + p rows: the trial point and one batch of p differences. A trial point that fails is
    infinitely bad, so that the trust region shrinks; a difference that fails is taken to the other side, and
    a parameter that fails on both sides stays where it is for this iteration.

    Attributes:
        ftol: Stop when the relative improvement of the objective falls below this.
        xtol: Stop when the relative step falls below this.
        max_calls: Most rows that may be asked of the model, or None.
        residuals: "signed" minimizes the MSE; "squared" is the form of the paper's Table 2: the solver gets
            squared residuals, so that it minimizes fourth powers, and unscaled linear coordinates. The
            reported error is the MSE in both.
    """

    ftol: float = 1e-6
    xtol: float = 1e-8
    max_calls: int | None = 1000
    residuals: Literal["signed", "squared"] = "signed"

    def __post_init__(self) -> None:
        """Refuse settings that no search can run with."""
        if self.max_calls is not None and self.max_calls < 1:
            raise InputError(f"polishing: max_calls is {self.max_calls}; give at least 1")

    def minimize(
        self,
        problem: CalibrationProblem,
        u0: FloatArray,
        *,
        known: Evaluation | None = None,
        on_progress: OnProgress | None = None,
    ) -> PolishResult:
        """Polish one starting point.

        Args:
            problem: The problem, posed to the model that is asked.
            u0: Starting point; clipped into the unit cube. Shape (p,). [1]
            known: What the model has already answered at `u0`; it is not asked again.
            on_progress: Called after each batch.

        Returns:
            The best point seen; never raises for a failed simulation or a spent budget.
        """
        if problem.prior is not None and self.residuals == "squared":
            raise InputError(
                'polishing: priors cannot be used with residuals = "squared"; use "signed", or remove prior '
                "from the parameters"
            )
        recorder = Recorder(problem, phase="polish", max_calls=self.max_calls, on_progress=on_progress)
        if known is not None:
            recorder.know(known)
        start = np.clip(np.asarray(u0, dtype=np.float64), 0.0, 1.0)
        is_squared = self.residuals == "squared"
        search = _Search(problem, recorder, known, is_squared=is_squared)
        converged = False
        try:
            first = search.evaluate_at(v0 := search.to_search(start))
            if first.failures[0]:
                reason = f"the starting point cannot be simulated: {first.failures[0]}"
            else:
                found = least_squares(
                    search.objective,
                    v0 + ORIGIN,
                    jac=search.jacobian,
                    bounds=(ORIGIN, ORIGIN + 1.0),
                    method="trf",
                    ftol=self.ftol,
                    xtol=self.xtol,
                    gtol=GTOL,
                    x_scale=1.0 if is_squared else "jac",
                )
                reason, converged = STOP_REASONS[found.status], found.status > 0
        except BudgetExceeded as end:
            reason = str(end)
        except _StepsFailError as stuck:
            reason = f"even the smallest step cannot be simulated: {stuck}"
        slopes = None if is_squared else search.slopes
        return recorder.result(PolishResult, reason, converged=converged, slopes=slopes)


class _StepsFailError(Exception):
    """The trust region has shrunk to a difference step and its trial point still fails."""


class _Search:
    """The two callbacks of one LS-TRF run, in the coordinates it searches in."""

    def __init__(
        self,
        problem: CalibrationProblem,
        recorder: Recorder,
        known: Evaluation | None,
        *,
        is_squared: bool,
    ) -> None:
        self._is_squared = is_squared
        self._recorder = recorder
        self._space = problem.space
        self._prior = problem.prior
        self._search_space = _linear(problem.space) if is_squared else problem.space
        self._last = None if known is None else (self.to_search(known.u[0]), known)
        self._accepted: FloatArray | None = None
        self.slopes: FloatArray | None = None

    def to_search(self, u: FloatArray) -> FloatArray:
        """Return a point of the unit cube in the coordinates of the search. Shape (p,). [1]."""
        if self._search_space is self._space:
            return u
        return np.asarray(self._search_space.to_unit(self._space.from_unit(u)), dtype=np.float64)

    def from_search(self, v: FloatArray) -> FloatArray:
        """Return points of the search as points of the unit cube. Shape (n, p). [1]."""
        if self._search_space is self._space:
            return v
        return np.asarray(self._space.to_unit(self._search_space.from_unit(v)), dtype=np.float64)

    def evaluate_at(self, v: FloatArray) -> Evaluation:
        """Ask the model at one point, unless it is the point asked last."""
        # SciPy asks for the Jacobian where it has asked for the objective: that row is paid once.
        if self._last is not None and float(np.max(np.abs(self._last[0] - v))) <= SAME_START:
            return self._last[1]
        answer = self._recorder.evaluate(self.from_search(v[None]))
        self._last = (v.copy(), answer)
        return answer

    def objective(self, x: FloatArray) -> FloatArray:
        """Return what the solver squares and sums; not finite where the simulation failed. Shape (t*k,).

        Args:
            x: The point as the solver sees it, from `ORIGIN` on. Shape (p,). [1]

        Raises:
            _StepsFailError: The point fails although it nearly is the accepted one; SciPy would go on trying.
        """
        v = np.clip(x - ORIGIN, 0.0, 1.0)
        answer = self.evaluate_at(v)
        moved = np.inf if self._accepted is None else float(np.max(np.abs(v - self._accepted)))
        if answer.failures[0] and moved < DIFFERENCE_STEP:
            raise _StepsFailError(answer.failures[0])
        residuals = self._form(answer.residuals[0])
        if self._prior is None:
            return residuals
        return np.concatenate([residuals, self._prior.rows(v[None], residuals.size)[0]])

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return the differences of the objective, all p of them from one batch. Shape (t*k, p).

        Args:
            x: The point as the solver sees it, from `ORIGIN` on. Shape (p,). [1]
        """
        self._accepted = v = np.clip(x - ORIGIN, 0.0, 1.0)
        here = self._form(self.evaluate_at(v).residuals[0])
        # Backward at an upper face, so that no difference leaves the box.
        steps = np.where(v + DIFFERENCE_STEP > 1.0, -DIFFERENCE_STEP, DIFFERENCE_STEP)
        moved = self._differences(v, steps, list(range(v.size)))
        failed = np.flatnonzero(~np.all(np.isfinite(moved), axis=1))
        other_side = [int(i) for i in failed if 0.0 <= v[i] - steps[i] <= 1.0]
        if other_side:
            steps[other_side] *= -1.0
            moved[other_side] = self._differences(v, steps, other_side)
        slopes: FloatArray = (moved - here) / steps[:, None]
        is_stuck = ~np.all(np.isfinite(slopes), axis=1)
        # A column of zeros makes the solver leave the parameter where it is.
        slopes[is_stuck] = 0.0
        self.slopes = slopes.T
        if self._prior is None:
            return slopes.T
        exact = self._prior.row_slopes(slopes.shape[1])
        return np.concatenate([slopes.T, np.diag(np.where(is_stuck, 0.0, exact))])

    def _differences(self, v: FloatArray, steps: FloatArray, which: list[int]) -> FloatArray:
        rows = (v + np.diag(steps))[which]
        return self._form(self._recorder.evaluate(self.from_search(rows)).residuals)

    def _form(self, residuals: FloatArray) -> FloatArray:
        return residuals**2 if self._is_squared else residuals


def _linear(space: ParameterSpace) -> ParameterSpace:
    """Return the same box without logarithmic coordinates."""
    if space.is_bent:
        # There the cube's edges depend on each other, and their own coordinates are kept.
        return space
    return ParameterSpace(tuple(replace(parameter, scale="linear") for parameter in space.parameters))
