"""What each picture says, in one sentence made of numbers from the data."""

from __future__ import annotations

import math

import numpy as np

from simulation.time_unit import DAYS, unit_for
from studies.report.data import ReportData
from studies.report.findings import enclosed_fraction, good_rows, residual_of
from studies.report.guideline14 import guideline_sentence, judge
from studies.report.records import CalibrationRecord, CoverageSet, MeasuredSeries
from studies.report.records_tuning import LearningCurves, TrialsRecord
from studies.report.wording import (
    count,
    difference_unit,
    listed,
    percent,
    quantity,
    shown_unit,
    squared,
)
from studies.sensitivity import SobolIndices


def mse_unit(measurement: MeasuredSeries) -> str:
    """Return the unit of an MSE: the first output's, squared."""
    return squared(difference_unit(measurement.units[0]))


def headline_sentence(data: ReportData) -> str:
    """Say the result of the study in one sentence."""
    c = data.headline
    if c is None:
        return "Nothing has been calibrated yet."
    if c.is_adaptive and not c.calls_paper:
        made = f"No model call beside {count(c.n_known, 'stored simulation')}"
    else:
        parts = [f"{count(c.n_relevance)} to find and check what matters"] if c.n_relevance else []
        if not c.is_adaptive:
            parts += [
                f"{count(c.n_train)} for training",
                f"{count(c.n_screen_checks)} to check the screened point",
                f"{count(c.n_polish)} to polish",
            ]
        elif c.n_known:
            parts.append(f"beside {count(c.n_known, 'stored simulation')}")
        made = count(c.calls_paper, "model call") + (f" ({', '.join(parts)})" if parts else "")
    few = "" if c.n_free is None else f"the {count(c.n_free)} most relevant of "
    return (
        f"{made} calibrated {few}{count(len(data.parameters.names), 'parameter')} to an MSE of "
        f"{quantity(c.mse_polished, mse_unit(data.measurement))}."
    )


def calibration_caption(measurement: MeasuredSeries, calibration: CalibrationRecord) -> str:
    """Say how well the polished model follows the measurement."""
    parts = []
    for k, name in enumerate(measurement.output_names):
        unit, residual = difference_unit(measurement.units[k]), residual_of(measurement, calibration, k)
        if residual is None:
            parts.append(f"{name} could not be simulated")
            continue
        unit_of_time = unit_for(float(measurement.time[-1]))
        moment = f"{residual.largest_at_s / unit_of_time.seconds:.1f}"
        when = f"day {moment}" if unit_of_time is DAYS else f"{moment} {unit_of_time.symbol}"
        side = "high" if residual.bias > 0 else "low"
        part = (
            f"{name} differs from the measurement by {quantity(residual.rms, unit)} (root mean square) and "
            f"at most by {quantity(abs(residual.largest), unit)} ({when}), "
            f"its mean is {quantity(abs(residual.bias), unit, 2)} too {side}"
        )
        if math.isfinite(residual.within):
            sensor = f"±{float(measurement.uncertainty[k]):g} {unit}".strip()
            part += f", and {percent(residual.within)} of the values lie within the sensor's {sensor}"
        parts.append(part)
    caption = f"After the {'calibration' if calibration.is_adaptive else 'polish'} {'; '.join(parts)}."
    if not np.isfinite(calibration.y_polished).all():
        return caption
    found = judge(measurement.measurement, measurement.units, calibration.y_polished)
    return f"{caption} {guideline_sentence(found)}"


def calls_caption(calibration: CalibrationRecord, unit: str) -> str:
    """Say what the search began with, and what its calls made of it."""
    c, end = calibration, quantity(calibration.mse_polished, unit)
    ended = f"; it ended because {c.stop_reason}" if c.stop_reason else ""
    if not c.is_adaptive:
        answer = quantity(c.mse_screened, unit) if math.isfinite(c.mse_screened) else "a failure"
        return (
            f"At the screened point the surrogate predicted {quantity(c.mse_surrogate, unit)} and the model "
            f"answered {answer}; {count(c.n_polish, 'polish call')} ended at {end}{ended}."
        )
    n_start, start = int(c.history_calls[0]), float(c.history_mse[0])
    before = f"stored {count(c.n_known)}" if c.n_known else f"first {count(n_start)}"
    found = f"MSE {quantity(start, unit)}" if math.isfinite(start) else "none succeeded"
    n_after = count(int(c.history_calls[-1]) - n_start, "call")
    return f"Best of the {before} simulations: {found}; {n_after} after them ended at {end}{ended}."


def trials_caption(trials: TrialsRecord) -> str:
    """Say how the trials ended."""
    states = [
        f"{count(trials.state.count(s))} {s}" for s in ("complete", "pruned", "failed") if s in trials.state
    ]
    if not states:
        return "No trial has ended."
    return f"Of {count(len(trials.state), 'trial')} {listed(states)}."


def coverage_caption(measurement: MeasuredSeries, coverage: CoverageSet) -> str:
    """Say whether the simulated set could have produced the measurement."""
    good = good_rows(coverage)
    n_failed = len(coverage.y) - len(good)
    failed = f" ({count(n_failed)} failed)" if n_failed else ""
    if not len(good):
        return f"All {count(len(coverage.y), f'{coverage.name} simulation')} failed."
    unit = shown_unit(measurement.units[0])
    simulated, measured = (
        f"from {quantity(float(values.min()), unit)} to {quantity(float(values.max()), unit)}"
        for values in (good[..., 0], measurement.samples[0].values)
    )
    return (
        f"{count(len(good), f'{coverage.name} simulation')}{failed} range {simulated} in "
        f"{measurement.output_names[0]}, the measurement {measured}; "
        f"{percent(enclosed_fraction(measurement, coverage))} of the measured values lie between the lowest "
        f"and the highest simulated one."
    )


def sensitivity_caption(sensitivity: SobolIndices) -> str:
    """Say which parameters matter, and how much lies in interactions."""
    parts = []
    for k, output in enumerate(sensitivity.output_names):
        first = sensitivity.mean_first_order()[k]
        if not np.isfinite(first).any():
            parts.append(f"{output} does not vary, so its indices are undefined")
            continue
        top = [
            f"{sensitivity.names[i]} {percent(float(first[i]))}"
            for i in sensitivity.order(k)[:6]
            if np.isfinite(first[i])
        ]
        rest = max(0.0, 1.0 - float(np.nansum(first)))
        parts.append(
            f"of the variance of {output}, {listed(top)} are due to that parameter alone and {percent(rest)} "
            f"to interactions of parameters"
        )
    return (
        f"Averaged over time, from {count(sensitivity.n_calls)} simulations of the FMU: {'. '.join(parts)}."
    )


def learning_caption(curves: LearningCurves, unit: str) -> str:
    """Say how a training went."""
    finite = curves.validation_mae[np.isfinite(curves.validation_mae)]
    if not finite.size:
        return "The training was never validated."
    ended = f" ({curves.stop_reason})" if curves.stop_reason else ""
    return (
        f"The validation MAE fell from {quantity(float(finite[0]), unit)} to "
        f"{quantity(float(finite.min()), unit)} at epoch {count(curves.best_epoch)}, "
        f"whose weights were kept; the training ended at epoch "
        f"{count(int(curves.epoch[-1]))}{ended}."
    )
