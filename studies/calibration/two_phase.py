"""The paper's method: screen the box on the surrogate, polish the point on the physical model."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.counting import CountingModel
from simulation.forward_model import ForwardModel
from simulation.measurement import Measurement
from studies.calibration.ledger import Ledger
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.prior import Prior
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.recorder import History, OnProgress
from studies.calibration.screen import DifferentialEvolution, ScreenResult

# A screened point that the physical model cannot simulate gives way to others, at least this far away.
MAX_SCREEN_CHECKS = 5
DISTANCE_FROM_FAILURE = 0.1


@dataclass(frozen=True)
class CalibrationResult:
    """A calibration and what it cost.

    Attributes:
        parameter_names: Names of the p parameters.
        theta_screened: Point that screening chose. Shape (p,). [per parameter]
        theta: Calibrated parameters. Shape (p,). [per parameter]
        u_screened: Screened point in the unit cube. Shape (p,). [1]
        u: Calibrated point in the unit cube. Shape (p,). [1]
        mse_surrogate: Surrogate's error at the screened point. [first output's unit squared]
        mse_screened: Physical model's error there, infinite if it could not be simulated. [same]
        mse_polished: Physical model's error at the calibrated parameters. [same]
        ledger: Rows asked of the physical model, by purpose.
        polish_history: Best physical MSE over rows paid, all those before the polish included.
        screen_history: Best surrogate MSE over surrogate evaluations.
        y_surrogate: Surrogate's trajectory at the screened point. Shape (t, k). [output's unit]
        y_screened: Physical trajectory at the screened point. Shape (t, k). [output's unit]
        y_polished: Physical trajectory at the calibrated parameters. Shape (t, k). [output's unit]
        screen_stop_reason: Why screening ended.
        polish_stop_reason: Why polishing ended.
        polish_converged: True when a tolerance ended the polish.
        slopes: Slopes of the residuals near it, see PolishResult. Shape (m, p). [unit per range]
        wall_screen_s: Time spent on screening. [s]
        wall_polish_s: Time spent on the physical model. [s]
    """

    parameter_names: tuple[str, ...]
    theta_screened: FloatArray
    theta: FloatArray
    u_screened: FloatArray
    u: FloatArray
    mse_surrogate: float
    mse_screened: float
    mse_polished: float
    ledger: Ledger
    polish_history: History
    screen_history: History
    y_surrogate: FloatArray
    y_screened: FloatArray
    y_polished: FloatArray
    screen_stop_reason: str
    polish_stop_reason: str
    polish_converged: bool
    slopes: FloatArray | None
    wall_screen_s: float
    wall_polish_s: float

    @property
    def screening_gap(self) -> float:
        """Physical minus surrogate error at the screened point. [first output's unit squared]."""
        return self.mse_screened - self.mse_surrogate

    @property
    def wall_s(self) -> float:
        """Time of the whole calibration. [s]."""
        return self.wall_screen_s + self.wall_polish_s

    def calls_to(self, target: float) -> int | None:
        """Return the calls (training + screening check + polish) when the MSE first was at most `target`.

        Args:
            target: The error to reach. [first output's unit squared]

        Returns:
            The paper's count, or None if the target was never reached.
        """
        return self.polish_history.calls_to(target)

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the trajectories as plain values; infinite errors become None."""
        return {
            "theta": dict(zip(self.parameter_names, self.theta.tolist(), strict=True)),
            "theta_screened": dict(zip(self.parameter_names, self.theta_screened.tolist(), strict=True)),
            "mse_surrogate": _plain(self.mse_surrogate),
            "mse_screened": _plain(self.mse_screened),
            "screening_gap": _plain(self.screening_gap),
            "mse_polished": _plain(self.mse_polished),
            "ledger": self.ledger.to_dict(),
            "polish_history": _plain_history(self.polish_history),
            "screen_history": _plain_history(self.screen_history),
            "screen_stop_reason": self.screen_stop_reason,
            "polish_stop_reason": self.polish_stop_reason,
            "polish_converged": self.polish_converged,
            "wall_screen_s": self.wall_screen_s,
            "wall_polish_s": self.wall_polish_s,
        }


def calibrate_two_phase(
    surrogate_model: ForwardModel,
    physical_model: ForwardModel,
    measurement: Measurement,
    *,
    screening: DifferentialEvolution,
    polishing: LeastSquaresTRF,
    seed: int,
    n_train: int,
    n_validation: int = 0,
    n_test: int = 0,
    prior: Prior | None = None,
    on_progress: OnProgress | None = None,
) -> CalibrationResult:
    """Calibrate a physical model with a surrogate of it (Aka et al. 2023, sec. 2.4; 10.3384/ecp204107).

    Args:
        surrogate_model: Cheap model that is asked over the whole box.
        physical_model: Model to calibrate; every row asked of it is counted.
        measurement: Target, on both models' output grid.
        screening: Settings of phase 1.
        polishing: Settings of phase 2.
        seed: Seed of the screening.
        n_train: Physical simulations that trained the surrogate, for the ledger.
        n_validation: The same for validation.
        n_test: The same for testing.
        prior: What is known about the parameters beforehand, or None; both phases use it.
        on_progress: Called during both phases.

    Returns:
        The calibrated parameters, the errors on the way and the ledger.
    """
    started = time.perf_counter()
    problem = CalibrationProblem(surrogate_model, measurement, prior)
    physical_problem = problem.on(physical_model)

    screened = screening.minimize(problem, seed=seed, on_progress=on_progress)
    screened_at = time.perf_counter()

    checked, n_screen_checks = _check(screened, physical_problem)
    predicted = problem.evaluate(checked.u)
    polished = polishing.minimize(physical_problem, checked.u[0], known=checked, on_progress=on_progress)

    ledger = Ledger(n_train, n_validation, n_test, n_screen_checks, polished.n_calls)
    return CalibrationResult(
        parameter_names=problem.space.names,
        theta_screened=checked.theta[0],
        theta=polished.theta,
        u_screened=checked.u[0],
        u=polished.u,
        mse_surrogate=float(predicted.mse[0]),
        mse_screened=float(checked.mse[0]),
        mse_polished=polished.mse,
        ledger=ledger,
        polish_history=polished.history.after(n_train + n_screen_checks),
        screen_history=screened.history,
        y_surrogate=predicted.y[0],
        y_screened=checked.y[0],
        y_polished=polished.y,
        screen_stop_reason=screened.stop_reason,
        polish_stop_reason=polished.stop_reason,
        polish_converged=polished.converged,
        slopes=polished.slopes,
        wall_screen_s=screened_at - started,
        wall_polish_s=time.perf_counter() - screened_at,
    )


def _check(screened: ScreenResult, problem: CalibrationProblem) -> tuple[Evaluation, int]:
    """Simulate the screened point; if that fails, the best of the population at other points.

    Returns:
        The point that could be simulated, or the screened one if none could; and the rows asked.
    """
    physical = CountingModel(problem.model)
    counted = problem.on(physical)
    first = checked = counted.evaluate(screened.u)
    tried = [screened.u]
    for u in screened.population_u:
        if not checked.failures[0] or physical.n_calls == MAX_SCREEN_CHECKS:
            break
        # Beside a point that fails, others probably fail as well.
        if min(float(np.max(np.abs(u - other))) for other in tried) > DISTANCE_FROM_FAILURE:
            checked = counted.evaluate(u)
            tried.append(u)
    return (first if checked.failures[0] else checked), physical.n_calls


def _plain(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _plain_history(history: History) -> dict[str, list[Any]]:
    return {
        "n_calls": history.n_calls.tolist(),
        "best_mse": [_plain(value) for value in history.best_mse.tolist()],
    }
