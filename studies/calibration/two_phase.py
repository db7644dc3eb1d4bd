"""The paper's method: screen the box on the surrogate, polish the point on the physical model."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simulation.counting import CountingModel
from simulation.forward_model import ForwardModel
from simulation.layout import Layout
from simulation.measurement import Measurement
from studies.calibration.ledger import Ledger
from studies.calibration.optimizers import Optimizer, SurrogateSearch
from studies.calibration.polish import PolishResult
from studies.calibration.prior import Prior
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.recorder import History, OnProgress
from studies.calibration.screen import DifferentialEvolution, ScreenResult
from studies.calibration.search.adaptive import AdaptiveResult

# A screened point that the physical model cannot simulate gives way to others, at least this far away.
MAX_SCREEN_CHECKS, DISTANCE_FROM_FAILURE = 5, 0.1


@dataclass(frozen=True)
class TwoPhaseResult:
    """A calibration and what it cost.

    Attributes:
        screen: What the surrogate shows of the box.
        screened: Point that the screening chose, as the physical model answered there. One row.
        mse_surrogate: Surrogate's error there. [first output's unit squared]
        polish: The calibrated point.
        history: Best physical MSE over rows paid, all those before the polish included.
        ledger: Rows asked of the physical model, by purpose.
    """

    screen: ScreenResult
    screened: Evaluation
    mse_surrogate: float
    polish: PolishResult | AdaptiveResult
    history: History
    ledger: Ledger


def calibrate_two_phase(
    surrogate_model: ForwardModel,
    physical_model: ForwardModel,
    measurement: Measurement,
    *,
    screening: DifferentialEvolution,
    polishing: Optimizer,
    seed: int,
    n_train: int,
    n_validation: int = 0,
    n_test: int = 0,
    prior: Prior | None = None,
    layout: Layout | None = None,
    rows: Evaluation | None = None,
    on_progress: OnProgress | None = None,
) -> TwoPhaseResult:
    """Calibrate a physical model with a surrogate of it (Aka et al. 2023, sec. 2.4; 10.3384/ecp204107).

    Args:
        surrogate_model: Cheap model that is asked over the whole box.
        physical_model: Model to calibrate; every row asked of it is counted.
        measurement: Target, on both models' output grid.
        screening: Settings of phase 1.
        polishing: The optimizer of phase 2. Screened points beyond the first count among its calls.
        seed: Seed of the screening.
        n_train: Physical simulations that trained the surrogate, for the ledger.
        n_validation: Physical simulations of the validation set, for the ledger.
        n_test: Physical simulations of the test set, for the ledger.
        prior: What is known about the parameters beforehand, or None; both phases use it.
        layout: Which parameters act in which experiment; None for one experiment.
        rows: What the physical model has answered already, for optimizers that learn from it.
        on_progress: Called during both phases.

    Returns:
        The calibrated parameters, the errors on the way and the ledger.
    """
    problem = CalibrationProblem(surrogate_model, measurement, prior, layout)
    physical_problem = problem.on(physical_model)

    screen = screening.minimize(problem, seed=seed, on_progress=on_progress)
    screened, n_checks = _check(screen, physical_problem)
    mse_surrogate = float(problem.mse(screened.u)[0])
    if n_checks > 1 and (most := getattr(polishing, "max_calls", None)) is not None:
        polishing = replace(polishing, max_calls=max(most - n_checks + 1, 1))  # type: ignore[type-var]
    how: dict[str, Any] = {"known": screened, "on_progress": on_progress}
    if isinstance(polishing, SurrogateSearch):
        how |= {"surrogate": problem, "seed": seed}
        how["known"] = screened if rows is None else rows.joined(screened)
    polish = polishing.minimize(physical_problem, screened.u[0], **how)
    ledger = Ledger(n_train, n_validation, n_test, n_checks, polish.n_calls)
    history = polish.history.after(n_train + n_checks)
    return TwoPhaseResult(screen, screened, mse_surrogate, polish, history, ledger)


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
