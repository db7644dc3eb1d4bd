"""What a calibration pays and what it has found so far; optimizers count nothing themselves."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.counting import CountingModel
from studies.calibration.problem import CalibrationProblem, Evaluation


@dataclass(frozen=True)
class Progress:
    """One report of a running search.

    Attributes:
        phase: "screen", "polish" or "adaptive".
        n_done: Model rows asked so far in this phase.
        n_total: Most rows that this phase may ask, or None without a limit.
        best_mse: MSE of the best row so far. [first output's unit squared]
        thinks_of: What a search looks at before it asks the next row, "" after a row.
    """

    phase: str
    n_done: int
    n_total: int | None
    best_mse: float
    thinks_of: str = ""


OnProgress = Callable[[Progress], None]


@dataclass(frozen=True)
class History:
    """Best error over the number of model rows paid for.

    Attributes:
        n_calls: Rows asked when the entry was made, rising. Shape (h,). [1]
        best_mse: MSE of the best row until then; it falls, but with a prior the best row need not have the
            lowest MSE. Shape (h,). [first output's unit squared]
    """

    n_calls: IntArray
    best_mse: FloatArray

    def calls_to(self, target: float) -> int | None:
        """Return the rows paid when the best MSE first was at most `target`; None if it never was."""
        reached = np.flatnonzero(self.best_mse <= target)
        return int(self.n_calls[reached[0]]) if reached.size else None

    def after(self, n_calls: int) -> "History":
        """Return the same history where `n_calls` rows were paid before it began."""
        return History(self.n_calls + n_calls, self.best_mse)


@dataclass(frozen=True)
class SearchResult:
    """The best point that a search has seen, and what it cost; make it with `Recorder.result`.

    Attributes:
        best: That point as the model answered. One row.
        n_calls: Rows asked of the model.
        history: Best MSE over rows asked.
        stop_reason: Why the search ended, in words.
        converged: False for a budget, a limit or a failure.
    """

    best: Evaluation
    n_calls: int
    history: History
    stop_reason: str
    converged: bool

    @property
    def u(self) -> FloatArray:
        """The point in the unit cube. Shape (p,). [1]."""
        u: FloatArray = self.best.u[0]
        return u

    @property
    def theta(self) -> FloatArray:
        """The same as parameters. Shape (p,). [per parameter]."""
        theta: FloatArray = self.best.theta[0]
        return theta

    @property
    def y(self) -> FloatArray:
        """Trajectory there. Shape (t, k). [output's unit]."""
        y: FloatArray = self.best.y[0]
        return y

    @property
    def mse(self) -> float:
        """Mean squared error there, infinite when no row succeeded. [first output's unit squared]."""
        return float(self.best.mse[0])

    @property
    def objective(self) -> float:
        """The same with a prior's penalty. [first output's unit squared]."""
        return float(self.best.objective[0])


R = TypeVar("R", bound=SearchResult)


class Recorder:
    """Ask a problem's model through a counter; keep the best point and the history.

    A batch is one entry of the history: its rows were bought together.
    """

    def __init__(
        self,
        problem: CalibrationProblem,
        *,
        phase: str,
        max_calls: int | None = None,
        n_total: int | None = None,
        on_progress: OnProgress | None = None,
    ) -> None:
        """Start counting at zero.

        Args:
            problem: The problem; its model is wrapped, so counting is not the optimizer's business.
            phase: Name of the phase in progress reports.
            max_calls: Most rows that may be asked; the next batch beyond raises `BudgetExceeded`.
            n_total: Most rows expected, for progress reports; `max_calls` when not given.
            on_progress: Called after each batch.
        """
        self._counter = CountingModel(problem.model, budget=max_calls)
        self.problem = problem.on(self._counter)
        self._phase = phase
        self._n_total = max_calls if n_total is None else n_total
        self._on_progress = on_progress
        self._entries: list[tuple[int, float]] = []
        self.best: Evaluation | None = None

    @property
    def n_calls(self) -> int:
        """Rows asked of the model so far."""
        return self._counter.n_calls

    @property
    def best_mse(self) -> float:
        """MSE of the best row so far, infinite before anything succeeded."""
        return float(self.best.mse[0]) if self.best is not None else float("inf")

    @property
    def history(self) -> History:
        """Best MSE over rows asked."""
        return History(
            np.array([calls for calls, _ in self._entries], dtype=np.int64),
            np.array([mse for _, mse in self._entries], dtype=np.float64),
        )

    def result(self, kind: type[R], reason: str, *, converged: bool, **more: Any) -> R:
        """Return what has been found and paid so far, and how the search ended.

        Args:
            kind: Class of the result.
            reason: Why the search ended.
            converged: Whether that is more than a limit.
            more: What results of that kind have beside.
        """
        assert self.best is not None, "a budget of at least one row lets the first rows be asked"
        return kind(self.best, self.n_calls, self.history, reason, converged, **more)

    def evaluate(self, u: FloatArray) -> Evaluation:
        """Ask the model, pay, and take note.

        Args:
            u: Points of the unit cube. Shape (n, p). [1]

        Raises:
            BudgetExceeded: The rows do not fit into what is left; nothing was simulated.
        """
        evaluation = self.problem.evaluate(u)
        self.know(evaluation)
        self._report()
        return evaluation

    def pay(self, n_rows: int) -> None:
        """Count rows that were asked in another way; a negative number gives them back."""
        self._counter.pay(n_rows)
        self._report()

    def think_of(self, what: str) -> None:
        """Report what is looked at before the next row is asked, as that may take seconds."""
        self._report(what)

    def _report(self, thinks_of: str = "") -> None:
        if self._on_progress is not None:
            done = (self._phase, self.n_calls, self._n_total, self.best_mse)
            self._on_progress(Progress(*done, thinks_of))

    def know(self, evaluation: Evaluation) -> None:
        """Take note of rows that were answered, or simulated before (warm start)."""
        index = int(np.argmin(evaluation.objective))
        # A failed row is the best as long as there is no other: a result can then say why it failed.
        if self.best is None or evaluation.objective[index] < self.best.objective[0]:
            self.best = evaluation.take(index)
        self._entries.append((self.n_calls, self.best_mse))
