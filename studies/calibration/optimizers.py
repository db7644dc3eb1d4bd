"""Optimizers that may polish, by the name that a profile gives them; a new one is a class and a line here."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from scipy.optimize import minimize

from simulation.arrays import FloatArray
from simulation.counting import BudgetExceeded
from simulation.errors import InputError
from studies.calibration.polish import LeastSquaresTRF, PolishResult
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.recorder import OnProgress, Recorder
from studies.calibration.search.adaptive import Adaptive, AdaptiveResult

BOUNDED = ("COBYQA", "COBYLA", "L-BFGS-B", "Nelder-Mead", "Powell", "SLSQP", "TNC", "trust-constr")
"""Methods of `scipy.optimize.minimize` that keep bounds."""


class Optimizer(Protocol):
    """Polishes one starting point; never raises for a failed simulation or a spent budget."""

    def minimize(
        self,
        problem: CalibrationProblem,
        u0: FloatArray,
        *,
        known: Evaluation | None = None,
        on_progress: OnProgress | None = None,
    ) -> PolishResult | AdaptiveResult:
        """Return the best point seen.

        Args:
            problem: The problem, posed to the model that is asked.
            u0: Starting point. Shape (p,). [1]
            known: What the model has already answered there; it is not asked again.
            on_progress: Called after each batch.
        """


@dataclass(frozen=True)
class SciPyMinimize:
    """A method of `scipy.optimize.minimize` in the unit cube, on the objective as one number.

    Attributes:
        method: Its name, of `BOUNDED`.
        tol: Its tolerance; None for SciPy's.
        max_calls: Most rows that may be asked of the model, or None.
        options: Further options of the method.
    """

    method: str = "COBYQA"
    tol: float | None = None
    max_calls: int | None = 1000
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse methods that leave the bounds."""
        if self.method not in BOUNDED:
            raise InputError(f"polish.optimizer: method = {self.method!r} is none of {', '.join(BOUNDED)}")

    def minimize(
        self,
        problem: CalibrationProblem,
        u0: FloatArray,
        *,
        known: Evaluation | None = None,
        on_progress: OnProgress | None = None,
    ) -> PolishResult:
        """Polish one starting point, see `Optimizer`."""

        def solve(ask: "_Ask") -> tuple[str, bool]:
            how: dict[str, Any] = {"method": self.method, "tol": self.tol, "options": dict(self.options)}
            found: Any = minimize(ask.objective, u0, bounds=[(0.0, 1.0)] * len(u0), **how)
            return str(found.message), bool(found.success)

        return _polished(problem, known, on_progress, self.max_calls, solve)


@dataclass(frozen=True)
class DfoLs:
    """DFO-LS, which needs no derivatives (Cartis et al. 2019, 10.1145/3338517); `pip install DFO-LS`.

    Attributes:
        rhobeg, rhoend: First and last trust radius in the unit cube. [1]
        max_calls: Most rows that may be asked of the model, or None.
    """

    rhobeg: float = 0.1
    rhoend: float = 1e-5
    max_calls: int | None = 1000

    def minimize(
        self,
        problem: CalibrationProblem,
        u0: FloatArray,
        *,
        known: Evaluation | None = None,
        on_progress: OnProgress | None = None,
    ) -> PolishResult:
        """Polish one starting point, see `Optimizer`."""
        try:
            import dfols  # pyrefly: ignore[missing-import]
        except ModuleNotFoundError:
            raise InputError('polish.optimizer: "DfoLs" needs a package: pip install DFO-LS') from None

        def solve(ask: "_Ask") -> tuple[str, bool]:
            found = dfols.solve(
                ask.residuals,
                np.clip(u0, 0.0, 1.0),
                bounds=(np.zeros(len(u0)), np.ones(len(u0))),
                rhobeg=self.rhobeg,
                rhoend=self.rhoend,
                maxfun=self.max_calls or 10**6,
            )
            return str(found.msg), found.flag == found.EXIT_SUCCESS

        return _polished(problem, known, on_progress, self.max_calls, solve)


@dataclass(frozen=True)
class SurrogateSearch:
    """The search of `studies calibrate`, led by the surrogate and by what simulations show of its error.

    It begins with the training rows, needs no differences, and ends by the rules of `studies calibrate`: once
    tests found no gain. Without a surrogate it is that search alone.

    Attributes:
        max_calls: Most rows that may be asked of the model.
    """

    max_calls: int = 1000

    def minimize(
        self,
        problem: CalibrationProblem,
        u0: FloatArray,
        *,
        known: Evaluation | None = None,
        on_progress: OnProgress | None = None,
        surrogate: CalibrationProblem | None = None,
        seed: int = 0,
    ) -> AdaptiveResult:
        """Polish, see `Optimizer`.

        Args:
            problem: The problem, posed to the model that is asked.
            u0: Starting point; asked where nothing is known. Shape (p,). [1]
            known: Rows that the model has answered already.
            on_progress: Called after each row.
            surrogate: The problem, posed to a surrogate of the model.
            seed: Seed of all draws.

        Returns:
            The best point seen.
        """
        settings = Adaptive.for_sensor(float(problem.measurement.uncertainty[0]), max_calls=self.max_calls)
        return settings.minimize(
            problem,
            seed=seed,
            known=known,
            surrogate=surrogate,
            u0=u0 if known is None else None,
            on_progress=on_progress,
        )


OPTIMIZERS: dict[str, Callable[..., Optimizer]] = {
    "SurrogateSearch": SurrogateSearch,
    "LeastSquaresTRF": LeastSquaresTRF,
    "SciPyMinimize": SciPyMinimize,
    "DfoLs": DfoLs,
}
"""What may polish, by its name in `polish.optimizer` of a profile."""


def optimizer_of(declared: Mapping[str, Any], **budget: Any) -> Optimizer:
    """Return the optimizer that a profile declares.

    Args:
        declared: Its name and arguments.
        budget: What the profile says of every polish; arguments that the optimizer does not have are left
            out.

    Raises:
        InputError: There is no such optimizer, or it has no such argument.
    """
    name, own = declared.get("name"), {key: value for key, value in declared.items() if key != "name"}
    if name not in OPTIMIZERS:
        raise InputError(f"polish.optimizer: name = {name!r} is none of {', '.join(OPTIMIZERS)}")
    kind = OPTIMIZERS[name]
    known = set(getattr(kind, "__dataclass_fields__", {}))
    if unknown := own.keys() - known:
        raise InputError(f"polish.optimizer: {name} has no argument {sorted(unknown)[0]!r}")
    return kind(**{key: value for key, value in budget.items() if key in known} | own)


class _Ask:
    """Asks the model at one point after the other; the starting point is known."""

    def __init__(self, recorder: Recorder, known: Evaluation | None) -> None:
        self._recorder = recorder
        self._known = known

    def __call__(self, u: FloatArray) -> Evaluation:
        u = np.clip(np.asarray(u, dtype=np.float64), 0.0, 1.0)
        if self._known is not None and np.array_equal(u, self._known.u[0]):
            return self._known
        return self._recorder.evaluate(u[None])

    def objective(self, u: FloatArray) -> float:
        """Return the objective at one point, a large number where the simulation failed. [unit squared]."""
        value = float(self(u).objective[0])
        return value if np.isfinite(value) else self._failed**2

    def residuals(self, u: FloatArray) -> FloatArray:
        """Return residuals, with a prior's; large ones where the simulation failed. Shape (m,). [unit]."""
        answer, prior = self(u), self._recorder.problem.prior
        found = answer.residuals[0]
        if not np.isfinite(found).all():
            found = np.full_like(found, self._failed)
        return found if prior is None else np.concatenate([found, prior.rows(answer.u, found.size)[0]])

    @property
    def _failed(self) -> float:
        """Residual of a failed simulation: finite, as models are fitted to it, and worse than the best."""
        best = self._recorder.best_mse
        return 10.0 * float(np.sqrt(best)) + 1.0 if np.isfinite(best) else 1.0


def _polished(
    problem: CalibrationProblem,
    known: Evaluation | None,
    on_progress: OnProgress | None,
    max_calls: int | None,
    solve: Callable[[_Ask], tuple[str, bool]],
) -> PolishResult:
    """Have an optimizer ask, and return the best point that it has seen."""
    recorder = Recorder(problem, phase="polish", max_calls=max_calls, on_progress=on_progress)
    if known is not None:
        recorder.know(known)
    try:
        reason, converged = solve(_Ask(recorder, known))
    except BudgetExceeded as end:
        reason, converged = str(end), False
    except (TypeError, ValueError) as error:
        raise InputError(f"polish.optimizer: {' '.join(str(error).split())}") from None
    if not np.isfinite(recorder.best_mse):
        reason, converged = "no simulation succeeded", False
    return recorder.result(PolishResult, reason, converged=converged, slopes=None)
