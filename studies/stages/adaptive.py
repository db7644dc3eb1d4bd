"""The stage that calibrates without a surrogate: it needs the case alone, and nothing it was told is lost."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.errors import InputError
from simulation.store.stored_model import StoredModel
from studies.calibration.adaptive import Adaptive, AdaptiveResult
from studies.calibration.known_rows import best_and_far
from studies.calibration.ledger import Ledger
from studies.calibration.prior import Prior
from studies.calibration.problem import CalibrationProblem
from studies.calibration.recorder import Progress
from studies.calibration.state_guide import LEAST_CALLS
from studies.calibration.states import why_unwatched
from studies.console import OnBar
from studies.doctor.region import commonest
from studies.physical_model import (
    failed_numbers,
    open_physical_model,
    open_watched_model,
    say_reused,
)
from studies.recipe import recipe_of
from studies.report.wording import count, difference_unit, mse_text, quantity, squared
from studies.stages.adaptive_known import check_design, known_arrays, known_of, offer_stored
from studies.stages.calibrate import write_arrays
from studies.stages.determined import determined_numbers
from studies.stages.guided import asked_twice, guide_of, guided_numbers
from studies.stages.knowledge import prior_inputs, prior_numbers
from studies.stages.known_rows import ChooseRows, KnownRows
from studies.stages.pipeline import Outcome, StageError, Study, Summary, digest_of, run_stage, write_json
from studies.stages.restriction import (
    Restriction,
    calls_for_check,
    find_restriction,
    parts_of,
    recipe_part,
    restriction_inputs,
    restriction_numbers,
    told_kept,
)
from studies.stages.results import (
    ADAPTIVE,
    StoredCalibration,
    adaptive_files,
    most_relevant,
    n_free_of,
    restricted,
)
from studies.stages.tracking import log_adaptive
from studies.stages.validation import validate_calibration, validation_inputs
from studies.tracking.origin import environment

MAX_CALLS = 100
STAGE = f"calibrate-{ADAPTIVE}"
# Where none of the first rows can be simulated, more of them are a waste.
N_HOPELESS = 20
# Rows whose states are tried at once before any was read: more failures than these end a campaign.
MOST_AT_FIRST = 8
# A line for those who read a log instead of watching a bar. [s]
NEWS_EVERY_S = 30.0


def adaptive_settings(
    case: Case,
    *,
    max_calls: int | None,
    n_parallel: int | None,
    target_mse: float | None,
    n_free: int | None = None,
    n_calls_before: int = 0,
    from_stored: bool = False,
    state_equations: bool = False,
) -> Adaptive:
    """Return what the command line asks for.

    Args:
        case: the case to calibrate.
        max_calls: most simulations, None for the usual number.
        n_parallel: rows per round, None for one.
        target_mse: error to stop at, or None. [first output's unit squared]
        n_free: parameters that are calibrated, None for all.
        n_calls_before: simulations of the budget that are spent before the search begins.
        from_stored: whether it begins with what is stored, which may be a first design or most of one.
        state_equations: whether it learns state equations, from less than a first design.

    Raises:
        InputError: the budget does not hold the first design.
    """
    settings = Adaptive.for_sensor(
        float(case.measurement.uncertainty[0]),
        max_calls=MAX_CALLS if max_calls is None else max_calls,
        n_parallel=n_parallel or 1,
        target_mse=target_mse,
    )
    n_parameters = n_free or case.parameter_space.n_parameters
    n_start = 1 if from_stored else settings.design_size(n_parameters)
    if state_equations:
        n_start = min(n_start, LEAST_CALLS)
    if settings.max_calls < n_calls_before + n_start:
        before = (
            f"{n_calls_before} simulations to find the relevant parameters and " if n_calls_before else ""
        )
        is_part = n_start < settings.design_size(n_parameters)
        least = "the least" if is_part else "the first design"
        start = f"{least} of {n_start} simulations for {count(n_parameters, 'parameter')}"
        enough = n_calls_before + (1 if from_stored else 2 * n_start)
        raise InputError(
            f"--max-calls {settings.max_calls} does not hold {before}{'one more' if from_stored else start}; "
            f"give {enough} or more"
        )
    return settings


def adaptive_command(study: Study, numbers: Mapping[str, Any]) -> str:
    """Return the command line that makes an adaptive calibration of this study, from its numbers."""
    settings = numbers["settings"]
    words = f"studies calibrate {study.command} --max-calls {settings['max_calls']}"
    if settings["n_parallel"] > 1:
        words += f" --parallel {settings['n_parallel']}"
    if settings["target_mse"] is not None:
        words += f" --target {settings['target_mse']}"
    if "n_known" in numbers:
        words += " --from-stored"
    if "state_equations" not in numbers and not why_unwatched(study.case):
        words += " --no-state-equations"
    return words + most_relevant(n_free_of(numbers))


def adaptive_stage(
    study: Study,
    settings: Adaptive,
    *,
    n_free: int | None = None,
    from_stored: bool = False,
    state_equations: bool = False,
    again: bool = False,
) -> Outcome:
    """Calibrate with the physical model alone.

    Every simulation is stored as soon as it is finished and the rows follow from case, settings and seed: a
    calibration that was interrupted reads what it had and goes on.

    Args:
        study: the study.
        settings: how to search.
        n_free: how many of the parameters are calibrated, the most relevant; None for all.
        from_stored: whether to begin with the simulations that are stored, whatever they were made for.
        state_equations: whether to learn the model's state equations from the states that its FMU shows.
        again: calibrate though it is finished, with what is stored now.
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
        **restriction_inputs(study, n_free),
        **({"from_stored": True} if from_stored else {}),
        **({"state_equations": True} if state_equations else {}),
    }
    files = adaptive_files(study, n_free)
    stage = STAGE + restricted(n_free)
    known_rows = None
    if from_stored:
        # Another budget or target goes on with the same rows, as does what was begun again and interrupted.
        any_end = replace(settings, max_calls=1, target_mse=None)
        question = inputs | {"settings": asdict(any_end)}
        is_finished = (study.results / f"{stage}.json").is_file()
        known_rows = KnownRows(files.rows, digest_of(question), best_and_far, anew=again and is_finished)

    def work() -> tuple[Summary, list[Path]]:
        started_s = time.time()
        restriction = None if n_free is None else find_restriction(study, n_free)
        numbers, arrays, n_simulated = calibrate_adaptively(
            study, settings, restriction, known_rows, state_equations=state_equations
        )
        recipe = recipe_of(
            study,
            "adaptive",
            command=adaptive_command(study, numbers),
            settings=asdict(settings),
            **recipe_part(restriction),
        )
        summary = {**numbers, "file": study.paths.recorded(files.numbers), "n_simulated": n_simulated}
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
        return summary, [files.numbers, files.arrays, *([files.rows] if from_stored else [])]

    return run_stage(
        study,
        stage,
        what=(
            f"{'state equations or ' if state_equations else ''}a Gaussian process of the residuals, "
            f"{count(settings.max_calls, 'simulation')} at most"
        ),
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: f"final MSE {mse_text(summary['mse'])}",
        again=again,
    )


def calibrate_adaptively(
    study: Study,
    settings: Adaptive,
    restriction: Restriction | None = None,
    known_rows: ChooseRows | None = None,
    *,
    state_equations: bool = False,
) -> tuple[dict[str, Any], dict[str, Any], int]:
    """Calibrate and keep nothing but the simulations.

    Args:
        study: the study.
        settings: how to search; the budget is of everything, finding the relevant parameters included.
        restriction: which parameters are held at what, None for none.
        known_rows: which simulations are known beforehand, None for none.
        state_equations: whether to learn the model's state equations.

    Returns:
        The numbers, the arrays and how many rows were not stored before.
    """
    case, seed = study.case, study.profile.seed
    n_before = 0 if restriction is None else restriction.n_calls
    n_first = min(settings.n_parallel, MOST_AT_FIRST)
    opened = open_watched_model(study, n_first=n_first) if state_equations else open_physical_model(study)
    with opened as physical, study.console.bars() as bars:
        model = parts_of(physical, restriction)
        prior = Prior.of(model.parameter_space, case.measurement)
        n_kept = n_before + calls_for_check(case, settings, restriction)
        problem = CalibrationProblem(model, case.measurement, prior)
        guide = guide_of(physical, model, problem)
        rows, known = None, None
        if known_rows is None:
            offer_stored(study, physical, model)
        else:
            rows, known = known_of(study, problem, physical, model, known_rows)
            check_design(settings, known, n_kept, state_equations=state_equations)
        n_read = physical.n_reused
        result = replace(settings, max_calls=settings.max_calls - n_kept).minimize(
            problem,
            seed=seed,
            known=known,
            guide=guide,
            on_progress=_teller(study, physical, bars),
        )
    theta = model.complete(result.theta)
    if not np.isfinite(result.mse):
        raise _hopeless(study, physical)
    say_reused(study, STAGE, physical, n_repeated=n_read)
    n_left = settings.max_calls - n_before - result.n_calls - asked_twice(physical)
    told, n_checks = restriction_numbers(study, restriction, theta, n_calls_left=n_left)
    validated, simulated = validate_calibration(study, {"calibrated": theta})
    ledger = Ledger(n_adaptive=result.n_calls + asked_twice(physical), n_relevance=n_before + n_checks)
    numbers = {
        "label": study.label,
        "note": case.note,
        "case_sha256": case.digest,
        "measurement_sha256": case.measurement.digest,
        "method": ADAPTIVE,
        "n_train": ledger.n_train,
        "seed": seed,
        "settings": asdict(settings),
        **({} if known is None else {"n_known": known.n}),
        **guided_numbers(guide, physical),
        "theta": dict(zip(case.parameter_space.names, theta.tolist(), strict=True)),
        "mse": result.mse,
        "outputs": _outputs(case, result.y),
        "ledger": ledger.to_dict(),
        "n_rounds": result.n_rounds + math.ceil(ledger.n_relevance / settings.n_parallel),
        **failed_numbers(physical),
        "stop_reason": result.stop_reason + told_kept(result.converged, settings.max_calls, n_kept),
        "converged": result.converged,
        "left": result.left,
        "without_effect": [
            name for name, flat in zip(model.parameter_space.names, result.is_flat, strict=True) if flat
        ],
        **determined_numbers(
            model.parameter_space.names,
            case.measurement,
            prior,
            u=result.u,
            y=result.y,
            slopes=result.slopes,
        ),
        "expected_gain": result.expected_gain if np.isfinite(result.expected_gain) else None,
        **validated,
        **prior_numbers(case, theta),
        **told,
    }
    arrays = _arrays(case, result, theta, n_before) | known_arrays(rows, state_equations=state_equations)
    return numbers, arrays | simulated, physical.n_simulated


def _arrays(case: Case, result: AdaptiveResult, theta: FloatArray, n_calls_before: int) -> dict[str, Any]:
    history = result.history.after(n_calls_before)
    return {
        "time": case.measurement.time,
        "measured": case.measurement.y,
        "theta": theta,
        "y": result.y,
        "history_calls": history.n_calls,
        "history_mse": history.best_mse,
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


def _teller(study: Study, physical: StoredModel, bars: OnBar) -> Callable[[Progress], None]:
    """Return what tells the user of every round, on a bar or now and then in a line."""
    unit = squared(difference_unit(study.case.outputs[0].unit))
    last_said = time.monotonic()

    def tell(now: Progress) -> None:
        nonlocal last_said
        if now.n_done >= N_HOPELESS and not np.isfinite(now.best_mse):
            raise _hopeless(study, physical)
        n_failed = len(physical.failures)
        if study.case.policy.is_hopeless(now.n_done, n_failed):
            raise _mostly_failed(study, physical, now)
        best = f"best MSE {quantity(now.best_mse, unit)}"
        bars("adaptive", now.n_done, now.n_total or now.n_done, f", {count(now.n_done, 'call')}, {best}")
        if not study.console.is_live and time.monotonic() - last_said > NEWS_EVERY_S:
            last_said = time.monotonic()
            study.console.say(f"{STAGE}: {count(now.n_done, 'call')}, {best}")

    return tell


def _mostly_failed(study: Study, physical: StoredModel, now: Progress) -> StageError:
    unit = squared(difference_unit(study.case.outputs[0].unit))
    return StageError(
        f"{len(physical.failures)} of {count(now.n_done, 'simulation')} failed, more than "
        f"simulation.max_failed_share = {study.case.policy.max_failed_share:g} allows; the commonest reason: "
        f"{commonest(physical.failures)}; the best MSE so far is {quantity(now.best_mse, unit, 4)}, and the "
        f"finished simulations are kept; narrow the bounds (studies check {study.command} says where it "
        "fails) or raise the share"
    )


def _hopeless(study: Study, physical: StoredModel) -> StageError:
    return StageError(
        f"none of {count(len(physical.failures), 'simulation')} succeeded, the first one: "
        f"{physical.failures[0]}; type: studies check {study.command}"
    )
