"""The picture of a calibrated model with other inputs: outputs over time, with their bands."""

from studies.report.drawing import POLISHED, SIMULATED, TRAINING, Axis, Figure, Panel, Series, time_axis
from studies.report.wording import axis_label, percent, shown_unit
from studies.stages.stage_results import Prediction


def prediction_figure(found: Prediction) -> Figure:
    """Show each output over time.

    Args:
        found: The prediction.
    """
    bands = "" if found.level is None else f", with {percent(found.level)} bands"
    panels = [_panel(found, k) for k in range(len(found.output_names))]
    return Figure(f"The calibrated model with other inputs{bands}", tuple(panels))


def _panel(found: Prediction, k: int) -> Panel:
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
    series.append(Series("calibrated", POLISHED, at, found.y[:, k]))
    return Panel(name, axis, Axis(axis_label(name, shown_unit(found.output_units[k]))), series)
