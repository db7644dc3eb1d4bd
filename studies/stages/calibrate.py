"""The stage that calibrates by the paper's method: from the best surrogate of a training-set size."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from simulation.errors import InputError
from simulation.whole_file import whole_file
from studies.paths import size_name
from studies.physical_model import failed_numbers, open_physical_model, say_reused
from studies.recipe import Recipe, recipe_of
from studies.report.wording import mse_text
from studies.stages.knowledge import prior_inputs, prior_numbers
from studies.stages.pipeline import Outcome, Study, Summary, digest_of, run_stage, write_json
from studies.stages.restriction import (
    Restriction,
    find_restriction,
    parts_of,
    recipe_part,
    restriction_inputs,
    restriction_numbers,
)
from studies.stages.results import StoredCalibration, calibration_files, most_relevant, restricted
from studies.stages.simulate import datasets_of
from studies.stages.tracking import log_calibration
from studies.stages.validation import validate_calibration, validation_inputs
from studies.tracking.origin import environment

if TYPE_CHECKING:
    from pelsvae.surrogate import Surrogate
    from studies.tuning.results import TunedStudy

PHASES = {"screen": "screen, surrogate evaluations", "polish": "polish, FMU calls"}


def tuned_sizes(study: Study, asked: Sequence[int] | None) -> tuple[int, ...]:
    """Return the training-set sizes to calibrate with.

    Args:
        study: the study.
        asked: the sizes the user named, None for all that have a surrogate of this case.

    Raises:
        InputError: an asked size has no surrogate, or there is none at all.
    """
    return tuple(_tuned(study, asked))


def _tuned(study: Study, asked: Sequence[int] | None) -> "dict[int, TunedStudy]":
    """Read the tuned studies of the asked sizes, by size; each has a best trial."""
    from studies.tuning.results import latest_studies, read_studies

    latest = latest_studies(read_studies(study.paths, label=study.label), study.case.digest)
    found = {n: one for (n, is_baseline), one in latest.items() if one.best is not None and not is_baseline}
    there = sorted(found)
    if not there:
        sizes = "".join(f" {n_train}" for n_train in asked or ())
        raise InputError(
            f"{study.label} has no surrogate of this case yet; type: studies tune {study.command}"
            + (f" --n-train{sizes}" if sizes else "")
        )
    missing = [n_train for n_train in asked or () if n_train not in there]
    if missing:
        raise InputError(
            f"no surrogate of {study.label} for n_train = {missing[0]}, there are "
            f"{', '.join(map(str, there))}; type: studies tune {study.command} --n-train {missing[0]}"
        )
    return {n: found[n] for n in sorted(set(asked or there))}


def best_surrogate(study: Study, n_train: int) -> "tuple[Surrogate, TunedStudy]":
    """Load the best surrogate of a size from its MLflow run, on the CPU wherever it was trained.

    Raises:
        InputError: there is none of this case, or its weights cannot be read here.
    """
    tuned = _tuned(study, [n_train])[n_train]
    return _surrogate_of(study, tuned), tuned


def _surrogate_of(study: Study, tuned: "TunedStudy") -> "Surrogate":
    from studies.tracking.registry import load_surrogate
    from studies.tracking.stage_run import run_store

    assert tuned.best is not None, "sizes without a best trial are left out"
    return load_surrogate(run_store(study.paths), tuned.best.run_id)


def calibrate_stage(study: Study, n_train: int, *, n_free: int | None = None, again: bool = False) -> Outcome:
    """Calibrate with the stored surrogate of one training-set size.

    Args:
        study: the study.
        n_train: training-set size.
        n_free: how many of the parameters are calibrated, the most relevant; None for all.
        again: calibrate though it is finished.
    """
    tuned, profile = _tuned(study, [n_train])[n_train], study.profile
    assert tuned.best is not None, "sizes without a best trial are left out"
    inputs = {
        "case": study.case.digest,
        "measurement": study.case.measurement.digest,
        "is_log": study.case.parameter_space.is_log.tolist(),
        "surrogate": tuned.best.weights_sha256,
        "screening": asdict(profile.screening),
        "polish": asdict(profile.polish),
        "n_validation": profile.data.n_validation,
        "n_test": profile.data.n_test,
        "seed": profile.seed,
        **validation_inputs(study.case),
        **prior_inputs(study.case),
        **restriction_inputs(study, n_free),
    }
    files = calibration_files(study, n_train, n_free)
    stage = f"calibrate-{size_name(n_train)}{restricted(n_free)}"

    def work() -> tuple[Summary, list[Path]]:
        started_s = time.time()
        surrogate = _surrogate_of(study, tuned)
        restriction = None if n_free is None else find_restriction(study, n_free)
        numbers, arrays, wall = calibrate(study, surrogate, n_train, restriction)
        numbers = _head(study, tuned) | numbers
        numbers |= {"recipe": _recipe(study, tuned, restriction), "environment": environment()}
        write_arrays(files.arrays, arrays)
        write_json(files.numbers, numbers)
        wall_s = time.time() - started_s
        stored = StoredCalibration(files, numbers, arrays, wall_s)
        log_calibration(study, stored, digest_of(inputs), started_s=started_s, wall_s=wall_s)
        left_out = ("recipe", "environment")
        kept = {k: v for k, v in numbers.items() if not k.endswith("_history") and k not in left_out}
        kept |= {"file": study.paths.recorded(files.numbers), "wall": wall}
        return kept, [files.numbers, files.arrays]

    return run_stage(
        study,
        stage,
        what="differential evolution on the surrogate, then LS-TRF on the FMU",
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: f"final MSE {mse_text(summary['mse_polished'])}",
        again=again,
    )


def calibrate(
    study: Study, surrogate: "Surrogate", n_train: int, restriction: Restriction | None = None
) -> tuple[dict[str, Any], dict[str, Any], dict[str, float]]:
    """Calibrate and keep nothing but the simulations.

    Args:
        study: the study.
        surrogate: what the box is screened with.
        n_train: size of its training set.
        restriction: which parameters are held at what, None for none.

    Returns:
        The numbers, the arrays and the wall times.
    """
    from studies.calibration.polish import LeastSquaresTRF
    from studies.calibration.prior import Prior
    from studies.calibration.screen import DifferentialEvolution
    from studies.calibration.two_phase import calibrate_two_phase
    from studies.surrogate_model import SurrogateModel

    measurement, profile = study.case.measurement, study.profile
    space = study.case.parameter_space
    predicting = SurrogateModel(
        surrogate, space, measurement.output_names, measurement.time, n_jobs=study.n_jobs
    )
    with open_physical_model(study) as physical, study.console.bars() as bars:
        model = parts_of(physical, restriction)
        result = calibrate_two_phase(
            parts_of(predicting, restriction),
            model,
            measurement,
            screening=DifferentialEvolution(**asdict(profile.screening)),
            polishing=LeastSquaresTRF(max_calls=profile.polish.max_calls, ftol=profile.polish.ftol),
            seed=profile.seed,
            n_train=n_train,
            n_validation=profile.data.n_validation,
            n_test=profile.data.n_test,
            prior=Prior.of(model.parameter_space, measurement),
            on_progress=lambda now: bars(PHASES[now.phase], now.n_done, now.n_total or now.n_done),
        )
    say_reused(study, f"calibrate-{size_name(n_train)}", physical)
    n_before = 0 if restriction is None else restriction.n_calls
    result = replace(result, polish_history=result.polish_history.after(n_before))
    theta, screened = model.complete(result.theta), model.complete(result.theta_screened)
    n_left = profile.polish.max_calls - result.ledger.n_polish
    told, n_checks = restriction_numbers(study, restriction, theta, n_calls_left=n_left)
    validated, simulated = validate_calibration(study, {"screened": screened, "polished": theta})
    numbers = result.to_dict() | validated | prior_numbers(study.case, theta) | told
    numbers |= {
        "theta": dict(zip(space.names, theta.tolist(), strict=True)),
        "theta_screened": dict(zip(space.names, screened.tolist(), strict=True)),
        "ledger": replace(result.ledger, n_relevance=n_before + n_checks).to_dict(),
        **failed_numbers(physical),
    }
    wall = {name: numbers.pop(name) for name in list(numbers) if name.startswith("wall")}
    arrays = {
        "time": measurement.time,
        "measured": measurement.y,
        "theta": theta,
        "theta_screened": screened,
        "y_surrogate": result.y_surrogate,
        "y_screened": result.y_screened,
        "y_polished": result.y_polished,
        "history_calls": result.polish_history.n_calls,
        "history_mse": result.polish_history.best_mse,
        **simulated,
    }
    return numbers, arrays, wall


def _head(study: Study, tuned: "TunedStudy") -> dict[str, Any]:
    """Return what a calibration's numbers belong to."""
    best = tuned.best
    assert best is not None, "sizes without a best trial are left out"
    return {
        "label": study.label,
        "note": study.case.note,
        "case_sha256": study.case.digest,
        "measurement_sha256": study.case.measurement.digest,
        "n_train": tuned.spec.n_train,
        "surrogate_errors": dict(best.metrics),
        "surrogate": {
            "study": tuned.spec.name,
            "trial": best.number,
            "run_id": best.run_id,
            "params": dict(best.params),
            "sha256": best.weights_sha256,
        },
    }


def _recipe(study: Study, tuned: "TunedStudy", restriction: Restriction | None) -> Recipe:
    """Return what makes a calibration again from the surrogate of its trial's run."""
    few = most_relevant(None if restriction is None else restriction.n_free)
    best, n_train = tuned.best, tuned.spec.n_train
    assert best is not None, "sizes without a best trial are left out"
    return recipe_of(
        study,
        "calibration",
        command=f"studies calibrate {study.words('polish')} --method paper --n-train {n_train}{few}",
        **recipe_part(restriction),
        n_train=n_train,
        datasets=datasets_of(study.profile, n_train, tuned.spec.digests),
        surrogate={"study": tuned.spec.name, "trial": best.number, "run_id": best.run_id},
    )


def write_arrays(file: Path, arrays: Mapping[str, Any]) -> None:
    """Write an .npz file in one step."""
    with whole_file(file) as stream:
        np.savez_compressed(stream, allow_pickle=False, **{name: np.asarray(a) for name, a in arrays.items()})
