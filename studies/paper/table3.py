"""Tables 2 and 3: SciPy's optimizers straight on the FMU, from the guess or from many starts.

"For all techniques from SciPy, default settings are used. Iterations are limited to reasonable values and
tolerances are adapted to the FMU-settings" (Table 2): so defaults are used here, but for the limits and the
tolerance that a row states. Calls are counted at the model, finite differences included, and not stored.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from queue import Queue
from threading import Event
from typing import Any, Literal

import numpy as np
from scipy.optimize import Bounds, differential_evolution, least_squares, minimize
from scipy.special import ndtr, ndtri
from threadpoolctl import threadpool_limits

from simulation.arrays import FloatArray
from simulation.counting import BudgetExceeded
from simulation.forward_model import ForwardModel
from simulation.measurement import Measurement
from simulation.parameters import ParameterSpace
from simulation.pool.pool_model import PoolModel
from simulation.record_file import read_json, write_json
from studies.calibration.problem import CalibrationProblem
from studies.calibration.recorder import Recorder
from studies.paper.items import Cell, Shown
from studies.paper.plan import Plan
from studies.paper.published import TABLE_3
from studies.results.outcome import digest_of
from studies.results.saved import rebuilt
from studies.stages.knowledge import declared_inputs
from studies.task import Task
from studies.words.wording import square_of

Method = Literal["Powell", "Nelder-Mead", "SLSQP", "LS-TRF", "Differential evolution"]

FAILED = 1e6
"""MSE of a row that fails: worse than all others, and finite, so that no difference of two is NaN. [unit²]"""

POPULATION = 15
"""SciPy's default population of differential evolution, per parameter."""


@dataclass(frozen=True)
class Row:
    """An optimizer coupled directly with the physical model.

    Args:
        method: SciPy's optimizer; LS-TRF gets signed residuals, the others the MSE.
        n_starts: starting points: the first is the guess, the others are drawn.
        seed: of the drawn starts, or of differential evolution.
        max_calls: most model calls of one start; None for no limit but the optimizer's own.
        tolerance: `tol` of `minimize` and of `differential_evolution`, `ftol` and `xtol` of `least_squares`;
            None for SciPy's default.
        in_unit_cube: whether the optimizer sees the unit cube in the scales of the case, not the parameters
            as they are.
    """

    method: Method
    n_starts: int = 1
    seed: int = 0
    max_calls: int | None = None
    tolerance: float | None = None
    in_unit_cube: bool = False

    @property
    def name(self) -> str:
        """Name of the row's file."""
        return digest_of(asdict(self))[:16]

    @property
    def title(self) -> str:
        """The row as Table 3 calls it."""
        form = ", own scales" if self.in_unit_cube else ""
        if self.method == "Differential evolution":
            return self.method + form
        return f"{self.method}, {'guess' if self.n_starts == 1 else f'{self.n_starts} starts'}{form}"


TOLERANCE_TRF = 1e-4
"""Inferred: with SciPy's 1e-8, LS-TRF takes 700 to 2000 calls per start, with this about the paper's 200."""

SETTINGS = {
    "Powell": Row("Powell", max_calls=5000),
    "Nelder-Mead": Row("Nelder-Mead", max_calls=5000),
    "SLSQP": Row("SLSQP"),
    "LS-TRF": Row("LS-TRF", tolerance=TOLERANCE_TRF),
    "Differential evolution": Row("Differential evolution", max_calls=748_020, tolerance=1e-4),
}
"""Limits that Table 3 shows: 5000 calls exactly from the guess, 3,562 generations of 15 x 14 points; the
tolerance of evolution is inferred, as with SciPy's 0.01 it ends after some 140,000 calls.

The paper's numbers show (calls per start, best 5 % and mean over starts) that its optimizers saw
the parameters as they are, and LS-TRF signed residuals.
"""


@dataclass(frozen=True)
class Start:
    """What one start came to.

    Args:
        theta: the best point it saw. Shape (p,). [per parameter]
        mse: MSE there. [first output's unit squared]
        n_calls: rows asked of the model.
        reason: why it ended, in the optimizer's words.
    """

    theta: tuple[float, ...]
    mse: float
    n_calls: int
    reason: str


def computed(task: Task, row: Row, folder: Path) -> tuple[Start, ...]:
    """Compute all starts of a row, or read them where the row is finished.

    Args:
        task: case, window, number of processes.
        row: the row.
        folder: where the file of each finished row lies.
    """
    case, file = task.case, folder / f"{row.name}.json"
    inputs = {
        "row": asdict(row),
        "case": case.digest,
        "measurement": case.measurement.digest,
        **declared_inputs(case),
    }
    digest, stored = digest_of(inputs), read_json(file)
    if stored is not None and stored.get("digest") == digest:
        return tuple(rebuilt(Start, one, str(file)) for one in stored["starts"])
    points, stop = start_points(case.parameter_space, row), Event()
    with ExitStack() as opened:
        models = Queue[PoolModel]()
        for _ in range(min(task.n_jobs, row.n_starts)):
            models.put(opened.enter_context(PoolModel(case.make_model, 1, policy=case.policy)))

        def work(theta0: FloatArray) -> Start:
            model = models.get()
            try:
                return minimize_from(model, case.measurement, row, theta0, stop)
            finally:
                models.put(model)

        executor = opened.enter_context(ThreadPoolExecutor(models.qsize()))
        # After Ctrl-C or a failure no start goes on.
        opened.callback(executor.shutdown, wait=False, cancel_futures=True)
        opened.callback(stop.set)
        opened.enter_context(threadpool_limits(1))
        advance = opened.enter_context(task.console.progress(row.title, row.n_starts))
        futures = [executor.submit(work, theta0) for theta0 in points]
        for n_done, future in enumerate(as_completed(futures), start=1):
            future.result()
            advance(n_done, row.n_starts)
    starts = tuple(future.result() for future in futures)
    write_json(
        file, {"digest": digest, "title": row.title, **inputs, "starts": [asdict(one) for one in starts]}
    )
    return starts


def start_points(space: ParameterSpace, row: Row) -> FloatArray:
    """Draw the starting points as the paper's Table 2 does: the guess, then normal draws around it.

    The paper's "variance 0.5 (theta+ - theta-)" has the unit of a standard deviation and is read as one.
    "Repeated until a combination within the bounds is found" keeps the
    parameters independent: each is a normal variable truncated at its bounds, drawn here by its inverse.
    Start j depends on the seed and j alone.

    Args:
        space: The parameters; one without an estimate starts in the middle of its box.
        row: Number of starts and seed.

    Returns:
        Starting points. Shape (s, p). [per parameter]
    """
    guess = space.expected
    sigma = 0.5 * (space.upper - space.lower)
    low, high = ndtr((space.lower - guess) / sigma), ndtr((space.upper - guess) / sigma)
    starts = np.empty((row.n_starts, space.n_parameters))
    starts[0] = guess
    for j in range(1, row.n_starts):
        u = np.random.default_rng([row.seed, j]).random(space.n_parameters)
        starts[j] = guess + sigma * ndtri(low + u * (high - low))
    return np.clip(starts, space.lower, space.upper)


def minimize_from(
    model: ForwardModel, measurement: Measurement, row: Row, theta0: FloatArray, stop: Event | None = None
) -> Start:
    """Let an optimizer go from one starting point.

    Args:
        model: The physical model.
        measurement: What it is compared with.
        row: Which optimizer, with which objective and coordinates.
        theta0: Starting point; differential evolution does without. Shape (p,). [per parameter]
        stop: Ends the search early when it is set.

    Returns:
        The best point it saw, whether or not the optimizer was content.
    """
    recorder = Recorder(CalibrationProblem(model, measurement), phase="direct", max_calls=row.max_calls)
    space, is_unit = model.parameter_space, row.in_unit_cube
    p = space.n_parameters
    bounds = Bounds(np.zeros(p), np.ones(p)) if is_unit else Bounds(space.lower, space.upper)

    def residuals(x: FloatArray) -> FloatArray:
        if stop is not None and stop.is_set():
            raise BudgetExceeded("the command was interrupted")
        inside = np.clip(x, bounds.lb, bounds.ub)
        answer = recorder.evaluate((inside if is_unit else space.to_unit(inside))[None])
        found: FloatArray = answer.residuals[0]
        return np.full(len(found), np.sqrt(FAILED)) if answer.failures[0] else found

    try:
        reason = _solve(row, residuals, bounds, space.to_unit(theta0) if is_unit else theta0)
    except BudgetExceeded as over:
        reason = str(over)
    except ValueError as error:
        reason = f"the optimizer failed: {error}"
    theta = theta0 if recorder.best is None else recorder.best.theta[0]
    return Start(tuple(theta.tolist()), min(recorder.best_mse, FAILED), recorder.n_calls, reason)


def _solve(row: Row, residuals: Callable[[FloatArray], FloatArray], bounds: Bounds, x0: FloatArray) -> str:
    """Let SciPy's optimizer of a row go from a point in its coordinates; return why it ended."""
    # The methods of `minimize` take SciPy's own default for None.
    tol, max_calls = row.tolerance, row.max_calls
    if row.method == "LS-TRF":
        tol = 1e-8 if tol is None else tol  # SciPy's default of both
        ends = (bounds.lb, bounds.ub)
        return str(least_squares(residuals, x0, bounds=ends, method="trf", ftol=tol, xtol=tol).message)

    def mse(x: FloatArray) -> float:
        return float(np.mean(residuals(x) ** 2))

    if row.method == "Differential evolution":
        generations = 1000 if max_calls is None else max_calls // (POPULATION * len(x0)) - 1
        # Without SciPy's closing L-BFGS-B, which the paper's count excludes.
        found = differential_evolution(
            mse,
            bounds,
            popsize=POPULATION,
            maxiter=max(1, generations),
            tol=0.01 if tol is None else tol,
            polish=False,
            rng=np.random.default_rng(row.seed),
        )
        return str(found.message)
    # SLSQP has a limit of iterations instead, 100 by default.
    options: Any = {} if max_calls is None or row.method == "SLSQP" else {"maxfev": max_calls}
    solver: Any = minimize  # the method is no literal here
    return str(solver(mse, x0, method=row.method, bounds=bounds, tol=tol, options=options).message)


def run(plan: Plan) -> Shown:
    """Compute the rows of the budget, in the order of the paper, and LS-TRF in the scales of the case."""
    task, folder = plan.task, plan.folder("table3")

    def cells(method: str, n_calls: int | None, mse: float | None, **changes: Any) -> tuple[Cell, ...]:
        row = replace(SETTINGS[method], seed=task.profile.seed, **changes)
        starts = computed(task, row, folder)
        return row.title, sum(one.n_calls for one in starts), min(one.mse for one in starts), n_calls, mse

    rows = [
        cells(method, n_calls, mse, n_starts=n_starts)
        for method, n_starts, n_calls, mse in TABLE_3
        if n_calls <= plan.budget.max_row_calls
    ]
    own_scales = cells("LS-TRF", None, None, in_unit_cube=True)
    unit = square_of(task.case.outputs[0].unit)
    return Shown(
        f"Table 3: optimizers on the FMU; of many starts the best; MSE [{unit}]",
        ("method", "calls", "MSE", "paper: calls", "paper: MSE"),
        (*rows, own_scales),
    )
