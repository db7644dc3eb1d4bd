"""Table 4 and Fig. 9: for every size and seed the screened point, the gap, the polish, and what it cost."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.problem import CalibrationProblem
from studies.paper.models import Chosen, Models, chosen_settings, settings_inputs, train_again
from studies.paper.plan import Plan
from studies.paper.result import ItemResult, item_folder
from studies.paper.size_files import Origin, origin_of, write_sizes
from studies.paper.table4_shown import shown
from studies.paper.table4_sizes import Calibration, SizeCalibrations, read_calibrations
from studies.physical_model import open_physical_model
from studies.stages.calibrate import calibrate_stage
from studies.stages.pipeline import Outcome, Study
from studies.stages.results import calibration_files, read_arrays


@dataclass(frozen=True)
class PaperPolish:
    """The polish as Table 2 of the paper writes it, from the same screened point.

    Args:
        n_calls: calls of the model.
        mse: final MSE; None where nothing could be simulated. [first output's unit squared]
    """

    n_calls: int
    mse: float | None


def inputs(plan: Plan) -> dict[str, Any]:
    """Return all that decides the result."""
    profile = plan.study.profile.to_dict()
    seeds = {n: list(plan.seeds_of(n)) for n in plan.budget.n_train}
    return {**settings_inputs(plan), "seeds": seeds, **{k: profile[k] for k in ("screening", "polish")}}


def estimate_s(plan: Plan) -> float:
    """Estimate how long it takes from nothing. [s]."""
    sizes = [n for n in plan.budget.n_train for _ in plan.seeds_of(n)]
    return plan.trainings_s(sizes) + len(sizes) * plan.screening_s()


def run(plan: Plan) -> ItemResult:
    """Train the best of every size again, screen and polish; do it with more seeds for the small sizes."""
    chosen = chosen_settings(plan)
    found: dict[int, list[Calibration]] = {n: [] for n in plan.budget.n_train}
    work_s = 0.0
    # All sizes with the first seed come first: an interruption leaves the whole table.
    for study in (plan.study, *map(plan.seed_study, plan.more_seeds)):
        models = train_again(study, chosen.settings)
        outcomes = {n: calibrate_stage(models.study, n) for n in models.wall_s}
        for n, one in _calibrations(models, outcomes).items():
            found[n].append(one)
        work_s += models.simulated.wall_s + sum(models.wall_s.values())
        work_s += sum(outcome.wall_s for outcome in outcomes.values())
    origin = origin_of(plan, plan.study, "table4")
    sizes = [_size(plan.study, chosen, n, ones) for n, ones in found.items()]
    files = write_sizes(item_folder(plan.study, "table4"), origin, sizes)
    return replace(shown(origin, sizes), files=files, work_s=work_s)


def drawn_from(folder: Path) -> tuple[Origin, ItemResult]:
    """Return the same from the files of an earlier run, without simulations and trainings.

    Raises:
        InputError: the files cannot be read, or do not belong together.
    """
    origin, sizes = read_calibrations(folder)
    return origin, shown(origin, sizes)


def _size(
    study: Study, chosen: Chosen, n_train: int, calibrations: Sequence[Calibration]
) -> SizeCalibrations:
    return SizeCalibrations(
        n_train=n_train,
        surrogate=study.profile.tuning.surrogate,
        settings=chosen.settings[n_train],
        tuned_on_d=chosen.window_d,
        screening=asdict(study.profile.screening),
        max_calls=study.profile.polish.max_calls,
        references=tuple((known.label, known.mse, known.is_target) for known in study.case.references),
        calibrations=tuple(calibrations),
    )


def _calibrations(models: Models, outcomes: Mapping[int, Outcome]) -> dict[int, Calibration]:
    """Return the finished calibrations of a seed, with the paper's polish from each screened point."""
    study = models.study
    arrays = {n: read_arrays(calibration_files(study, n).arrays) for n in outcomes}
    polishes = paper_polishes(study, {n: one["theta_screened"] for n, one in arrays.items()})
    found = {}
    for n, outcome in outcomes.items():
        numbers, ledger = outcome.summary, outcome.summary["ledger"]
        errors = numbers["surrogate_errors"]
        found[n] = Calibration(
            seed=study.profile.seed,
            val_mae=errors["val/mae"],
            test_mae=errors["test/mae"],
            test_p90=errors["test/p90"],
            training_s=round(models.wall_s[n], 1),
            mse_surrogate=numbers["mse_surrogate"],
            mse_screened=numbers["mse_screened"],
            n_checks=ledger["n_screen_checks"],
            polish_calls=tuple((arrays[n]["history_calls"] - n).tolist()),
            polish_mse=tuple(arrays[n]["history_mse"].tolist()),
            n_polish=ledger["n_polish"],
            mse_polished=numbers["mse_polished"],
            stop_reason=numbers["polish_stop_reason"],
            squared_calls=polishes[n].n_calls,
            squared_mse=polishes[n].mse,
            theta=numbers["theta"],
        )
    return found


def paper_polishes(study: Study, screened: Mapping[int, FloatArray]) -> dict[int, PaperPolish]:
    """Polish screened points with squared residuals in linear coordinates.

    Args:
        study: the study.
        screened: points by size, each of shape (p,). [per parameter]
    """
    settings = LeastSquaresTRF(
        max_calls=study.profile.polish.max_calls,
        ftol=study.profile.polish.ftol,
        residuals="squared",
        coordinates="linear",
        x_scale="unit",
    )
    found = {}
    with open_physical_model(study) as model:
        problem = CalibrationProblem(model, study.case.measurement)
        for n, theta in screened.items():
            u = np.asarray(problem.space.to_unit(theta[None]), dtype=np.float64)
            polished = settings.minimize(problem, u[0], known=problem.evaluate(u))
            found[n] = PaperPolish(polished.n_calls, polished.mse if np.isfinite(polished.mse) else None)
    return found
