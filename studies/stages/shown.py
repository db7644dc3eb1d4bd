"""What the terminal shows of calibrations and their uncertainty, and what it costs and leaves open."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from simulation.time_unit import period_text
from studies.calibration.misfit_threshold import SENSOR_UNCERTAINTIES
from studies.console import Column, format_seconds
from studies.page_tables import terminal_table
from studies.report import ReportData
from studies.report.guideline14 import Judged, guideline_sentence, judge, judged
from studies.report.tables import validation_table
from studies.report.tables_of_calibrations import calibrations_table, intervals_table
from studies.report.uncertainty_record import sentences
from studies.report.wording import bound_at, count, difference_unit, percent, quantity, squared
from studies.stages.check_stage import found_of_the_step
from studies.stages.pipeline import Outcome, Study
from studies.stages.report_records import (
    calibration_record,
    measured_series,
    uncertainty_record,
    validation_record,
)
from studies.stages.stage_results import ADAPTIVE, Calibration, Uncertainty

FAR = 2.0
"""So many standard deviations from what was known, the data contradict it."""


def report_of(study: Study, outcomes: Sequence[Outcome[Calibration]] = (), **more: Any) -> ReportData:
    """Return what the report's tables of a study are made from.

    Args:
        study: the study.
        outcomes: its calibrations.
        more: other fields of `ReportData`.
    """
    case, found = study.case, [(one, validation_record(study.case, one.result)) for one in outcomes]
    return ReportData(
        label=study.label,
        title=case.title,
        note=case.note,
        measurement=measured_series(case),
        parameters=case.parameter_space,
        calibrations=tuple(calibration_record(one) for one, _ in found),
        validations=tuple(record for _, record in found if record is not None),
        references=case.references,
        **more,
    )


def show_polished(study: Study, outcomes: Sequence[Outcome[Calibration]]) -> None:
    """Print a row per training-set size, as the paper's Table 4, and the parameters of the least error."""
    study.console.show([terminal_table(calibrations_table(report_of(study, outcomes)))])
    for one in outcomes:
        _warn_failed(study, one.result)
    _show_validation(study, outcomes)
    best = min((one.result for one in outcomes), key=lambda one: one.mse)
    if math.isfinite(best.mse):
        _show_values(study, best, f"n_train = {best.n_train}")


def show_adaptive(study: Study, outcome: Outcome[Calibration]) -> None:
    """Print what was found, why it ended and what it cost."""
    found, console, case = outcome.result, study.console, study.case
    unit = squared(difference_unit(case.outputs[0].unit))
    cost = count(found.n_calls_paper, "model call")
    if found.settings["n_parallel"] != 1:
        cost += f" in {count(found.n_rounds or 0, 'round')}"
    if found.n_warm_start:
        cost += f", begun with {count(found.n_warm_start, 'stored simulation')}"
    console.result(
        f"{study.label}: MSE {quantity(found.mse, unit, 4)} after {cost} "
        f"({format_seconds(outcome.wall_s)}); it ended because {found.stop_reason}"
    )
    if found.left:
        console.result(f"Stopped, not converged: {found.left}")
    _warn_failed(study, found)
    if found.state_equations is not None:
        console.result(found.state_equations.sentence)
    console.result(_fit(study, found))
    threshold = found.settings["misfit_threshold"]
    if isinstance(threshold, float) and found.mse > threshold:
        many = f"{SENSOR_UNCERTAINTIES:g} times the sensor's uncertainty"
        console.result(f"That is more than {many}: {_misfit(study, found)}")
    for known in case.references:
        if known.is_target:
            reached = found.history.calls_to(known.mse)
            calls = "not reached" if reached is None else f"reached after {count(reached, 'call')}"
            console.result(f"MSE {quantity(known.mse, unit)} ({known.label}): {calls}")
    _show_validation(study, [outcome])
    _show_values(study, found, ADAPTIVE)
    console.result(f"Pictures: studies report {study.command}")


def _fit(study: Study, found: Calibration) -> str:
    parts = []
    for output in study.case.outputs:
        fit, unit = found.outputs[output.name], difference_unit(output.unit)
        part = f"{output.name} differs by {quantity(fit.rmse, unit)} (RMS)"
        if fit.uncertainty is not None and fit.share_within is not None:
            sensor = f"±{fit.uncertainty:g} {unit}".strip()
            part += f", {percent(fit.share_within)} of it within the sensor's {sensor}"
        parts.append(part)
    return f"On {period_text(study.case.window_d)} {'; '.join(parts)}"


def _misfit(study: Study, found: Calibration) -> str:
    """Say what an error that is too large may come from."""
    of_the_step, lacks = found_of_the_step(study), "the model lacks something"
    if of_the_step:
        lacks = f"studies check found that {of_the_step}; else {lacks}"
    elif of_the_step is None and study.case.scenario.inputs_at_edges is None:
        # With inputs at the edges outputs see them in time.
        lacks += ", or outputs lag behind inputs by a part of the communication step (studies check tests it)"
    target, most = found.settings["target_mse"], found.settings["max_calls"]
    if isinstance(target, float) and found.mse <= target:
        return "the search ended at its target; without --target it goes on"
    if found.converged:
        who = "state equations know of" if found.believes_equations else "surrogate expects"
        return f"the {who} no deeper valley in the box: {lacks}, or a bound is in the way"
    more = "more --max-calls, " if isinstance(most, int) and found.n_calls_paper >= most else ""
    return f"there may be a deeper valley, or {lacks}; try {more}another --seed, or studies run"


def _show_values(study: Study, found: Calibration, how: str) -> None:
    """Print the calibrated parameters, what judges them, and what to type next."""
    space, console, judged = study.case.parameter_space, study.console, found.determined_by_data
    held = {} if found.prior is None else found.prior.parameters
    rows = []
    for parameter, value, u in zip(space.parameters, found.point, space.to_unit(found.point), strict=True):
        note = "" if judged is None else judged.note(parameter.name)
        if parameter.name in found.without_effect:
            # A bound that it happens to lie at says nothing.
            note = "the error hardly depends on it"
        elif not note and (bound := bound_at(float(u))):
            note = f"at the {bound} bound: widen it?"
        if (known := held.get(parameter.name)) is not None:
            before = f"known before: {known.in_words}, moved by {known.moved_deviations:+.2f} deviations"
            if abs(known.moved_deviations) > FAR:
                before += ": the data contradict it"
            note = "; ".join(filter(None, (note, before)))
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
    for line in () if judged is None else judged.sentences:
        console.result(line)
    if (prior := found.prior) is not None:
        unit = squared(difference_unit(study.case.outputs[0].unit))
        console.result(
            f"One standard deviation of a prior weighs as much as {quantity(prior.weight, unit)} of MSE "
            f"({prior.n_independent:.4g} independent samples); all priors together "
            f"{quantity(prior.penalty, unit)}, which no MSE shown here includes"
        )
    periods, days = judged_periods(study, found), {"calibrated": study.case.window_d}
    if study.case.validation is not None:
        days["validation"] = study.case.validation.window_d
    for name, one in periods.items():
        if said := guideline_sentence(one):
            console.result(f"On {period_text(days[name])} ({name}): {said}")
    if study.case.note:
        console.result(f"Note: {study.case.note}")
    which = "" if found.is_adaptive else f" --n-train {found.n_train}"
    console.result(f"How sure it is: studies uncertainty {study.command}{which}")


def judged_periods(study: Study, found: Calibration) -> dict[str, tuple[Judged, ...]]:
    """Judge a calibration by ASHRAE guideline 14.

    Returns:
        The verdicts by period: "calibrated" and, where the case has one, "validation"; none of a failed one.
    """
    case, units = study.case, [output.unit for output in study.case.outputs]
    if not np.isfinite(found.y).all():
        return {}
    periods = {"calibrated": judge(case.measurement, units, found.y)}
    if case.validation is not None and found.validation is not None:
        fits = found.validation.final.outputs.values()
        periods["validation"] = tuple(
            judged(case.validation.measurement, k, unit, fit.cv_rmse, fit.nmbe)
            for k, (unit, fit) in enumerate(zip(units, fits, strict=False))
        )
    return periods


def guideline_numbers(study: Study, found: Calibration) -> dict[str, Any]:
    """Return the verdicts by period as plain values, for the document of a command."""
    periods = judged_periods(study, found)
    return {name: [one.to_dict() for one in verdicts] for name, verdicts in periods.items()}


def _show_validation(study: Study, outcomes: Sequence[Outcome[Calibration]]) -> None:
    """Print a row per parameter set and output; nothing without a validation period."""
    data = report_of(study, outcomes)
    for one in data.by_size:
        if (record := data.validation_of(one)) is not None:
            study.console.show([terminal_table(validation_table(one, record))])
            study.console.result("No count of calls includes the simulations of the validation")


def show_uncertainty(study: Study, found: Uncertainty) -> None:
    """Print intervals, and what the data determine and what not."""
    record, case = uncertainty_record(found), study.case
    study.console.show([terminal_table(intervals_table(case.parameter_space, record))])
    _warn_failed(study, found)
    for sentence in sentences(record, tuple(output.unit for output in case.outputs)):
        study.console.result(sentence)
    if case.note:
        study.console.result(f"Note: {case.note}")
    study.console.result(f"Pictures: studies report {study.command}")


def _warn_failed(study: Study, found: Calibration | Uncertainty) -> None:
    if found.n_failed:
        study.console.warn(
            f"{count(found.n_failed, 'simulation')} failed, the first one: {found.first_failure} "
            "(--retry-failed asks again)"
        )
