"""Pictures of model and surrogates: coverage (Fig. 4), Sobol indices (Fig. 5), errors of trials (Fig. 6)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.case import Case
from simulation.measurement import Measurement
from studies.calibration.sobol import SobolIndices
from studies.reporting.drawing import (
    BEST_SURROGATE,
    INK,
    LOG,
    LOG2,
    MUTED,
    SERIES,
    SIMULATED,
    SURROGATE,
    TRAINING,
    Axis,
    Figure,
    Panel,
    Series,
    shortened,
    time_axis,
    with_gaps,
)
from studies.reporting.figures_calibration import limit_lines, output_axis
from studies.reporting.tables import asked_of
from studies.words.wording import axis_label, count, percent, significant


def coverage_figure(case: Case, y: FloatArray) -> Figure:
    """Show where the trajectories of the training set lie, with the measurement over them (Fig. 4).

    The caption says whether they could have produced the measurement.

    Args:
        case: What is to be covered.
        y: The trajectories; failed rows, which are NaN, are left out. Shape (n, t, k). [per output]
    """
    good, measurement = y[np.isfinite(y).all(axis=(1, 2))], case.measurement
    axis, unit = time_axis(measurement.time)
    time, panels = unit.of_seconds(measurement.time), []
    for k, one in enumerate(measurement.outputs):
        series = limit_lines(measurement, k)
        if one.is_measured:
            beside = np.median(good[:, :, k], axis=0) if len(good) else np.zeros(len(measurement.time))
            values = one.samples.beside(measurement.time, beside)
            at, values = with_gaps(unit.of_seconds(one.samples.time), values)
            series.append(Series("measured", INK, at, values))
        if len(good):
            low, quarter, three_quarters, high = np.quantile(good[:, :, k], [0.0, 0.25, 0.75, 1.0], axis=0)
            series = [
                Series("lowest to highest", TRAINING, time, low=low, high=high),
                Series("half of the simulations", SIMULATED, time, low=quarter, high=three_quarters),
                *series,
            ]
        panels.append(Panel(one.name, axis, output_axis(case, k), series, 240))
    title = f"The measurement and {count(len(good), 'simulation')} of the training set"
    share, n_failed = percent(enclosed_fraction(measurement, good)), len(y) - len(good)
    caption = f"{share} of the measured values lie between the lowest and the highest simulated one."
    if n_failed:
        caption += f" {count(n_failed, 'simulation')} failed."
    return Figure(title, tuple(panels), caption=caption)


def enclosed_fraction(measurement: Measurement, y: FloatArray) -> float:
    """Return the fraction of measured values between the lowest and the highest simulated at their time. [1].

    Args:
        measurement: What was measured.
        y: Trajectories without failed ones. Shape (n, t, k). [units]
    """
    if not len(y):
        return math.nan
    differences = [measurement.differences(y, k) for k in measurement.measured]
    inside = [(above.min(axis=0) <= 0.0) & (above.max(axis=0) >= 0.0) for above in differences]
    return float(np.mean(np.concatenate(inside)))


def sensitivity_figure(found: SobolIndices) -> Figure:
    """Show the largest first- and total-order indices of every output over time, with their intervals.

    Args:
        found: Sobol indices per time step.
    """
    axis, unit = time_axis(found.time)
    time, panels = unit.of_seconds(found.time), []
    for k, output in enumerate(found.output_names):
        for kind, all_values, all_halves in (
            ("First order", found.first_order, found.first_order_ci),
            ("Total order", found.total_order, found.total_order_ci),
        ):
            series = []
            # The largest, as many as there are colors; the table has all.
            for color, i in zip(SERIES, found.order(k), strict=False):
                value, half = all_values[:, k, i], all_halves[:, k, i]
                low, high = value - half, value + half
                series.append(Series(shortened(found.names[i]), color, time, value, low=low, high=high))
            n_undefined = int(np.sum(~np.isfinite(all_values[:, k]).all(axis=1)))
            undefined = f"; undefined at {count(n_undefined, 'time step')}" if n_undefined else ""
            name = f"{kind}, {shortened(output)}{undefined}"
            panels.append(Panel(name, axis, Axis("share of the variance [1]"), series))
    caption = (
        f"From {asked_of(found)}; the {len(SERIES)} largest are shown. "
        "What the first orders miss to 1 are interactions."
    )
    return Figure("Sobol indices over time", tuple(panels), shows_names=True, caption=caption)


TrialRow = tuple[int, str, float | None, float | None, float | None, bool]


@dataclass(frozen=True)
class TrialsRecord:
    """Every trial of every study, one entry per trial; NaN where an error is unknown.

    Attributes:
        n_train: Training-set size of the trial's study. Shape (m,).
        state: "complete", "pruned", "failed" or "running" per trial, m entries.
        validation_mae: For a pruned trial the last one reported. Shape (m,). [output unit, differences]
        test_mae: Shape (m,). [output unit, differences]
        test_p90: Shape (m,). [output unit, differences]
        is_best: True for the trial chosen by validation error, at most one per size. Shape (m,).
    """

    n_train: IntArray
    state: tuple[str, ...]
    validation_mae: FloatArray
    test_mae: FloatArray
    test_p90: FloatArray
    is_best: BoolArray

    @classmethod
    def of(cls, trials: Sequence[TrialRow]) -> "TrialsRecord":
        """Collect trials: size, state, validation MAE, test MAE, test P90, and whether it is best."""
        sizes, states, *errors, best = zip(*trials, strict=True)
        validation, mae, p90 = np.array(errors, dtype=np.float64)  # NaN for None
        return cls(np.array(sizes), states, validation, mae, p90, np.array(best))


def mae_over_n_figure(
    trials: TrialsRecord,
    *,
    unit: str,
    beside: Mapping[str, Mapping[int, tuple[float, float]]] = MappingProxyType({}),
    published: Mapping[int, tuple[float, ...]] = MappingProxyType({}),
) -> Figure:
    """Show every trial's test error over the training-set size, mean beside 90th percentile (Fig. 6).

    Args:
        trials: All trials; pruned ones are shown at their last validation error, failed ones counted.
        unit: Unit of the errors, e.g. "K".
        beside: At most two other surrogates, drawn as lines: by name and rising training-set size the MAE
            and the 90th percentile. [unit]
        published: MAE that the paper names, by training-set size: one value, or least and largest. [unit]
    """
    x, panels = Axis("training simulations", LOG2, ticks=tuple(np.unique(trials.n_train).tolist())), []
    for name, values, is_mae in (
        ("Mean absolute error", trials.test_mae, True),
        ("90th percentile over parameter sets", trials.test_p90, False),
    ):
        series = _trials(trials, values, is_mae=is_mae)
        for line, color, dashes in zip(beside, (SERIES[2], SERIES[4]), ([1, 0], [4, 2]), strict=False):
            errors = [mae if is_mae else p90 for mae, p90 in beside[line].values()]
            series.append(Series(line, color, [*beside[line]], errors, style={"strokeDash": dashes}))
        if is_mae and published:
            sizes = [n for n, errors_there in published.items() for _ in errors_there]
            found = [error for errors_there in published.values() for error in errors_there]
            diamonds = {"shape": "diamond", "size": 60, "filled": False, "strokeWidth": 1.5}
            series.append(Series("the paper", INK, sizes, found, "point", diamonds))
        label = axis_label("error on the test set" if is_mae else "", unit)
        panels.append(Panel(name, x, Axis(label, LOG), series, 280, has_legend=is_mae))
    title = "Error of every trial over the number of training simulations"
    caption = "The curves of each training are in MLflow: studies ui."
    return Figure(title, tuple(panels), columns=2, shows_names=True, caption=caption)


def _trials(trials: TrialsRecord, values: FloatArray, *, is_mae: bool) -> list[Series]:
    x, state = _beside_each_other(trials), np.array(trials.state, dtype=object)
    complete = (state == "complete") & np.isfinite(values)
    pruned = (state == "pruned") & np.isfinite(trials.validation_mae)
    n_failed = trials.state.count("failed")
    best = np.flatnonzero(trials.is_best & np.isfinite(trials.test_mae))
    best = best[np.argsort(trials.n_train[best], kind="stable")]
    name = count(complete.sum(), "complete trial") + (f" ({count(n_failed)} failed)" if n_failed else "")
    series = [
        Series(name, SURROGATE, x[complete], values[complete], "point", {"filled": True, "opacity": 0.6})
    ]
    if is_mae and pruned.any():
        name, hollow = f"{count(pruned.sum())} pruned, at the last validation", {"filled": False}
        series.append(Series(name, MUTED, x[pruned], trials.validation_mae[pruned], "point", hollow))
    labels = [significant(float(value), 2) for value in values[best]]
    star = {"point": {"shape": "diamond", "size": 70, "filled": True}, "strokeWidth": 1.2}
    n_train = trials.n_train[best]
    return [
        *series,
        Series("best by validation", BEST_SURROGATE, n_train, values[best], style=star, text=labels),
    ]


def _beside_each_other(trials: TrialsRecord) -> FloatArray:
    """Spread trials of one size over a tenth of an octave each way, in their order. Shape (m,)."""
    x = trials.n_train.astype(np.float64)
    for size in np.unique(trials.n_train):
        rows = np.flatnonzero(trials.n_train == size)
        if len(rows) > 1:
            x[rows] *= 2.0 ** np.linspace(-0.22, 0.22, len(rows))
    return x
