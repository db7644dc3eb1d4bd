"""What the terminal shows of calibrations and their uncertainty, and what it costs and leaves open."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from simulation.time_unit import period_text
from studies.calibration.misfit_threshold import SENSOR_UNCERTAINTIES
from studies.console import Column, format_seconds
from studies.physical_model import warn_failed
from studies.report.guideline14 import Judged, guideline_sentence, judge, judged
from studies.report.uncertainty import HOW_KNOWN, sentences, uncertainty_record
from studies.report.wording import (
    MISSING,
    bound_at,
    count,
    difference_unit,
    mse_text,
    percent,
    quantity,
    significant,
    squared,
)
from studies.stages.check import found_of_the_step
from studies.stages.determined import open_in_words, open_note
from studies.stages.guided import equations_in_words
from studies.stages.knowledge import show_prior
from studies.stages.pipeline import Outcome, Study
from studies.stages.results import Numbers, StoredResult, stored_calibration


def calibrations_of(study: Study, outcomes: Sequence[Outcome]) -> list[StoredResult]:
    """Return the calibrations that stages have just left, or left before."""
    stages = [outcome.stage.removeprefix("calibrate-") for outcome in outcomes]
    return [found for name in stages if (found := stored_calibration(study, name)) is not None]


def show_polished(study: Study, stored: Sequence[StoredResult]) -> None:
    """Print a row per training-set size, as the paper's Table 4, and the parameters of the least error."""
    titles = ["n_train", "MAE val", "MAE test", "MSE surrogate", "MSE screened", "gap"]
    titles += ["polish calls", "final MSE", "calls (paper)", "calls (all)"]
    rows = []
    for found in (one.numbers for one in stored):
        errors, ledger = found["surrogate_errors"], found["ledger"]
        rows.append(
            [
                found["n_train"],
                significant(errors["val/mae"]),
                significant(errors["test/mae"]),
                mse_text(found["mse_surrogate"]),
                mse_text(found["mse_screened"]),
                mse_text(found["screening_gap"]),
                ledger["n_polish"],
                mse_text(found["mse_polished"]),
                ledger["total_paper"],
                ledger["total_honest"],
            ]
        )
    unit = difference_unit(study.case.outputs[0].unit)
    units = f"MAE of the surrogate in {unit}; MSE in {squared(unit)}; " if unit else ""
    title = f"{study.label}: calibration ({units}MSE screened and final by the FMU)"
    study.console.table(title, [Column(title, True) for title in titles], rows)
    for one in stored:
        warn_failed(study, one.numbers)
    _show_validation(study, stored)
    best = min(stored, key=lambda one: one.mse)
    if math.isfinite(best.mse):
        _show_values(study, best, f"n_train = {best.numbers['n_train']}")


def show_adaptive(study: Study, outcome: Outcome, stored: StoredResult) -> None:
    """Print what was found, why it ended and what it cost."""
    found, console, case = stored.numbers, study.console, study.case
    unit = squared(difference_unit(case.outputs[0].unit))
    cost = count(found["ledger"]["total_paper"], "model call")
    if found["settings"]["n_parallel"] > 1:
        cost += f" in {count(found['n_rounds'], 'round')}"
    if n_known := found.get("n_known"):
        cost += f", begun with {count(n_known, 'stored simulation')}"
    console.result(
        f"{study.label}: MSE {quantity(found['mse'], unit, 4)} after {cost} "
        f"({format_seconds(outcome.wall_s)}); it ended because {found['stop_reason']}"
    )
    if found["left"]:
        console.result(f"Stopped, not converged: {found['left']}")
    warn_failed(study, found)
    if "state_equations" in found:
        console.result(equations_in_words(found["state_equations"]))
    console.result(_fit(study, found))
    doubtful = found["settings"]["misfit_threshold"]
    if doubtful is not None and found["mse"] > doubtful:
        many = f"{SENSOR_UNCERTAINTIES:g} times the sensor's uncertainty"
        console.result(f"That is more than {many}: {_doubt(study, found)}")
    for known in case.references:
        if known.is_target:
            reached = stored.calls_to(known.mse)
            calls = "not reached" if reached is None else f"reached after {count(reached, 'call')}"
            console.result(f"MSE {quantity(known.mse, unit)} ({known.label}): {calls}")
    _show_validation(study, [stored])
    _show_values(study, stored, stored.name)
    console.result(f"Pictures: studies report {study.command}")


def _fit(study: Study, found: Numbers) -> str:
    parts = []
    for output in study.case.outputs:
        fit, unit = found["outputs"][output.name], difference_unit(output.unit)
        part = f"{output.name} differs by {quantity(fit['rmse'], unit)} (RMS)"
        if fit["uncertainty"] is not None:
            sensor = f"±{fit['uncertainty']:g} {unit}".strip()
            part += f", {percent(fit['share_within'])} of it within the sensor's {sensor}"
        parts.append(part)
    return f"On {period_text(study.case.window_d)} {'; '.join(parts)}"


def _doubt(study: Study, found: Numbers) -> str:
    """Say what an error that is too large may come from."""
    of_the_step, lacks = found_of_the_step(study), "the model lacks something"
    if of_the_step:
        lacks = f"studies check found that {of_the_step}; else {lacks}"
    elif of_the_step is None and study.case.scenario.inputs_at_edges is None:
        # Elsewhere outputs see their inputs in time.
        lacks += ", or outputs lag behind inputs by a part of the communication step (studies check tests it)"
    settings = found["settings"]
    if settings["target_mse"] is not None and found["mse"] <= settings["target_mse"]:
        return "the search ended at its target; without --target it goes on"
    if found["converged"]:
        is_guided = found.get("state_equations", {}).get("are_believed", False)
        who = "state equations know of" if is_guided else "surrogate expects"
        return f"the {who} no deeper valley in the box: {lacks}, or a bound is in the way"
    more = "more --max-calls, " if found["ledger"]["total_paper"] >= settings["max_calls"] else ""
    return f"there may be a deeper valley, or {lacks}; try {more}another --seed, or studies run"


def _show_values(study: Study, stored: StoredResult, how: str) -> None:
    """Print the calibrated parameters, what judges them, and what to type next."""
    found, space, console = stored.numbers, study.case.parameter_space, study.console
    theta = np.array([found["theta"][name] for name in space.names])
    rows = []
    for parameter, value, u in zip(space.parameters, theta, space.to_unit(theta), strict=True):
        note = open_note(parameter.name, found)
        if parameter.name in found.get("without_effect", ()):
            # A bound that it happens to lie at says nothing.
            note = "the error hardly depends on it"
        elif not note and (bound := bound_at(float(u))):
            note = f"at the {bound} bound: widen it?"
        rows.append(
            [
                parameter.name,
                parameter.unit,
                "" if parameter.estimate is None else f"{parameter.estimate:.4g}",
                f"{value:.6g}",
                f"{parameter.lower:.4g} to {parameter.upper:.4g}",
                note,
            ]
        )
    columns = [Column("parameter"), Column("unit"), Column("estimate", True), Column("calibrated", True)]
    columns += [Column("bounds", True), Column("")]
    console.table(f"{study.label}: calibrated parameters ({how})", columns, rows)
    for line in open_in_words(found):
        console.result(line)
    show_prior(study, found, how)
    periods, days = judged_periods(study, stored), {"calibrated": study.case.window_d}
    if study.case.validation is not None:
        days["validation"] = study.case.validation.window_d
    for name, one in periods.items():
        if said := guideline_sentence(one):
            console.result(f"On {period_text(days[name])} ({name}): {said}")
    if study.case.note:
        console.result(f"Note: {study.case.note}")
    which = "" if stored.is_adaptive else f" --n-train {found['n_train']}"
    console.result(f"How sure it is: studies uncertainty {study.command}{which}")


def judged_periods(study: Study, stored: StoredResult) -> dict[str, tuple[Judged, ...]]:
    """Judge a calibration by ASHRAE guideline 14.

    Returns:
        The verdicts by period: "calibrated" and, where the case has one, "validation"; none of a failed one.
    """
    case, units = study.case, [output.unit for output in study.case.outputs]
    if not np.isfinite(stored.y).all():
        return {}
    periods = {"calibrated": judge(case.measurement, units, stored.y)}
    if case.validation is not None:
        last = list(stored.numbers["validation"]["points"].values())[-1]
        periods["validation"] = tuple(
            judged(case.validation.measurement, k, unit, fit["cv_rmse"], fit["nmbe"])
            for k, (unit, fit) in enumerate(zip(units, last["outputs"].values(), strict=False))
        )
    return periods


def guideline_numbers(study: Study, stored: StoredResult) -> dict[str, Any]:
    """Return the verdicts by period as plain values, for the document of a command."""
    return {name: [one.to_dict() for one in found] for name, found in judged_periods(study, stored).items()}


def _show_validation(study: Study, stored: Sequence[StoredResult]) -> None:
    """Print one row per training-set size and parameter set; nothing without a validation period."""
    validation = study.case.validation
    if validation is None:
        return
    unit = squared(difference_unit(study.case.outputs[0].unit))
    units = {output.name: output.unit for output in study.case.outputs}
    columns = [Column("n_train", True), Column("parameters"), Column("MSE window", True)]
    columns += [Column("MSE validation", True), Column("RMSE by output", True)]
    rows = [
        [
            one.numbers["n_train"] or MISSING,
            name,
            *(MISSING if mse is None else significant(mse, 4) for mse in (point["mse_window"], point["mse"])),
            ", ".join(
                f"{output} {quantity(fit['rmse'], difference_unit(units[output]))}"
                for output, fit in point["outputs"].items()
            )
            or f"failed: {point['failure']}",
        ]
        for one in stored
        for name, point in one.numbers["validation"]["points"].items()
    ]
    study.console.table(
        f"{study.label}: validation on {period_text(validation.window_d)} (MSE in {unit}; its simulations "
        "are in no count of calls)",
        columns,
        rows,
    )


def show_uncertainty(study: Study, stored: StoredResult | None) -> None:
    """Print intervals, and what the data determine and what not."""
    assert stored is not None, "its stage is finished"
    found = stored.numbers
    record = uncertainty_record(found, stored.arrays)
    share, rows = percent(found["level"]), []
    by_parameter = zip(
        study.case.parameter_space.parameters, record.digits, record.interval.T, record.known, strict=True
    )
    for parameter, digits, (low, high), known in by_parameter:
        one = found["parameters"][parameter.name]
        rows.append(
            [
                parameter.name,
                parameter.unit,
                f"{one['calibrated']:.{digits}g}",
                f"{low:.{digits}g} to {high:.{digits}g}" if record.is_trusted else MISSING,
                f"{one['linear'][0]:.{digits}g} to {one['linear'][1]:.{digits}g}",
                f"{parameter.lower:.4g} to {parameter.upper:.4g}",
                HOW_KNOWN[known],
            ]
        )
    columns = [Column("parameter"), Column("unit", spare=2), Column("calibrated", True)]
    columns += [Column(f"{share} interval", True), Column("linearised", True, spare=3)]
    columns += [Column("bounds", True, spare=1), Column("by the data")]
    title = f"{study.label}: {share} intervals of the {found['calibration']} calibration"
    study.console.table(title, columns, rows)
    warn_failed(study, found)
    for sentence in sentences(record, tuple(output.unit for output in study.case.outputs)):
        study.console.result(sentence)
    if study.case.note:
        study.console.result(f"Note: {study.case.note}")
    study.console.result(f"Pictures: studies report {study.command}")
