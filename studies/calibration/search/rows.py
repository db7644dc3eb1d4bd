"""The simulations of a search: points, residuals, and objectives by what the present window shows."""

from typing import NamedTuple

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.growing_rows import GrowingRows
from studies.calibration.largest_samples import outlying_part
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.search.truncated_window import TruncatedWindow

# A simulation whose error is so many times that of most of the first design has diverged. By hand.
DIVERGED = 1e6
# Trajectories that are compared for switching, of parameter sets that lie apart. By hand.
N_COMPARED = 8


class Incumbent(NamedTuple):
    """The lowest simulation so far, of all or of a search phase.

    Attributes:
        row: Its place among all simulations.
        u: Its point. Shape (p,). [1]
        objective: Its objective. [unit squared]
        outlying: Part of the objective that is its largest samples'. [unit squared]
    """

    row: int
    u: FloatArray
    objective: float
    outlying: float = 0.0

    @property
    def rest(self) -> float:
        """The objective that gains are measured against: without the largest samples. [unit squared]."""
        return self.objective - self.outlying


class Rows:
    """All simulations, in the order in which they were asked, those of a warm start first."""

    def __init__(self, problem: CalibrationProblem, n_known: int, n_design: int) -> None:
        """Begin without any.

        Args:
            problem: The problem.
            n_known: How many were simulated before the search (warm start).
            n_design: How many the first design then has.
        """
        self.window = TruncatedWindow(problem.measurement)
        self.u = np.empty((0, problem.space.n_parameters))
        self.objective = np.empty(0)
        self.n_known, self.n_first = n_known, n_known + n_design
        self._penalty = np.empty(0)
        self._answers = GrowingRows(problem.measurement.n_samples)
        self._sensor = float(problem.measurement.uncertainty[0])

    def add(self, answer: Evaluation) -> None:
        """Add simulations and judge them by the present window."""
        self.u = np.concatenate([self.u, answer.u])
        self._answers.add(answer.residuals)
        penalty = np.full(answer.n, np.inf)
        good = np.isfinite(answer.mse)
        # The prior's part, apart from the error: a window changes the error alone.
        penalty[good] = answer.objective[good] - answer.mse[good]
        self._penalty = np.concatenate([self._penalty, penalty])
        self._judge()

    def judge_again(self) -> None:
        """Judge all simulations by a window that has changed."""
        self.objective = self.objective[:0]
        self._judge()

    def _judge(self) -> None:
        n = self.n
        error = np.mean(self.window.seen(self.residuals[n:]) ** 2, axis=1)
        penalty = self._penalty[n:]
        judged = np.where(np.isfinite(penalty), error + penalty, np.inf)
        self.objective = np.concatenate([self.objective, judged])

    @property
    def n(self) -> int:
        """How many there are."""
        return self.objective.size

    @property
    def residuals(self) -> FloatArray:
        """Residuals over the whole trajectories. Shape (n, m). [first output's unit]."""
        return self._answers.rows

    @property
    def good(self) -> BoolArray:
        """Which succeeded. Shape (n,)."""
        return np.isfinite(self.objective)

    @property
    def sane(self) -> BoolArray:
        """Which a surrogate learns from: beside diverged ones all others would seem alike. Shape (n,)."""
        design = self.objective[: self.n_first]
        design = design[np.isfinite(design)]
        if not design.size:
            return self.good
        sane = self.good & (self.objective <= DIVERGED * np.quantile(design, 0.25))
        return sane if sane.sum() >= 2 else self.good

    def lowest(self, first: int = 0) -> float:
        """Return the lowest objective from a place on, infinite where nothing follows. [unit squared]."""
        return float(self.objective[first:].min(initial=np.inf))

    def best(self, first: int = 0) -> Incumbent:
        """Return the lowest simulation from a place on, or the last one where nothing follows."""
        first = min(first, self.n - 1)
        row = first + int(np.argmin(self.objective[first:]))
        outlying = outlying_part(self.window.seen(self.residuals[[row]])[0], self._sensor)
        return Incumbent(row, self.u[row], float(self.objective[row]), outlying)

    @property
    def unexplained(self) -> float:
        """Share of a measured variance that the best simulation leaves unexplained in the window. [1]."""
        return self.window.unexplained(self.residuals[int(np.argmin(self.objective))])

    @property
    def switches(self) -> bool:
        """Whether the model switches at times that depend on its parameters, as far as points apart show."""
        first = np.flatnonzero(self.sane[: self.n_first])
        if self.n_known:
            # From the best to corners of the bounds, where even a linear model seems to switch.
            first = first[np.unique(np.linspace(0, first.size - 1, N_COMPARED).astype(np.int64))]
        return self.window.switches(self.residuals[first[-N_COMPARED:]])
