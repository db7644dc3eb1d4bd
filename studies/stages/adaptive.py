"""The stage that calibrates without a surrogate: it needs the case alone, and nothing it was told is lost."""

import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.errors import InputError
from simulation.time_unit import told_period
from studies.calibration.adaptive import Adaptive, AdaptiveResult
from studies.calibration.ledger import Ledger
from studies.calibration.recorder import History, Progress
from studies.console import OnBar, format_seconds
from studies.physical_model import open_physical_model
from studies.recipe import recipe_of
from studies.report.wording import count, difference_unit, percent, quantity, squared
from studies.stages.calibrate import write_arrays
from studies.stages.calibrated_values import show_parameters
from studies.stages.guideline import Periods, judge_calibration, show_guideline
from studies.stages.knowledge import prior_inputs, prior_numbers, prior_of, show_prior
from studies.stages.pipeline import Outcome, StageError, Study, Summary, digest_of, run_stage, write_json
from studies.stages.results import ADAPTIVE, StoredCalibration, adaptive_files, read_arrays
from studies.stages.simulate import say_reused
from studies.stages.tracking import log_adaptive
from studies.stages.validation import show_validation, validate_calibration, validation_inputs
from studies.tracking.origin import environment

MAX_CALLS = 100
STAGE = f"calibrate-{ADAPTIVE}"
# Where none of the first rows can be simulated, more of them are a waste.
N_HOPELESS = 20
# A root mean square error of more than so many sensor uncertainties is no answer while calls are left.
DOUBT = 2.0
# A line for those who read a log instead of watching a bar. [s]
NEWS_EVERY_S = 30.0


def adaptive_settings(
    case: Case, *, max_calls: int | None, n_parallel: int | None, target_mse: float | None
) -> Adaptive:
    """Return what the command line asks for.

    Args:
        case: the case to calibrate.
        max_calls: most simulations, None for the usual number.
        n_parallel: rows per round, None for one.
        target_mse: error to stop at, or None. [first output's unit squared]

    Raises:
        InputError: the budget does not hold the first design.
    """
    # Where every output is off by its own sensor's uncertainty, the MSE is the first one's squared.
    sensor = float(case.measurement.uncertainty[0])
    settings = Adaptive(
        max_calls=MAX_CALLS if max_calls is None else max_calls,
        n_parallel=n_parallel or 1,
        # Who names an error wants it: small gains are no reason to stop before.
        ftol=Adaptive.ftol if target_mse is None else 0.0,
        doubtful_mse=(DOUBT * sensor) ** 2 if np.isfinite(sensor) else None,
        target_mse=target_mse,
    )
    n_start = settings.design_size(case.parameter_space.n_parameters)
    if settings.max_calls < n_start:
        raise InputError(
            f"--max-calls {settings.max_calls} does not hold the first design of {n_start} simulations for "
            f"{count(case.parameter_space.n_parameters, 'parameter')}; give {2 * n_start} or more"
        )
    return settings


def adaptive_stage(study: Study, settings: Adaptive, *, again: bool = False) -> Outcome:
    """Calibrate with the physical model alone.

    Every simulation is stored as soon as it is finished and the rows follow from case, settings and seed: a
    calibration that was interrupted reads what it had and goes on.

    Args:
        study: the study.
        settings: how to search.
        again: calibrate though it is finished.
    """
    case = study.case
    inputs = {
        "case": case.digest,
        "measurement": case.measurement.digest,
        "is_log": case.parameter_space.is_log.tolist(),
        "settings": asdict(settings),
        "seed": study.profile.seed,
        **validation_inputs(case),
        **prior_inputs(case),
    }
    files = adaptive_files(study)

    def work() -> tuple[Summary, list[Path]]:
        started_s = time.time()
        numbers, arrays, n_simulated = calibrate_adaptively(study, settings)
        recipe = recipe_of(
            study, "adaptive", command="studies calibrate --method adaptive", settings=asdict(settings)
        )
        summary = {**numbers, "file": study.paths.show(files.numbers), "n_simulated": n_simulated}
        numbers |= {"recipe": recipe, "environment": environment()}
        write_arrays(files.arrays, arrays)
        write_json(files.numbers, numbers)
        wall_s = time.time() - started_s
        log_adaptive(
            study,
            StoredCalibration(files, numbers, arrays, wall_s),
            digest_of(inputs),
            started_s=started_s,
            wall_s=wall_s,
        )
        return summary, [files.numbers, files.arrays]

    if again:
        (study.results / f"{STAGE}.json").unlink(missing_ok=True)
    return run_stage(
        study,
        STAGE,
        what=f"a Gaussian process of the residuals, {count(settings.max_calls, 'simulation')} at most",
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: f"final MSE {summary['mse']:.5f}",
    )


def calibrate_adaptively(study: Study, settings: Adaptive) -> tuple[dict[str, Any], dict[str, Any], int]:
    """Calibrate and keep nothing but the simulations.

    Args:
        study: the study.
        settings: how to search.

    Returns:
        The numbers, the arrays and how many rows were not stored before.
    """
    from studies.calibration.problem import CalibrationProblem

    case, seed = study.case, study.profile.seed
    with open_physical_model(study) as physical, study.console.bars() as bars:
        result = settings.minimize(
            CalibrationProblem(physical, case.measurement, prior_of(case)),
            seed=seed,
            on_progress=_teller(study, bars),
        )
    if not np.isfinite(result.mse):
        raise _hopeless(study, result.n_calls)
    say_reused(study, STAGE, physical)
    validated, simulated = validate_calibration(study, {"calibrated": result.theta})
    ledger = Ledger(n_adaptive=result.n_calls)
    numbers = {
        "label": study.label,
        "note": case.note,
        "case_sha256": case.digest,
        "measurement_sha256": case.measurement.digest,
        "method": ADAPTIVE,
        "n_train": ledger.n_train,
        "seed": seed,
        "settings": asdict(settings),
        "theta": dict(zip(case.parameter_space.names, result.theta.tolist(), strict=True)),
        "mse": result.mse,
        "outputs": _outputs(case, result.y),
        "ledger": ledger.to_dict(),
        "n_rounds": result.n_rounds,
        "stop_reason": result.stop_reason,
        "converged": result.converged,
        "expected_gain": result.expected_gain if np.isfinite(result.expected_gain) else None,
        **validated,
        **prior_numbers(case, result.theta),
    }
    return numbers, _arrays(case, result) | simulated, physical.n_simulated


def _arrays(case: Case, result: AdaptiveResult) -> dict[str, Any]:
    return {
        "time": case.measurement.time,
        "measured": case.measurement.y,
        "theta": result.theta,
        "y": result.y,
        "history_calls": result.history.n_calls,
        "history_mse": result.history.best_mse,
    }


def _outputs(case: Case, y: FloatArray) -> dict[str, dict[str, float | None]]:
    """Return how each output differs from its measurement, beside what its sensor can tell."""
    found = {}
    for k, output in enumerate(case.outputs):
        difference = case.measurement.differences(y[None], k)[0]
        sensor = float(case.measurement.uncertainty[k])
        found[output.name] = {
            "rmse": float(np.sqrt(np.mean(difference**2))),
            "uncertainty": sensor if np.isfinite(sensor) else None,
            "share_within": float(np.mean(np.abs(difference) <= sensor)) if np.isfinite(sensor) else None,
        }
    return found


def _teller(study: Study, bars: OnBar) -> Callable[[Progress], None]:
    """Return what tells the user of every round, on a bar or now and then in a line."""
    unit = squared(difference_unit(study.case.outputs[0].unit))
    last_said = time.monotonic()

    def tell(now: Progress) -> None:
        nonlocal last_said
        if now.n_done >= N_HOPELESS and not np.isfinite(now.best_mse):
            raise _hopeless(study, now.n_done)
        best = f"best MSE {quantity(now.best_mse, unit)}"
        bars("adaptive", now.n_done, now.n_total or now.n_done, f", {count(now.n_done, 'call')}, {best}")
        if not study.console.is_live and time.monotonic() - last_said > NEWS_EVERY_S:
            last_said = time.monotonic()
            study.console.say(f"{STAGE}: {count(now.n_done, 'call')}, {best}")

    return tell


def _hopeless(study: Study, n_calls: int) -> StageError:
    return StageError(
        f"none of {count(n_calls, 'simulation')} succeeded; type: studies check {study.command}"
    )


def show_adaptive(study: Study, outcome: Outcome) -> None:
    """Print what was found, why it ended and what it cost."""
    found, console = outcome.summary, study.console
    unit = squared(difference_unit(study.case.outputs[0].unit))
    n_calls = found["ledger"]["n_adaptive"]
    is_parallel = found["settings"]["n_parallel"] > 1
    rounds = "" if not is_parallel else f" in {count(found['n_rounds'], 'round')}"
    console.result(
        f"{study.label}: MSE {quantity(found['mse'], unit, 4)} after {count(n_calls, 'model call')}{rounds} "
        f"({format_seconds(outcome.wall_s)}); it ended because {found['stop_reason']}"
    )
    console.result(_fit(study, found))
    doubtful = found["settings"]["doubtful_mse"]
    if doubtful is not None and found["mse"] > doubtful:
        console.result(
            f"That is more than {DOUBT:g} times the sensor's uncertainty: there may be a deeper valley, or "
            "the model lacks something; try more --max-calls, another --seed, or studies run"
        )
    for known in study.case.references:
        if known.is_target:
            reached = calls_to(study, known.mse)
            calls = "not reached" if reached is None else f"reached after {count(reached, 'call')}"
            console.result(f"MSE {quantity(known.mse, unit)} ({known.label}): {calls}")
    show_parameters(study, found["theta"], ADAPTIVE)
    show_prior(study, found, ADAPTIVE)
    show_validation(study, [outcome])
    show_guideline(study, judged_adaptive(study, outcome))
    if study.case.note:
        console.result(f"Note: {study.case.note}")
    console.result(f"Pictures: studies report {study.command}")


def judged_adaptive(study: Study, outcome: Outcome) -> Periods:
    """Judge the calibration by ASHRAE guideline 14."""
    y = read_arrays(adaptive_files(study).arrays)["y"]
    return judge_calibration(study.case, y, outcome.summary)


def calls_to(study: Study, target: float) -> int | None:
    """Return the calls after which the error was at most the target. [first output's unit squared]."""
    arrays = read_arrays(adaptive_files(study).arrays)
    return History(arrays["history_calls"], arrays["history_mse"]).calls_to(target)


def _fit(study: Study, found: Summary) -> str:
    parts = []
    for output in study.case.outputs:
        fit, unit = found["outputs"][output.name], difference_unit(output.unit)
        part = f"{output.name} differs by {quantity(fit['rmse'], unit)} (RMS)"
        if fit["uncertainty"] is not None:
            sensor = f"±{fit['uncertainty']:g} {unit}".strip()
            part += f", {percent(fit['share_within'])} of it within the sensor's {sensor}"
        parts.append(part)
    return f"On {told_period(study.case.window_d)} {'; '.join(parts)}"
