"""The picture of a calibrated model with other inputs: outputs over time, with their bands."""

from simulation.measurement import Measurement
from studies.report.drawing import (
    MEASURED,
    POLISHED,
    SIMULATED,
    TRAINING,
    Axis,
    Figure,
    Panel,
    Series,
    time_axis,
)
from studies.report.wording import axis_label, percent, shown_unit
from studies.stages.prediction import Prediction


def prediction_figure(found: Prediction, measurement: Measurement | None = None) -> Figure:
    """Show each output over time.

    Args:
        found: The prediction.
        measurement: What was measured meanwhile; None for nothing.
    """
    bands = "" if found.level is None else f", with {percent(found.level)} bands"
    panels = [_panel(found, k, measurement) for k in range(len(found.output_names))]
    driven = "other inputs" if measurement is None else "its recorded inputs"
    return Figure(f"The calibrated model with {driven}{bands}", tuple(panels))


def _panel(found: Prediction, k: int, measurement: Measurement | None) -> Panel:
    axis, unit = time_axis(found.time)
    at, name = unit.of_seconds(found.time), found.output_names[k]
    series = [
        Series(what, color, at, low=band[0, :, k], high=band[1, :, k])
        for band, color, what in (
            (found.predictive, TRAINING, "with noise"),
            (found.simulated, SIMULATED, "simulated"),
        )
        if band is not None
    ]
    if measurement is not None:
        samples, dots = measurement.samples[k], {"filled": True, "size": 14}
        series.append(
            Series("measured", MEASURED, unit.of_seconds(samples.time), samples.values, "point", dots)
        )
    series.append(Series("calibrated", POLISHED, at, found.y[:, k]))
    return Panel(name, axis, Axis(axis_label(name, shown_unit(found.output_units[k]))), series)
