"""Table 4 and Fig. 9: for every size and seed the screened point, the gap, the polish, and what it cost."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import KnownError
from studies.calibration.polish import LeastSquaresTRF, PolishResult
from studies.calibration.problem import CalibrationProblem
from studies.calibration.recorder import History
from studies.paper.items import Origin, Shown, origin_of, write_size
from studies.paper.models import Chosen, Settings, chosen_settings, train_again
from studies.paper.plan import Plan
from studies.paper.published import TABLE_4, USUAL_MSE
from studies.physical_model import open_physical_model
from studies.reporting.drawing import (
    DIAMOND,
    FAINT,
    HOLLOW,
    LOG,
    Axis,
    Figure,
    Panel,
    Series,
    reference_lines,
    size_colors,
)
from studies.results.saved import Error
from studies.stages.calibrate_stage import calibrate_stage
from studies.task import Task
from studies.words.wording import axis_label, count, squared


@dataclass(frozen=True)
class SeedCalibration:
    """One calibration: a training design, a surrogate, a screening and two polishes from the same point.

    An MSE that is infinite could not be simulated. [first output's unit squared]

    Args:
        seed: of the training design, the training and the screening.
        val_mae: of the surrogate on the validation set. [output's unit]
        test_mae: on the test set. [output's unit]
        test_p90: 90th percentile on the test set. [output's unit]
        training_s: duration of the training. [s]
        mse_surrogate: at the screened point, by the surrogate.
        mse_screened: there, by the FMU.
        n_checks: calls that compared the screened points.
        polish_calls: calls after the training set so far, checks included, rising.
        polish_mse: lowest MSE after them.
        n_polish: calls of the polish.
        mse_polished: at its end.
        stop_reason: why it ended.
        squared_calls: calls of the polish as the paper writes it.
        squared_mse: MSE at its end.
        theta: the calibrated parameters. [per parameter]
    """

    seed: int
    val_mae: float
    test_mae: float
    test_p90: float
    training_s: float
    mse_surrogate: Error
    mse_screened: Error
    n_checks: int
    polish_calls: tuple[int, ...]
    polish_mse: tuple[Error, ...]
    n_polish: int
    mse_polished: Error
    stop_reason: str
    squared_calls: int
    squared_mse: Error
    theta: dict[str, float]

    @property
    def n_calls(self) -> int:
        """Calls after the training set."""
        return self.n_checks + self.n_polish

    def calls_to(self, target: float) -> float:
        """Return the calls after the training set until the MSE was at most a target; infinite: never."""
        calls = History(np.array(self.polish_calls), np.array(self.polish_mse)).calls_to(target)
        return np.inf if calls is None else calls


@dataclass(frozen=True)
class SizeCalibrations(Chosen):
    """All calibrations of one training-set size.

    Args:
        screening: settings of the screening.
        max_calls: most calls of a polish.
        references: known MSEs: label, MSE, whether it is a target.
        calibrations: one per seed; the first has the seed of Fig. 6.
    """

    screening: dict[str, float]
    max_calls: int
    references: tuple[tuple[str, float, bool], ...]
    calibrations: tuple[SeedCalibration, ...]


SIZE = SizeCalibrations


def run(plan: Plan) -> Shown:
    """Train the best of every size again, screen and polish; do it with more seeds for the small sizes."""
    chosen, origin = chosen_settings(plan), origin_of(plan, plan.task, "table4")
    sizes = dict[int, SizeCalibrations]()
    # All sizes with the first seed come first, each written at once: an interruption leaves what there is.
    for task in plan.seed_studies():
        for n in task.profile.data.n_train:
            found = calibrated(task, n, chosen[n].settings)
            before = sizes[n].calibrations if n in sizes else ()
            sizes[n] = SizeCalibrations(
                **vars(chosen[n]),
                screening=asdict(task.profile.screening),
                max_calls=task.profile.polish.max_calls,
                references=tuple((known.label, known.mse, known.is_target) for known in task.case.references),
                calibrations=(*before, found),
            )
            write_size(plan.folder("table4"), origin, n, sizes[n])
    return shown(origin, list(sizes.values()))


def calibrated(task: Task, n_train: int, settings: Settings) -> SeedCalibration:
    """Train a surrogate, calibrate with it, and polish the screened point once more as the paper does.

    Args:
        task: the study of a seed, with all its sizes.
        n_train: training-set size.
        settings: hyperparameters of the surrogate.
    """
    task, training_s = train_again(task, n_train, settings)
    found = calibrate_stage(task, n_train).result
    screened = found.screening
    assert screened is not None, "by the paper's method"
    squared_polish = paper_polish(task, np.array(list(screened.theta.values())))
    return SeedCalibration(
        seed=task.profile.seed,
        val_mae=screened.errors["val/mae"],
        test_mae=screened.errors["test/mae"],
        test_p90=screened.errors["test/p90"],
        training_s=round(training_s, 1),
        mse_surrogate=screened.mse_surrogate,
        mse_screened=screened.mse,
        n_checks=found.ledger["n_screen_checks"],
        polish_calls=tuple((found.history_calls - n_train).tolist()),
        polish_mse=tuple(found.history_mse.tolist()),
        n_polish=found.ledger["n_polish"],
        mse_polished=found.mse,
        stop_reason=found.stop_reason,
        squared_calls=squared_polish.n_calls,
        squared_mse=squared_polish.mse,
        theta=found.theta,
    )


def paper_polish(task: Task, screened: FloatArray) -> PolishResult:
    """Polish a screened point as Table 2 writes it: squared residuals, linear coordinates.

    Args:
        task: the task.
        screened: the point. Shape (p,). [per parameter]
    """
    settings = LeastSquaresTRF(
        max_calls=task.profile.polish.max_calls,
        ftol=task.profile.polish.ftol,
        residuals="squared",
    )
    with open_physical_model(task) as model:
        problem = CalibrationProblem(model, task.case.measurement)
        u = problem.space.to_unit(screened[None])
        return settings.minimize(problem, u[0], known=problem.evaluate(u))


def shown(origin: Origin, sizes: Sequence[SizeCalibrations]) -> Shown:
    """Return Table 4 and Fig. 9.

    Args:
        origin: where the calibrations come from.
        sizes: all calibrations by size, the smallest first.
    """
    rows = [_row(origin, size) for size in sizes]
    return Shown(
        f"Table 4, medians over the seeds; MSE [{squared(origin.unit)}], calls of the training set included",
        tuple(rows[0]),
        tuple(tuple(row.values()) for row in rows),
        "fig9.png",
        _fig9(origin, sizes),
        f"{origin.label}, seed {origin.seed}",
    )


def _row(origin: Origin, size: SizeCalibrations) -> dict[str, float | None]:
    n, paper = size.n_train, TABLE_4.get(size.n_train)

    def middle(values: Iterable[float]) -> float:
        return quartiles([*values])[1]

    every = size.calibrations
    low, to_usual, high = quartiles([n + one.calls_to(USUAL_MSE) for one in every])
    in_all = middle(n + one.n_calls for one in every)
    to_final = None if paper is None else middle(n + one.calls_to(paper.mse_polished) for one in every)
    return {
        "n_train": n,
        "seeds": len(every),
        "test MAE": middle(one.test_mae for one in every),
        "MSE surrogate": middle(one.mse_surrogate for one in every),
        "MSE screened": middle(one.mse_screened for one in every),
        "polish calls": middle(one.n_polish for one in every),
        "final MSE": middle(one.mse_polished for one in every),
        "calls": in_all,
        "calls, validation and test too": in_all + origin.n_validation + origin.n_test,
        f"calls to {USUAL_MSE}": to_usual,
        "lower quartile": low,
        "upper quartile": high,
        "calls to the paper's final": to_final,
        "final MSE, squared residuals": middle(one.squared_mse for one in every),
        "paper: screened": None if paper is None else paper.mse_screened,
        "paper: final": None if paper is None else paper.mse_polished,
        "paper: calls": None if paper is None else paper.total,
    }


def quartiles(values: Sequence[float]) -> list[float]:
    """Return lower quartile, median and upper quartile; a quartile between two values is their mean.

    Args:
        values: Infinite where a target was never reached.
    """
    # NumPy's would be NaN beside an infinite value.
    ordered, places = np.sort(values), len(values) * np.array([0.25, 0.5, 0.75])
    lower, upper = np.ceil(places).astype(int) - 1, np.floor(places).astype(int)
    found: list[float] = (0.5 * (ordered[lower] + ordered[upper])).tolist()
    return found


def _fig9(origin: Origin, sizes: Sequence[SizeCalibrations]) -> Figure:
    """Show the gap at the screened point by size, and the MSE over the calls of the polish: one seed."""
    colors = size_colors([size.n_train for size in sizes])
    lines = reference_lines([KnownError(*known) for known in sizes[0].references])
    gaps, polishes = [*lines], [*lines]
    for size in sizes:
        name, color, one = f"n = {count(size.n_train)}", colors[size.n_train], size.calibrations[0]
        place, ends = [str(size.n_train)], [one.mse_surrogate, one.mse_screened]
        gaps += [
            Series(f"{name}, gap", FAINT, place * 2, ends, style={"strokeWidth": 4}, is_named=False),
            Series(f"{name}, model", color, place, ends[1:], "point", DIAMOND, is_named=False),
            Series(f"{name}, surrogate", color, place, ends[:1], "point", HOLLOW, is_named=False),
        ]
        steps = {"interpolate": "step-after", "strokeWidth": 1.5}
        polishes.append(Series(name, color, one.polish_calls, one.polish_mse, style=steps))
    y = Axis(axis_label("MSE", squared(origin.unit)), LOG)
    x_sizes = Axis("training simulations", is_of_names=True)
    panels = (
        Panel("surrogate (circle) and model (diamond)", x_sizes, y, gaps, 300),
        Panel("MSE during the polish", Axis("model calls of the polish"), y, polishes, 300),
    )
    title = "Fig. 9: gap at the screened point, and polish"
    return Figure(title, panels, columns=2, shows_names=True)
