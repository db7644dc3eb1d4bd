"""The stage that calibrates by the paper's method: from the best surrogate of a training-set size."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from simulation.errors import InputError
from studies.paths import size_name
from studies.physical_model import failed_numbers, open_physical_model, say_reused
from studies.report.wording import mse_text
from studies.stages.determined import determined_numbers
from studies.stages.knowledge import case_inputs, prior_numbers, prior_of
from studies.stages.pipeline import Outcome, Stage, Study
from studies.stages.results import Arrays, Numbers, calibration_files, keep_result
from studies.stages.results import write_arrays as write_arrays
from studies.stages.simulate import datasets_of
from studies.stages.tracking import log_calibration
from studies.stages.validation import validate_calibration, validation_inputs

if TYPE_CHECKING:
    from pelsvae.surrogate import Surrogate
    from studies.tuning.results import TrialView, TunedStudy

PHASES = {"screen": "screen, surrogate evaluations", "polish": "polish, FMU calls"}


def tuned_sizes(study: Study, asked: Sequence[int] | None) -> "dict[int, tuple[TunedStudy, TrialView]]":
    """Return the tuned study and the best trial of each training-set size.

    Args:
        study: the study.
        asked: the sizes the user named, None for all that have a surrogate of this case.

    Raises:
        InputError: an asked size has no surrogate, or there is none at all.
    """
    from studies.stages.tuned_trials import tuned_by_size

    found = {n: (one, one.best) for n, one in tuned_by_size(study).items() if one.best is not None}
    missing = [n_train for n_train in asked or () if n_train not in found]
    if missing or not found:
        of, sizes = study.label, "".join(f" {n_train}" for n_train in missing)
        there = f"there are {', '.join(map(str, found))}" if found else "there are none"
        raise InputError(
            f"{of} has no surrogate of this case{f' for n_train ={sizes}' if sizes else ''}, {there}; "
            f"type: studies tune {study.command}{f' --n-train{sizes}' if sizes else ''}"
        )
    return {n: found[n] for n in sorted(set(asked or found))}


def best_surrogate(study: Study, n_train: int) -> "tuple[Surrogate, TunedStudy]":
    """Load the best surrogate of a size from its MLflow run, on the CPU wherever it was trained.

    Raises:
        InputError: there is none of this case, or its weights cannot be read here.
    """
    from studies.tracking.registry import load_surrogate
    from studies.tracking.stage_run import run_store

    tuned, best = tuned_sizes(study, [n_train])[n_train]
    return load_surrogate(run_store(study.paths), best.run_id), tuned


def calibrate_stage(study: Study, n_train: int, *, again: bool = False) -> Outcome:
    """Calibrate with the stored surrogate of one training-set size.

    Args:
        study: the study.
        n_train: training-set size.
        again: calibrate though it is finished.
    """
    profile, (tuned, best) = study.profile, tuned_sizes(study, [n_train])[n_train]
    surrogate = {"study": tuned.spec.name, "trial": best.number, "run_id": best.run_id}
    inputs = {
        **case_inputs(study.case),
        "surrogate": best.weights_sha256,
        "screening": asdict(profile.screening),
        "polish": asdict(profile.polish),
        "n_validation": profile.data.n_validation,
        "n_test": profile.data.n_test,
        "seed": profile.seed,
        **validation_inputs(study.case),
    }

    what = "differential evolution on the surrogate, then LS-TRF on the FMU"
    stage = Stage(study, f"calibrate-{size_name(n_train)}", what, inputs)
    before = stage.finished(lambda summary: f"final MSE {mse_text(summary['mse_polished'])}", again=again)
    if before is not None:
        return before
    with stage.work() as work:
        numbers, arrays = calibrate(study, best_surrogate(study, n_train)[0], n_train)
        wall = {name: numbers.pop(name) for name in list(numbers) if name.startswith("wall")}
        numbers |= {
            "n_train": n_train,
            "surrogate_errors": dict(best.metrics),
            "surrogate": {**surrogate, "params": dict(best.params), "sha256": best.weights_sha256},
        }
        return keep_result(
            work,
            calibration_files(study, n_train),
            numbers,
            arrays,
            this_time={"wall": wall},
            recipe={
                "kind": "calibration",
                "n_train": n_train,
                "datasets": datasets_of(profile, n_train, tuned.spec.digests),
                "surrogate": surrogate,
            },
            log=log_calibration,
        )


def calibrate(study: Study, surrogate: "Surrogate", n_train: int) -> tuple[Numbers, Arrays]:
    """Calibrate and keep nothing but the simulations.

    Args:
        study: the study.
        surrogate: what the box is screened with.
        n_train: size of its training set.

    Returns:
        The numbers, wall times among them, and the arrays.
    """
    from studies.calibration.polish import LeastSquaresTRF
    from studies.calibration.screen import DifferentialEvolution
    from studies.calibration.two_phase import calibrate_two_phase
    from studies.surrogate_model import SurrogateModel

    case, profile = study.case, study.profile
    measurement, space, prior = case.measurement, case.parameter_space, prior_of(case)
    with open_physical_model(study) as physical, study.console.bars() as bars:
        result = calibrate_two_phase(
            SurrogateModel(surrogate, space, measurement.output_names, measurement.time, n_jobs=study.n_jobs),
            physical,
            measurement,
            screening=DifferentialEvolution(**asdict(profile.screening)),
            polishing=LeastSquaresTRF(max_calls=profile.polish.max_calls, ftol=profile.polish.ftol),
            seed=profile.seed,
            n_train=n_train,
            n_validation=profile.data.n_validation,
            n_test=profile.data.n_test,
            prior=prior,
            on_progress=lambda now: bars(PHASES[now.phase], now.n_done, now.n_total or now.n_done),
        )
    say_reused(study, f"calibrate-{size_name(n_train)}", physical)
    validated, simulated = validate_calibration(
        study, {"screened": result.theta_screened, "polished": result.theta}
    )
    numbers: dict[str, Any] = {
        **result.to_dict(),
        **validated,
        **prior_numbers(case, result.theta),
        **failed_numbers(physical),
        **determined_numbers(
            space.names, measurement, prior, u=result.u, y=result.y_polished, slopes=result.slopes
        ),
    }
    arrays = {
        "time": measurement.time,
        "measured": measurement.y,
        "theta": result.theta,
        "theta_screened": result.theta_screened,
        "y_surrogate": result.y_surrogate,
        "y_screened": result.y_screened,
        "y_polished": result.y_polished,
        "history_calls": result.polish_history.n_calls,
        "history_mse": result.polish_history.best_mse,
        **simulated,
    }
    return numbers, arrays
