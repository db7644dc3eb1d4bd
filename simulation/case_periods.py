"""The periods of a case: what is simulated, from when on it is reported, and which part is compared."""

import math
from dataclasses import dataclass, replace

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.case_data import FROM_FIRST_ROW, CaseData
from simulation.case_file import CaseFile, OutputTable
from simulation.errors import InputError, errors_at
from simulation.limits import Limits
from simulation.measurement import MeasuredOutput, Measurement
from simulation.recording import Recording
from simulation.samples import MOMENT, Samples
from simulation.time_unit import DAY_S, TimeUnit

MOST_STEPS = 10_000_000
"""Communication steps of a simulation; more of them do not fit into memory."""


@dataclass(frozen=True)
class Period:
    """Which days are simulated, reported and compared.

    Attributes:
        said: How messages name it: with its key, or with the days where the caller named them.
        start_d: Start of the simulation. [d]
        reported_d: Part whose outputs are reported; before it lies the warm-up. [d]
        compared_d: Part that is compared with the measurement, at the end of the reported one. [d]
        seen_d: Its begin or end where that belongs to another period, whose sample is left out. [d]
    """

    said: str
    start_d: float
    reported_d: tuple[float, float]
    compared_d: tuple[float, float]
    seen_d: float | None = None


def plain_period(file: CaseFile, chosen_d: tuple[float, float] | None) -> Period:
    """Return the period that is calibrated.

    Args:
        file: The case file's content.
        chosen_d: The caller's window, None for the file's. [d]

    Raises:
        InputError: If window and start contradict each other, or there are too many steps.
    """
    unit = file.time.unit
    window = begin_d, end_d = _rising("window", chosen_d or file.time.window, unit)
    start_d = begin_d if file.time.start is None else file.time.start
    if not 0.0 <= start_d <= begin_d:
        raise InputError(
            f"time.start_{unit.symbol} = {unit.of_days(start_d):g} does not lie between "
            f"{unit.moment(0.0)} and the window's start, {unit.of_days(begin_d):g}; correct it"
        )
    _check_n_steps(file, start_d, end_d)
    said = _as_key("window", window, unit) if chosen_d is None else unit.period(window)
    return Period(said, start_d, window, window)


def validation_period(file: CaseFile, plain: Period, *, may_be_left_out: bool) -> Period | None:
    """Return the period on which calibrated parameters are validated, None without one.

    Its simulations start where those of the window do, because that is where initial states belong.

    Args:
        file: The case file's content.
        plain: The period that is calibrated.
        may_be_left_out: Whether one that does not go with it is left out, as where the caller chose that.

    Raises:
        InputError: If it overlaps with the window, begins before the simulation, or has too many steps.
    """
    if file.time.validation is None:
        return None
    unit, window_d, start_d = file.time.unit, plain.compared_d, plain.start_d
    period = begin_d, end_d = _rising("time.validation", file.time.validation, unit)
    said, wrong = _as_key("time.validation", period, unit), ""
    if begin_d < window_d[1] and window_d[0] < end_d:
        wrong = f"overlaps with {_as_key('window', window_d, unit)}; choose a part that was not seen"
    elif begin_d < start_d:
        wrong = (
            f"begins before the simulation, {unit.moment(start_d)}; choose a later part or an earlier "
            f"start_{unit.symbol}"
        )
    if wrong and may_be_left_out:
        return None
    if wrong:
        raise InputError(f"{said} {wrong}")
    _check_n_steps(file, start_d, end_d)
    seen_d = next((day for day in period if day in window_d), None)
    return Period(said, start_d, (min(window_d[0], begin_d), end_d), period, seen_d)


def time_grid(file: CaseFile, data: CaseData, period: Period) -> tuple[FloatArray, int, int]:
    """Lay out the communication steps from the start of the simulation to the end of a period.

    Args:
        file: The case file's content.
        data: The recordings.
        period: The period.

    Returns:
        Edges of the steps [s], steps between two outputs, number of outputs before the reported part.

    Raises:
        InputError: If the steps do not fit into it, or the recordings end before.
    """
    (begin_d, end_d), start_d, unit = period.reported_d, period.start_d, file.time.unit
    step, output_step = file.time.communication_step_s, file.time.output_step_s
    if not step > 0:
        raise InputError(f"communication_step_s = {step:g} is not above 0; correct it")
    output_every = round(output_step / step)
    if output_every < 1 or not math.isclose(output_every * step, output_step, rel_tol=1e-9):
        raise InputError(
            f"time.output_step_s = {output_step:g} is no multiple of "
            f"communication_step_s = {step:g}; choose steps that fit"
        )
    n_reported = _whole_steps(end_d - begin_d, output_step, period.said)
    start_said = f"time.start_{unit.symbol} = {unit.of_days(start_d):g}"
    n_warmup = _whole_steps(begin_d - start_d, output_step, start_said)
    # The interval of a mean may go on beyond its stamp.
    ends_s, longest = max(
        (
            (float(data.recordings[table.file].time[-1]) + table.interval[1], data.recordings[table.file])
            for table in file.outputs
            if table.file is not None
        ),
        key=lambda one: one[0],
    )
    length_d = ends_s / DAY_S
    # Where samples are not taken evenly, the last of a period comes a little before its end.
    slack_d = 0.0 if longest.is_even else longest.step_s / DAY_S
    if end_d > length_d + slack_d + 1e-9:
        raise InputError(
            f"{period.said}: the recording {longest.path} ends at {unit.moment(length_d)}; shorten the window"
        )
    _check_begin_in_time(file, data, period)
    start = start_d * DAY_S
    n_steps = (n_warmup + n_reported) * output_every
    return start + step * np.arange(n_steps + 1, dtype=np.float64), output_every, n_warmup


def _check_begin_in_time(file: CaseFile, data: CaseData, period: Period) -> None:
    """Check that what is measured begins within a period: Unix seconds do not."""
    for name in dict.fromkeys(table.file for table in file.outputs if table.file is not None):
        recording = data.recordings[name]
        first_d = float(recording.time[0]) / DAY_S
        if data.counts_seconds and first_d > period.reported_d[1]:
            raise InputError(
                f"{period.said} ends before {recording.path} begins, at {file.time.unit.moment(first_d)}; "
                f"choose a later window, or: {FROM_FIRST_ROW}"
            )


def measured(file: CaseFile, data: CaseData, time: FloatArray, period: Period) -> Measurement:
    """Return what was measured in the compared part of a period.

    Args:
        file: The case file's content.
        data: The recordings.
        time: Reported output times. Shape (t,). [s]
        period: The period.

    Raises:
        InputError: If an output has less than two samples, one outside its own band, or none that it can
            be normalized with.
    """
    begin_s = float(time[0]) + (period.compared_d[0] - period.reported_d[0]) * DAY_S
    seen_s = math.nan if period.seen_d is None else begin_s + (period.seen_d - period.compared_d[0]) * DAY_S
    outputs = []
    for table in file.outputs:
        with errors_at(f"outputs[{table.name}]"):
            its = _limits(table, time[time >= begin_s - 1e-6 * file.time.output_step_s])
            if table.source is None:
                assert its is not None, "an output has a measurement or limits"
                one = its.samples
            else:
                recording, column = data.recordings[table.source[0]], table.source[1]
                said = file.time.unit.period(period.compared_d)
                if table.on_change:
                    recording = _at_times(recording, column, time[time >= begin_s - 1e-6], table)
                one = _samples(recording, column, (begin_s, float(time[-1])), seen_s, said, table)
                low, high = table.accepted or (-math.inf, math.inf)
                for row in np.flatnonzero((one.values < low) | (one.values > high))[:1]:
                    raise InputError(
                        f"accepted = [{low:g}, {high:g}] leaves out the measured {one.values[row]:g} at "
                        f"{one.time[row]:.12g} s; widen it, or empty that cell"
                    )
            uncertainty = one.usual_deviation or table.uncertainty
            assert uncertainty is not None, "the table says one of them"
            outputs.append(
                MeasuredOutput(
                    table.name,
                    table.unit,
                    one,
                    uncertainty,
                    _weight(table, one),
                    error_lasts_s=table.error_lasts_s or 0.0,
                    loss=table.robust_loss(uncertainty),
                    correlation_s=table.correlation_time_s or 0.0,
                    limits=its,
                )
            )
    return Measurement(time, tuple(outputs))


def _limits(table: OutputTable, time: FloatArray) -> Limits | None:
    """Return the limits of an output over the compared output times (t,) [s], None for none."""
    if not table.has_limits:
        return None
    low = -math.inf if table.at_least is None else table.at_least
    high = math.inf if table.at_most is None else table.at_most
    return Limits(time, low, high, is_alone=table.source is None)


def _weight(table: OutputTable, samples: Samples) -> float:
    """Return the weight of an output: differences are divided by the uncertainty, and normalized instead."""
    if table.normalize is None or table.uncertainty is None:
        return table.weight
    if table.normalize == "range":
        size = float(np.ptp(samples.values))
    elif table.normalize == "mean":
        size = abs(float(np.mean(samples.values)))
        if table.unit in ("K", "degC", "°C", "degF", "°F"):
            raise InputError('normalize = "mean": the zero of a temperature is a convention; write "range"')
    else:
        size = float(table.normalize)
    if not size > 0.0:
        raise InputError(f'normalize = "{table.normalize}": that of the measured values is 0; write a number')
    return table.weight * (table.uncertainty / size) ** 2


def _samples(
    recording: Recording,
    column: str,
    period_s: tuple[float, float],
    seen_s: float,
    said: str,
    table: OutputTable,
) -> Samples:
    """Return what was measured in a period [s], but for a moment seen already [s]; gaps have no sample.

    A mean is of the period in which the whole of its interval lies, relative to its time [s].
    """
    values, slack, interval = recording.columns[column], 1e-6 * recording.step_s, table.interval
    begin_s, end_s = period_s[0] - interval[0], period_s[1] - interval[1]
    inside = (recording.time >= begin_s - slack) & (recording.time <= end_s + slack) & ~np.isnan(values)
    if interval == MOMENT:
        inside &= ~(np.abs(recording.time - seen_s) <= slack)
    # The first value of a counter is where it begins to count.
    since = int(np.argmax(inside)) if table.starts_at is not None and inside.any() else None
    if since is not None:
        inside[since], values = False, values - values[since]
    n_samples = np.count_nonzero(inside)
    if n_samples < 2:
        values_of = f"{n_samples} {'value' if n_samples else 'values'} of {column}"
        means = "" if interval == MOMENT else f" (each a mean over {interval[1] - interval[0]:g} s)"
        means += " beside the first" * (since is not None)
        raise InputError(
            f"{recording.path} has {values_of}{means} over {said}, 2 are needed; choose another window, or "
            "correct the file"
        )
    # A sample that a rounding puts outside belongs to the first or last output time.
    named = f"{recording.time_column} = " if recording.clock == "seconds" else ""
    stamps = tuple(f"{named}{recording.stamps[row]}" for row in np.flatnonzero(inside) if recording.stamps)
    return Samples(
        np.clip(recording.time[inside], begin_s, end_s),
        values[inside],
        interval,
        stamps,
        _deviations(recording, values, inside, table),
        None if since is None else float(np.clip(recording.time[since], begin_s, end_s)),
    )


def _at_times(recording: Recording, column: str, time: FloatArray, table: OutputTable) -> Recording:
    """Return what values that are recorded when they change are at other times (t,), NaN before the first."""
    known = np.flatnonzero(~np.isnan(recording.columns[column]))
    if not len(known):
        return recording
    at = np.searchsorted(recording.time[known], time + 1e-6, side="right") - 1
    columns = {
        name: np.where(at < 0, np.nan, recording.columns[name][known[np.maximum(at, 0)]])
        for name in filter(None, (column, table.uncertainty_column))
    }
    return replace(recording, time=time, columns=columns, stamps=())


def _deviations(
    recording: Recording, values: FloatArray, inside: BoolArray, table: OutputTable
) -> FloatArray | None:
    """Return the standard uncertainty of each sample, None where all have that of the sensor. Shape (m,).

    Args:
        recording: Where they were measured.
        values: All values of the recording. Shape (r,).
        inside: Which of them are samples, m in all. Shape (r,).
        table: The output.

    Raises:
        InputError: If one is missing or not above 0.
    """
    if table.uncertainty_share is not None:
        return np.hypot(table.uncertainty or 0.0, table.uncertainty_share * values[inside])
    if table.uncertainty_column is None:
        return None
    found = recording.columns[table.uncertainty_column]
    for row in np.flatnonzero(inside & ~(found > 0.0))[:1]:
        said = "is empty" if np.isnan(found[row]) else f"is {found[row]:g}"
        raise InputError(
            f"{recording.path}: line {row + recording.first_line}: {table.uncertainty_column} {said} beside "
            "a measured value; give an uncertainty above 0, or empty both cells"
        )
    return found[inside]


def _as_key(key: str, days: tuple[float, float], unit: TimeUnit) -> str:
    """Write a period as the case file does."""
    return f"{key}_{unit.symbol} = [{unit.of_days(days[0]):g}, {unit.of_days(days[1]):g}]"


def _rising(key: str, days: tuple[float, float], unit: TimeUnit) -> tuple[float, float]:
    begin_d, end_d = float(days[0]), float(days[1])
    if not (math.isfinite(begin_d) and math.isfinite(end_d) and 0.0 <= begin_d < end_d):
        raise InputError(
            f"{_as_key(key, days, unit)}: the end must lie after the start and neither before "
            f"{unit.moment(0.0)}; correct it"
        )
    return begin_d, end_d


def _check_n_steps(file: CaseFile, start_d: float, end_d: float) -> None:
    """Check that the steps of a simulation [d] fit into memory."""
    span_s, step, unit = (end_d - start_d) * DAY_S, file.time.communication_step_s, file.time.unit
    if span_s / step > MOST_STEPS:
        raise InputError(
            f"time.communication_step_s = {step:g} makes {span_s / step:.3g} steps from "
            f"{unit.moment(start_d)} to {unit.moment(end_d)}, and {MOST_STEPS:g} is the most; "
            f"write at least {1.01 * span_s / MOST_STEPS:.3g}, or shorten the simulation"
        )


def _whole_steps(span_d: float, output_step: float, said: str) -> int:
    """Return how many output steps [s] a span [d] holds."""
    n_steps = round(span_d * DAY_S / output_step)
    if not math.isclose(n_steps * output_step, span_d * DAY_S, rel_tol=1e-9):
        raise InputError(
            f"{said}: not a whole number of output steps of {output_step:g} s; choose times that fit"
        )
    return n_steps
