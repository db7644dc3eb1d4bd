"""Pictures of calibrations and of how sure they are: outputs over time, MSE over model calls, intervals."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.measurement import Measurement
from simulation.parameters import ParameterSpace
from studies.reporting.drawing import (
    BETWEEN_BOUNDS,
    HOLLOW,
    INK,
    LOG,
    MEASURED,
    POLISHED,
    SCREENED,
    SERIES,
    SIMULATED,
    TRAINING,
    Axis,
    Figure,
    Panel,
    Series,
    reference_lines,
    shortened,
    time_axis,
    with_gaps,
)
from studies.results.planned import Planned
from studies.results.profiled import Profiles
from studies.results.stage_results import Calibration, Prediction, Uncertainty
from studies.words.wording import (
    axis_label,
    count,
    difference_unit,
    ended,
    percent,
    quantity,
    shown_unit,
    square_of,
)

MOST_BAND = 3.0
"""The axis of a residual reaches the end of the sensor's band where that is at most so many times as far."""


N_BINS = 40


def output_axis(case: Case, output: int) -> Axis:
    """Return the vertical axis of an output in its unit."""
    one = case.outputs[output]
    return Axis(axis_label(shortened(one.name), shortened(shown_unit(one.unit))))


def calibration_figure(case: Case, found: Calibration) -> Figure:
    """Show measured, screened and final outputs over time, and the residual of the final below.

    Args:
        case: What it is compared with.
        found: The calibration to show.
    """
    mse = quantity(found.mse, square_of(case.outputs[0].unit))
    title = f"Measured and {found.final}: {found.error_name} {mse}"
    return _outputs_over_time(title, case, found.final, found.y, found.y_screened)


def validation_figure(case: Case, found: Calibration) -> Figure | None:
    """Show the same on the validation period; None without one."""
    period, validated, y = case.validation, found.validation, found.validation_y
    if period is None or validated is None or y is None:
        return None
    mse = validated.final.mse
    said = "failed" if mse is None else f"{found.error_name} {quantity(mse, square_of(case.outputs[0].unit))}"
    title = f"The part that was not calibrated: {said}"
    shown = replace(period, measurement=period.measurement.from_first_sample)
    return _outputs_over_time(title, shown, found.final, y, found.validation_y_screened)


def _outputs_over_time(
    title: str, case: Case, final: str, y: FloatArray, y_screened: FloatArray | None
) -> Figure:
    lines = [] if y_screened is None else [("screened", SCREENED, y_screened)]
    lines.append((final, POLISHED, y))
    panels = []
    for k in range(len(case.outputs)):
        name, y_axis, measurement = case.outputs[k].name, output_axis(case, k), case.measurement
        shown = _output(name, y_axis, measurement.time, k, measurement=measurement, lines=lines, height=220)
        panels += [shown, _residuals(case, k, y)]
    return Figure(title, tuple(panels))


def _output(
    name: str,
    y: Axis,
    time: FloatArray,
    k: int,
    *,
    bands: tuple[FloatArray | None, FloatArray | None] = (None, None),
    measurement: Measurement | None = None,
    lines: Sequence[tuple[str, str, FloatArray]] = (),
    size: int = 14,
    height: int = 200,
) -> Panel:
    """Return the panel of an output over time.

    Args:
        name: Name of the output.
        y: Its axis.
        time: Times of bands and lines. Shape (t,). [s]
        k: Its place in bands, lines and measurement.
        bands: Measured values to be expected, and simulations of equally good parameter sets; None without
            such. Shape (2, t, k). [per output]
        measurement: What was measured, and limits; None for nothing.
        lines: Name, color and values. Shape (t, k). [per output]
        size: Of a point.
        height: Of the panel.
    """
    axis, unit = time_axis(time)
    at = unit.of_seconds(time)
    series = [
        Series(what, color, at, low=band[0, :, k], high=band[1, :, k])
        for what, color, band in zip(("with noise", "simulated"), (TRAINING, SIMULATED), bands, strict=True)
        if band is not None
    ]
    if measurement is not None:
        series += limit_lines(measurement, k)
        if measurement.outputs[k].is_measured:
            samples, dots = measurement.outputs[k].samples, {"filled": True, "size": size}
            when = unit.of_seconds(samples.time)
            beside = next((one[:, k] for _, _, one in lines), np.zeros(len(time)))
            if not lines and bands[1] is not None:
                beside = bands[1][:, :, k].mean(axis=0)
            series.append(Series("measured", MEASURED, when, samples.beside(time, beside), "point", dots))
    series += [Series(name, color, at, values[:, k]) for name, color, values in lines]
    return Panel(name, axis, y, series, height)


def limit_lines(measurement: Measurement, output: int) -> list[Series]:
    """Return the limits of an output as lines from left to right; none where it has none.

    Args:
        measurement: What simulations are compared with.
        output: Position of the output.
    """
    limits = measurement.outputs[output].limits
    ends = {} if limits is None else {"at least": limits.at_least, "at most": limits.at_most}
    return [Series(name, SCREENED, y=[end], mark="rule") for name, end in ends.items() if math.isfinite(end)]


def residual_reach(largest: float, uncertainty: float) -> float:
    """Return how far the axis of a residual reaches: a band much wider than it would make a line of it.

    Args:
        largest: The largest residual in size. [unit]
        uncertainty: The sensor's, infinite or NaN where it is not known. [unit]

    Returns:
        Above 0. [unit]
    """
    band = 1.25 * uncertainty if math.isfinite(uncertainty) else 0.0
    return max(1.12 * largest, band if not largest or band <= MOST_BAND * largest else 0.0) or 1.0


def _residuals(case: Case, k: int, y: FloatArray) -> Panel:
    axis, time_unit = time_axis(case.measurement.time)
    unit = shortened(difference_unit(case.outputs[k].unit), 10)
    residual: FloatArray = case.measurement.differences(y[None], k)[0]
    uncertainty = case.outputs[k].uncertainty
    largest = float(np.nanmax(np.abs(residual))) if np.isfinite(residual).any() else 0.0
    reach = residual_reach(largest, uncertainty)
    time, values = with_gaps(time_unit.of_seconds(case.outputs[k].samples.time), residual)
    series = [
        Series("zero", INK, y=[0.0], mark="rule", is_named=False),
        Series("residual", POLISHED, time, values, style={"strokeWidth": 1.3}, is_named=False),
    ]
    own = case.outputs[k].samples.deviations
    if own is not None:
        _, band = with_gaps(time_unit.of_seconds(case.outputs[k].samples.time), own)
        series.insert(0, Series("uncertainty of each sample", TRAINING, time, low=-band, high=band))
    elif math.isfinite(uncertainty) and uncertainty > 0:
        sensor = f"sensor ±{uncertainty:g} {unit}"
        series.insert(0, Series(sensor, TRAINING, low=[-uncertainty], high=[uncertainty], mark="rect"))
    scale = {"domain": [-reach, reach], "nice": False}
    name = f"residual of {case.outputs[k].name}"
    return Panel(name, axis, Axis(axis_label("residual", unit), scale), series, 120)


def calls_figure(case: Case, found: Calibration) -> Figure:
    """Show the best MSE over counted model calls, those before the search shaded, and known MSEs as lines.

    Those before are the training set, of an adaptive one its first rows.

    Args:
        case: The case.
        found: The calibration to show.
    """
    unit, final, name = square_of(case.outputs[0].unit), found.mse, found.error_name
    calls, best = found.history_calls, found.history_mse
    n_before, what = found.n_train, "training set"
    if found.is_adaptive:
        n_before, what = int(calls[0]), "stored rows" if found.n_warm_start else "first rows"
    last = max(found.n_calls_paper, int(calls.max(initial=0)), n_before + 1)
    first = 0.0 if found.is_adaptive else max(0.0, n_before - 0.6 * (last - n_before))
    before = f"{'← ' if first > 0 else ''}{what} ({count(n_before, 'call')})"
    series = [
        Series(before, TRAINING, [first], x_end=[n_before], mark="rect"),
        *reference_lines(case.references),
        Series(
            f"{quantity(final, unit)} {found.final}", POLISHED, np.append(calls, last),
            np.append(best, np.fmin.reduce(best, initial=final)), style={"interpolate": "step-after"},
        ),
    ]  # fmt: skip
    x = Axis("model calls", {"domain": [first, last + 0.01 * (last - first)], "nice": False})
    panel = Panel(name, x, Axis(axis_label(f"best {name}", unit), LOG), series, 260)
    total = count(found.n_calls_paper, "model call")
    title = f"Best {name} over model calls: {quantity(final, unit)} after {total}"
    return Figure(title, (panel,), caption=f"{ended(found.stop_reason, converged=found.converged)}.")


def band_figure(case: Case, found: Uncertainty) -> Figure:
    """Show the bands of a posterior sample over the measurement.

    Args:
        case: What was calibrated, against what.
        found: The uncertainty.
    """
    bands, at = (found.predictive, found.simulated), case.measurement.time
    panels = [
        _output(output.name, output_axis(case, k), at, k, bands=bands, measurement=case.measurement, size=10)
        for k, output in enumerate(case.outputs)
    ]
    caption = "Dark: the simulations of equally good parameter sets. Light: measured values to be expected."
    return Figure(f"{percent(found.level)} bands of the outputs", tuple(panels), caption=caption)


def prediction_figure(found: Prediction, measurement: Measurement | None = None) -> Figure:
    """Show each output of a calibrated model with other inputs over time, with its bands.

    Args:
        found: The prediction.
        measurement: What was measured meanwhile; None for nothing.
    """
    shown, lines = (found.predictive, found.simulated), [("calibrated", POLISHED, found.y)]
    panels = [
        _output(
            name, Axis(axis_label(name, shown_unit(unit))), found.time, k, bands=shown,
            measurement=measurement, lines=lines,
        )
        for k, (name, unit) in enumerate(zip(found.output_names, found.output_units, strict=True))
    ]  # fmt: skip
    bands = "" if found.level is None else f", with {percent(found.level)} bands"
    driven = "other inputs" if measurement is None else "its recorded inputs"
    return Figure(f"The calibrated model with {driven}{bands}", tuple(panels))


def interval_figure(box: ParameterSpace, found: Uncertainty) -> Figure:
    """Show density and interval of every parameter between its bounds.

    Args:
        box: The parameters.
        found: The uncertainty.
    """
    names = list(found.parameters)
    linear_low, linear_high = box.to_unit(found.linear)
    point, dot = box.to_unit(found.point), {"filled": True, "size": 30}
    caption = "The linearised interval and the calibrated value; too few calls to say more."
    series = [
        Series("linearised", SCREENED, linear_low, names, "rule", {"yOffset": 5}, x_end=linear_high),
        Series("calibrated", INK, point, names, "point", dot),
    ]
    if found.sample.is_trusted:
        low, high = box.to_unit(found.interval)
        what, thick = f"{percent(found.level)} interval", {"strokeWidth": 4}
        interval = Series(what, POLISHED, low, names, "rule", thick, x_end=high)
        series = [_density(box, found.particles_theta, names), interval, *series]
        caption = "Density and interval of the posterior, linearised interval, and calibrated value."
    x = Axis("from the lower to the upper bound [1]", BETWEEN_BOUNDS)
    panel = Panel("parameters", x, Axis("", is_of_names=True), series, 26 * len(names))
    return Figure("Intervals of the parameters between their bounds", (panel,), caption=caption)


def planned_figure(found: Planned) -> Figure:
    """Show half widths of every parameter now and after each of the best candidates.

    Args:
        found: The candidates.
    """
    names, dot = list(found.half_widths), {"filled": True, "size": 40, "opacity": 1}
    series = [Series("now", INK, list(found.half_widths.values()), names, "point", dot)]
    for color, one in zip(SERIES, (one for one in found.candidates if not one.excluded), strict=False):
        widths = [one.half_widths[name] for name in names]
        series.append(Series(shortened(one.name), color, widths, names, "point", HOLLOW))
    x = Axis("half of the 90 % interval, as a share of the range [1]", {"type": "log"})
    panel = Panel("half widths", x, Axis("", is_of_names=True), series, 22 * len(names))
    caption = "Expected by the linearised model; to the left is better."
    return Figure("What the next experiment would show", (panel,), caption=caption)


def profile_figure(found: Profiles) -> Figure:
    """Show what -2 log L rises by along the profile of every parameter, and the limit of the intervals.

    Args:
        found: The profiles.
    """
    panels, highest = [], 2.0 * found.limit
    for name, at, rises in zip(found.parameters, found.at, found.rises, strict=True):
        at, rises = at[np.isfinite(at)], np.minimum(rises[np.isfinite(at)], highest)
        # A label of its own: panels of one label zoom together.
        x = Axis(f"{shortened(name)} between its bounds [1]", {"domain": [at[0], at[-1]], "nice": False})
        limit = Series("limit of the interval", SCREENED, at[[0, -1]], [found.limit] * 2)
        line = Series("profile", POLISHED, at, rises, style={"point": True})
        y = Axis("rise of −2 log L [1]", {"domain": [0.0, highest]})
        panels.append(Panel(shortened(name), x, y, [limit, line], 120, has_legend=False))
    caption = "Others at their best; points above the picture lie at its edge. Blue below orange: within."
    return Figure("Profile likelihoods", tuple(panels), columns=2, shows_names=True, caption=caption)


def _density(box: ParameterSpace, particles: FloatArray, names: list[str]) -> Series:
    """Return how the sample of each parameter is spread, as rectangles that are darker where it is denser."""
    u, edges = box.to_unit(particles), np.linspace(0.0, 1.0, N_BINS + 1)
    counts = np.stack([np.histogram(column, edges)[0] for column in u.T])
    shares = 0.9 * counts / np.maximum(counts.max(axis=1, keepdims=True), 1)
    p = len(names)
    return Series(
        "density", SIMULATED, np.tile(edges[:-1], p), np.repeat(names, N_BINS), "rect", {},
        x_end=np.tile(edges[1:], p), share=shares.ravel(),
    )  # fmt: skip
