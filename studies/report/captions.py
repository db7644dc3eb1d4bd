"""What each picture says, in one sentence made of numbers from the data."""

from __future__ import annotations

import math

import numpy as np

from simulation.time_unit import DAYS, unit_for
from studies.report.data import ReportData
from studies.report.findings import (
    best_trials,
    calls_to_most,
    enclosed_fraction,
    good_rows,
    largest_by_chance,
    mean_over_time,
    ranking,
    residual_of,
    strongest_correlation,
)
from studies.report.guideline14 import guideline_sentence, judge
from studies.report.records import CalibrationRecord, MeasuredSeries, ParameterBox
from studies.report.records_model import CoverageSet, SensitivityRecord
from studies.report.records_tuning import LearningCurves, TrialsRecord
from studies.report.wording import (
    count,
    difference_unit,
    listed,
    percent,
    quantity,
    shown_unit,
    significant,
    squared,
)


def mse_unit(measurement: MeasuredSeries) -> str:
    """Return the unit of an MSE: the first output's, squared."""
    return squared(difference_unit(measurement.units[0]))


def headline_sentence(data: ReportData) -> str:
    """Say the result of the study in one sentence."""
    c = data.headline
    if c is None:
        return "Nothing has been calibrated yet."
    unit = mse_unit(data.measurement)
    relevance = f"{count(c.n_relevance)} to find and check what matters, " if c.n_relevance else ""
    if c.is_adaptive and not c.calls_paper:
        return (
            f"No model call was needed: the best of {count(c.n_known, 'stored simulation')} has an MSE of "
            f"{quantity(c.mse_polished, unit)}."
        )
    if c.is_adaptive:
        each = "the others each" if relevance else "each"
        before = (
            f"{count(c.n_known, 'stored simulation')} and those before it" if c.n_known else "those before it"
        )
        with_no = "" if c.n_known else ", with no training set"
        made = f"{each} where {before} let the lowest error be expected{with_no}"
    else:
        made = (
            f"{count(c.n_train)} for training, {count(c.n_screen_checks)} to check the screened point, "
            f"{count(c.n_polish)} to polish"
        )
    few = "" if c.n_free is None else f"the {count(c.n_free)} most relevant of "
    start = "" if c.n_known else " without an initial guess"
    start = start if c.n_free is None else " beside fixed values of the others"
    sentence = (
        f"{count(c.calls_paper, 'model call')} ({relevance}{made}) calibrated "
        f"{few}{count(len(data.parameters.names), 'parameter')}{start} to an MSE of "
        f"{quantity(c.mse_polished, unit)}"
    )
    known = [r for r in data.references if not r.is_target and r.mse > 0]
    if known:
        best = min(known, key=lambda r: r.mse)
        sentence += (
            f", {significant(c.mse_polished / best.mse)} times {quantity(best.mse, unit)} ({best.label})"
        )
    if c.is_adaptive:
        return f"{sentence}."
    return f"{sentence}; with the validation and test sets {count(c.calls_honest, 'simulation')} were run."


def calibration_title(measurement: MeasuredSeries, calibration: CalibrationRecord) -> str:
    """Say how well a calibration went."""
    unit = mse_unit(measurement)
    polished = quantity(calibration.mse_polished, unit)
    screened = quantity(calibration.mse_screened, unit)
    if not math.isfinite(calibration.mse_polished):
        return "No simulation of the model succeeded, neither as screened nor during the polish"
    if calibration.is_adaptive:
        return f"Calibrated, the model follows the measurement: MSE {polished}"
    if calibration.mse_polished < calibration.mse_screened:
        return f"Polished, the model follows the measurement: MSE {polished} (as screened: {screened})"
    return f"The polish kept the screened point: its MSE against the measurement is {screened}"


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


def polish_caption(calibration: CalibrationRecord, unit: str) -> str:
    """Say what the surrogate promised, what the model answered, and what the polish made of it."""
    c = calibration
    promise, answer = quantity(c.mse_surrogate, unit), quantity(c.mse_screened, unit)
    if not math.isfinite(c.mse_screened):
        said = (
            f"The surrogate promised {promise} at the screened point, where the model could not be simulated"
        )
    else:
        said = f"The surrogate promised {promise} at the screened point and the model answered {answer}"
    most = calls_to_most(c)
    if most is None:
        gained = f"{count(c.n_polish, 'polish call')} left it at {quantity(c.mse_polished, unit)}"
    else:
        gained = (
            f"{count(c.n_polish, 'polish call')} brought it to {quantity(c.mse_polished, unit)}, the first "
            f"{count(most)} of them nine tenths of the way (in the logarithm)"
        )
    ended = f"; it ended because {c.stop_reason}" if c.stop_reason else ""
    return f"{said}; {gained}{ended}."


def convergence_caption(calibration: CalibrationRecord, unit: str) -> str:
    """Say what an adaptive calibration's first design found, and what the calls after it made of it."""
    c = calibration
    n_start, start = int(c.history_calls[0]), float(c.history_mse[0])
    ended = f"; it ended because {c.stop_reason}" if c.stop_reason else ""
    found = f"found {quantity(start, unit)}" if math.isfinite(start) else "could not be simulated"
    before = f"The first design of {count(n_start, 'simulation')}"
    if c.n_free is not None:
        before = f"The first {count(n_start, 'simulation')}, the search for relevant parameters included,"
    if c.n_known:
        found = f"held {quantity(start, unit)}"
        before = f"The {count(c.n_known, 'stored simulation')} that it began with"
        if c.n_before:
            before = (
                f"After {count(c.n_before, 'call')} to find what matters, {before[0].lower()}{before[1:]}"
            )
    n_after = int(c.history_calls[-1]) - n_start
    if not n_after:
        return f"{before} {found}, and no model call was needed{ended}."
    end = quantity(c.mse_polished, unit)
    return f"{before} {found}; {count(n_after, 'call')} after it ended at {end}{ended}."


def overview_caption(calibrations: tuple[CalibrationRecord, ...], unit: str) -> str:
    """Say how the screening gap and the cost change with the size of the training set."""
    screened = [c for c in calibrations if not c.is_adaptive]
    comparable = [c for c in screened if c.n_free is None] or screened
    first, last = comparable[0], comparable[-1]
    cheapest = min(calibrations, key=lambda c: c.calls_paper)
    lowest = min(calibrations, key=lambda c: c.mse_polished)
    ends = (
        f"The cheapest calibration took {count(cheapest.calls_paper, 'call')} ({cheapest.shown_name}), "
        f"the lowest final MSE is {quantity(lowest.mse_polished, unit)} ({lowest.shown_name})."
    )
    if first is last:
        return f"The screening gap at {first.shown_name} is {quantity(first.screening_gap, unit)}. {ends}"
    return (
        f"The screening gap goes from {quantity(first.screening_gap, unit)} at {first.shown_name} to "
        f"{quantity(last.screening_gap, unit)} at {last.shown_name}. {ends}"
    )


def trials_caption(trials: TrialsRecord, unit: str) -> str:
    """Say how much tuning mattered, beside how much the number of simulations did."""
    states = [
        f"{count(trials.state.count(s))} {s}" for s in ("complete", "pruned", "failed") if s in trials.state
    ]
    sentence = f"Of {count(len(trials.state), 'trial')} {listed(states)}" if states else "No trial has ended"
    spreads = []
    for size in sorted({int(n) for n in trials.n_train}):
        errors = trials.test_mae[(trials.n_train == size) & np.isfinite(trials.test_mae)]
        if len(errors) > 1:
            spreads.append(
                (float(errors.max() / errors.min()), size, float(errors.min()), float(errors.max()))
            )
    if spreads:
        ratio, size, low, high = max(spreads)
        sentence += (
            f"; hyperparameters matter most at n = {size}, where the test MAE spans {significant(low, 2)} to "
            f"{quantity(high, unit, 2)}, a factor of {significant(ratio, 2)}"
        )
    best = best_trials(trials)
    if best.size:
        ratio = float(trials.test_p90[best[-1]] / trials.test_mae[best[-1]])
        if math.isfinite(ratio):
            size = int(trials.n_train[best[-1]])
            sentence += f"; the best one's 90th percentile at n = {size} is {ratio:.1f} times its MAE"
    return f"{sentence}."


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


def pairs_caption(parameters: ParameterBox, coverage: CoverageSet) -> str:
    """Say how evenly the parameters were sampled."""
    strongest = strongest_correlation(coverage)
    if strongest is None:
        return f"{count(len(coverage.theta), 'sample')} are too few to speak of correlations."
    value, i, j = strongest
    n, p = coverage.theta.shape
    n_pairs = p * (p - 1) // 2
    return (
        f"The largest correlation among the sampled parameters is {value:.2f} ({parameters.names[i]} with "
        f"{parameters.names[j]}); by chance, the largest of {count(n_pairs)} would be about "
        f"{largest_by_chance(n, n_pairs):.2f} in {count(n)} independent draws."
    )


def sensitivity_caption(sensitivity: SensitivityRecord) -> str:
    """Say which parameters matter, and how much lies in interactions."""
    parts = []
    for k, output in enumerate(sensitivity.output_names):
        order = ranking(sensitivity, k)
        first = mean_over_time(sensitivity.first_order[:, k])
        if not np.isfinite(first).any():
            parts.append(f"{output} does not vary, so its indices are undefined")
            continue
        top = [
            f"{sensitivity.names[i]} {percent(float(first[i]))}" for i in order[:6] if np.isfinite(first[i])
        ]
        rest = max(0.0, 1.0 - float(np.nansum(first)))
        parts.append(
            f"of the variance of {output}, {listed(top)} are due to that parameter alone and {percent(rest)} "
            f"to interactions of parameters"
        )
    by_whom = f" from {count(sensitivity.n_calls)} simulations" if sensitivity.n_calls else ""
    model = f" of {sensitivity.model}" if sensitivity.model else ""
    return f"Averaged over time{by_whom}{model}: {'. '.join(parts)}."


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
