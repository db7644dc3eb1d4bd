"""Table 4 and Fig. 9: for every size and seed the screened point, the gap, the polish, and what it cost."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.polish import LeastSquaresTRF, PolishResult
from studies.calibration.problem import CalibrationProblem
from studies.paper.models import Chosen, Settings, chosen_settings, settings_inputs, train_again
from studies.paper.plan import Plan
from studies.paper.result import ItemResult, item_folder
from studies.paper.size_files import Origin, origin_of, write_sizes
from studies.paper.table4_shown import shown
from studies.paper.table4_sizes import SeedCalibration, SizeCalibrations, read_calibrations
from studies.physical_model import open_physical_model
from studies.stages.calibrate import calibrate_stage
from studies.stages.pipeline import Study
from studies.stages.results import calibration_files, read_arrays


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
    chosen, origin = chosen_settings(plan), origin_of(plan, plan.study, "table4")
    folder, sizes = item_folder(plan.study, "table4"), dict[int, SizeCalibrations]()
    # All sizes with the first seed come first, each written at once: an interruption leaves what there is.
    for study in (plan.study, *map(plan.seed_study, plan.more_seeds)):
        for n in study.profile.data.n_train:
            found = calibrated(study, n, chosen.settings[n])
            before = sizes[n].calibrations if n in sizes else ()
            sizes[n] = _size(study, chosen, n, (*before, found))
            write_sizes(folder, origin, [sizes[n]])
    files = write_sizes(folder, origin, list(sizes.values()))
    return replace(shown(origin, list(sizes.values())), files=files)


def drawn_from(folder: Path) -> tuple[Origin, ItemResult]:
    """Return the same from the files of an earlier run, without simulations and trainings.

    Raises:
        InputError: the files cannot be read, or do not belong together.
    """
    origin, sizes = read_calibrations(folder)
    return origin, shown(origin, sizes)


def _size(
    study: Study, chosen: Chosen, n_train: int, calibrations: tuple[SeedCalibration, ...]
) -> SizeCalibrations:
    return SizeCalibrations(
        n_train=n_train,
        surrogate=study.profile.tuning.surrogate,
        settings=chosen.settings[n_train],
        tuned_on_d=chosen.window_d,
        screening=asdict(study.profile.screening),
        max_calls=study.profile.polish.max_calls,
        references=tuple((known.label, known.mse, known.is_target) for known in study.case.references),
        calibrations=calibrations,
    )


def calibrated(study: Study, n_train: int, settings: Settings) -> SeedCalibration:
    """Train a surrogate, calibrate with it, and polish the screened point once more as the paper does.

    Args:
        study: the study of a seed, with all its sizes.
        n_train: training-set size.
        settings: hyperparameters of the surrogate.
    """
    study, training_s = train_again(study, n_train, settings)
    numbers = calibrate_stage(study, n_train).summary
    errors, ledger = numbers["surrogate_errors"], numbers["ledger"]
    arrays = read_arrays(calibration_files(study, n_train).arrays)
    squared = paper_polish(study, arrays["theta_screened"])
    return SeedCalibration(
        seed=study.profile.seed,
        val_mae=errors["val/mae"],
        test_mae=errors["test/mae"],
        test_p90=errors["test/p90"],
        training_s=round(training_s, 1),
        mse_surrogate=numbers["mse_surrogate"],
        mse_screened=numbers["mse_screened"],
        n_checks=ledger["n_screen_checks"],
        polish_calls=tuple((arrays["history_calls"] - n_train).tolist()),
        polish_mse=tuple(arrays["history_mse"].tolist()),
        n_polish=ledger["n_polish"],
        mse_polished=numbers["mse_polished"],
        stop_reason=numbers["polish_stop_reason"],
        squared_calls=squared.n_calls,
        squared_mse=squared.mse if np.isfinite(squared.mse) else None,
        theta=numbers["theta"],
    )


def paper_polish(study: Study, screened: FloatArray) -> PolishResult:
    """Polish a screened point as Table 2 writes it: squared residuals, linear coordinates.

    Args:
        study: the study.
        screened: the point. Shape (p,). [per parameter]
    """
    settings = LeastSquaresTRF(
        max_calls=study.profile.polish.max_calls,
        ftol=study.profile.polish.ftol,
        residuals="squared",
        coordinates="linear",
        x_scale="unit",
    )
    with open_physical_model(study) as model:
        problem = CalibrationProblem(model, study.case.measurement)
        u = np.asarray(problem.space.to_unit(screened[None]), dtype=np.float64)
        return settings.minimize(problem, u[0], known=problem.evaluate(u))
