"""SciPy's optimizers at the paper's settings, from one starting point straight on a model.

"For all techniques from SciPy, default settings are used. Iterations are limited to reasonable values and
tolerances are adapted to the FMU-settings" (Table 2): so defaults are used here, but for the limits and the
tolerance that a row states. Differential evolution goes without its closing L-BFGS-B, as the paper's count
tells.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import Bounds, differential_evolution, least_squares, minimize

from simulation.arrays import FloatArray
from simulation.counting import BudgetExceeded, CountingModel
from simulation.forward_model import ForwardModel
from simulation.measurement import Measurement
from studies.paper.direct_journal import Journal
from studies.paper.direct_row import DirectRow

FAILED = 1e6
"""MSE of a row that fails: worse than all others, and finite, so that no difference of two is NaN. [unit²]"""

POPULATION = 15
"""SciPy's default population of differential evolution, per parameter."""

LEAST_SQUARES_TOLERANCE = 1e-8
"""SciPy's default ftol and xtol of least squares."""

EVOLUTION_TOLERANCE = 0.01
"""SciPy's default: the population's errors scatter by less than this share of their mean."""

N_KEPT = 80
"""Entries that are kept of a history."""

OnCall = Callable[[float], None]


class StartStoppedError(RuntimeError):
    """Somebody asked the work to end."""


@dataclass(frozen=True)
class StartResult:
    """What one start came to.

    Attributes:
        theta0: Where it began. Shape (p,). [per parameter]
        theta: The best point it saw. Shape (p,). [per parameter]
        mse: MSE there. [first output's unit squared]
        n_calls: Rows asked of the model.
        wall_s: How long it took, without calls that an interrupted run had paid. [s]
        reason: Why it ended, in the optimizer's words.
        history: Calls and best MSE after them, where it fell. Shape (h, 2).
    """

    theta0: FloatArray
    theta: FloatArray
    mse: float
    n_calls: int
    wall_s: float
    reason: str
    history: FloatArray


class _Asked:
    """The model as an optimizer sees it: counted, in its coordinates, the best point kept."""

    def __init__(
        self,
        model: ForwardModel,
        measurement: Measurement,
        row: DirectRow,
        *,
        journal: Journal | None,
        on_call: OnCall | None,
    ) -> None:
        self._counter = CountingModel(model)
        self._measurement = measurement
        self._row = row
        self._journal = journal
        self._on_call = on_call
        self._n_replayed = 0
        self.space = model.parameter_space
        self.best_mse = np.inf
        self.best_theta: FloatArray = np.full(self.space.n_parameters, np.nan)
        self.entries: list[tuple[int, float]] = []

    @property
    def n_calls(self) -> int:
        """Rows asked of the model, those included that an interrupted run had paid."""
        return self._n_replayed + self._counter.n_calls

    @property
    def bounds(self) -> Bounds:
        if self._row.coordinates == "physical":
            return Bounds(self.space.lower, self.space.upper)
        return Bounds(np.zeros(self.space.n_parameters), np.ones(self.space.n_parameters))

    def to_seen(self, theta: FloatArray) -> FloatArray:
        return theta if self._row.coordinates == "physical" else self.space.to_unit(theta)

    def to_theta(self, x: FloatArray) -> FloatArray:
        if self._row.coordinates == "physical":
            return np.clip(x, self.space.lower, self.space.upper)
        return self.space.from_unit(x)

    def mse(self, x: FloatArray) -> float:
        theta = self.to_theta(x)
        self._check_budget()
        known = self._journal.answer(theta) if self._journal is not None else None
        if known is not None:
            self._n_replayed += 1
            self._note(theta, known)
            return known
        residuals = self._ask(theta)
        mse = FAILED if residuals is None else float(np.mean(residuals**2))
        if self._journal is not None:
            self._journal.note(theta, mse)
        self._note(theta, mse)
        return mse

    def residuals(self, x: FloatArray) -> FloatArray:
        theta = self.to_theta(x)
        self._check_budget()
        residuals = self._ask(theta)
        if residuals is None:
            residuals = np.full(self._measurement.n_samples, np.sqrt(FAILED))
        self._note(theta, float(np.mean(residuals**2)))
        return residuals**2 if self._row.objective == "squared" else residuals

    def _check_budget(self) -> None:
        if self._row.max_calls is not None and self.n_calls >= self._row.max_calls:
            raise BudgetExceeded(f"the limit of {self._row.max_calls} calls is reached")

    def _ask(self, theta: FloatArray) -> FloatArray | None:
        answer = self._counter.simulate(theta[None])
        if answer.failures[0]:
            return None
        residuals = self._measurement.compared(answer.y)[0]
        return residuals if np.all(np.isfinite(residuals)) else None

    def _note(self, theta: FloatArray, mse: float) -> None:
        if mse < self.best_mse:
            self.best_mse, self.best_theta = mse, theta.copy()
            self.entries.append((self.n_calls, mse))
        if self._on_call is not None:
            self._on_call(self.best_mse)


def minimize_from(
    model: ForwardModel,
    measurement: Measurement,
    row: DirectRow,
    theta0: FloatArray,
    *,
    journal: Journal | None = None,
    on_call: OnCall | None = None,
) -> StartResult:
    """Let an optimizer go from one starting point.

    Args:
        model: The physical model.
        measurement: What it is compared with.
        row: Which optimizer, with which objective and coordinates.
        theta0: Starting point; differential evolution does without. Shape (p,). [per parameter]
        journal: Keeps the answers of an optimizer with a scalar objective.
        on_call: Told the best MSE after each call; may raise `StartStoppedError`.

    Returns:
        The best point it saw, whether or not the optimizer was content.
    """
    asked = _Asked(model, measurement, row, journal=journal, on_call=on_call)
    started = time.perf_counter()
    try:
        reason = _SOLVERS[row.method](asked, row, asked.to_seen(theta0))
    except BudgetExceeded as over:
        reason = str(over)
    except (ValueError, np.linalg.LinAlgError) as error:
        reason = f"the optimizer failed: {error}"
    wall_s = time.perf_counter() - started
    entries = [*asked.entries, (asked.n_calls, asked.best_mse)]
    return StartResult(
        theta0=np.array(theta0),
        theta=asked.best_theta,
        mse=float(asked.best_mse),
        n_calls=asked.n_calls,
        wall_s=wall_s,
        reason=reason,
        history=thinned(np.array(entries, dtype=np.float64)),
    )


def _least_squares(asked: _Asked, row: DirectRow, x0: FloatArray) -> str:
    bounds = asked.bounds
    tol = LEAST_SQUARES_TOLERANCE if row.tolerance is None else row.tolerance
    found = least_squares(
        asked.residuals, x0, bounds=(bounds.lb, bounds.ub), method="trf", ftol=tol, xtol=tol
    )
    return str(found.message)


def _minimize(method: str) -> Callable[[_Asked, DirectRow, FloatArray], str]:
    def solve(asked: _Asked, row: DirectRow, x0: FloatArray) -> str:
        # SLSQP has a limit of iterations instead, 100 by default.
        options: Any = {} if row.max_calls is None or method == "SLSQP" else {"maxfev": row.max_calls}
        solver: Any = minimize  # the method is no literal here
        found = solver(asked.mse, x0, method=method, bounds=asked.bounds, tol=row.tolerance, options=options)
        return str(found.message)

    return solve


def _evolve(asked: _Asked, row: DirectRow, x0: FloatArray) -> str:
    generations = 1000 if row.max_calls is None else row.max_calls // (POPULATION * len(x0)) - 1
    found = differential_evolution(
        asked.mse,
        asked.bounds,
        popsize=POPULATION,
        maxiter=max(1, generations),
        tol=EVOLUTION_TOLERANCE if row.tolerance is None else row.tolerance,
        polish=False,
        rng=np.random.default_rng(row.seed),
    )
    return str(found.message)


_SOLVERS: dict[str, Callable[[_Asked, DirectRow, FloatArray], str]] = {
    "powell": _minimize("Powell"),
    "nelder-mead": _minimize("Nelder-Mead"),
    "slsqp": _minimize("SLSQP"),
    "ls-trf": _least_squares,
    "differential-evolution": _evolve,
}


def thinned(history: FloatArray) -> FloatArray:
    """Keep some entries of a history, evenly over the logarithm of the calls, first and last among them.

    Args:
        history: Calls and best MSE. Shape (h, 2).
    """
    if len(history) <= N_KEPT:
        return history
    marks = np.geomspace(history[0, 0], history[-1, 0], N_KEPT)
    kept = np.unique(np.searchsorted(history[:, 0], marks, side="right") - 1)
    some: FloatArray = history[np.union1d(kept, [0, len(history) - 1])]
    return some
